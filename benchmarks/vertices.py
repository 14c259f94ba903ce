"""Coloured vertices: closed surfaces under a piecewise smooth pattern with Gaussian noise."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from beltrami_cli.arrays import Array
from harness import SIGMA
from oracles import surfaces

Pattern = Callable[[Array], Array]  # colours of positions


@dataclass(frozen=True)
class Scene:
    """A coloured surface: positions (V, 3) float64, faces (F, 3) int32, colours (V, 3) float32 in [0, 1]."""

    positions: Array
    faces: Array
    clean: Array
    noisy: Array


def icosphere(subdivisions: int, pattern: Pattern | None = None) -> Scene:
    """Return a sphere of 10 * 4^n + 2 vertices in the order of subdivision, which caches badly, as in real files."""
    positions, faces = surfaces.icosphere(subdivisions)
    return coloured(positions, faces, pattern or chequer)


def torus(rings: int, sides: int) -> Scene:
    """Return a torus of rings * sides vertices and twice as many triangles."""
    ring, side = (part.ravel() for part in np.mgrid[:rings, :sides])
    u, v = 2 * np.pi * ring / rings, 2 * np.pi * side / sides
    reach = 0.75 + 0.25 * np.cos(v)
    positions = np.column_stack([reach * np.cos(u), reach * np.sin(u), 0.25 * np.sin(v)])
    there, across = (ring + 1) % rings, (side + 1) % sides
    a, b, c, d = (r * sides + s for r, s in ((ring, side), (there, side), (there, across), (ring, across)))
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])]).astype(np.int32)
    return coloured(positions, faces, chequer)


def coloured(positions: Array, faces: Array, pattern: Pattern) -> Scene:
    """Return the surface with a pattern and noise; values are in a range in which noise is rarely clipped."""
    clean = pattern(positions)
    noise = SIGMA * np.random.default_rng(7).standard_normal(clean.shape)
    return Scene(positions, faces, clean.astype(np.float32), (clean + noise).astype(np.float32))


def chequer(positions: Array) -> Array:
    """Return light and dark regions with gradients; all borders have the same strong contrast of 0.4."""
    odd = np.sin(8 * positions).prod(axis=1) > 0
    return np.where(odd, 0.7, 0.3)[:, None] + 0.12 * shading(positions)


def mosaic(positions: Array) -> Array:
    """Return 200 cells of random colours: borders of any contrast, many too weak to be distinguished from noise."""
    random = np.random.default_rng(3)
    centres = random.standard_normal((200, 3))
    cell = np.argmax(positions @ (centres / np.linalg.norm(centres, axis=1, keepdims=True)).T, axis=1)
    return random.uniform(0.15, 0.85, (200, 3))[cell] + 0.06 * shading(positions)


def shading(positions: Array) -> Array:
    """Return slow gradients in [-1, 1], different in each channel."""
    x, y, z = positions.T
    return np.column_stack([np.sin(2 * x + 0.5), np.cos(2.5 * y), np.sin(2.2 * z + 1)])


def write_ply(path: Path, scene: Scene) -> None:
    vertices = np.empty(len(scene.positions), [("xyz", "<f4", 3), ("rgb", "u1", 3)])
    vertices["xyz"], vertices["rgb"] = scene.positions, np.rint(np.clip(scene.noisy, 0, 1) * 255)
    faces = np.empty(len(scene.faces), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, scene.faces
    names = [f"property float {axis}" for axis in "xyz"]
    names += [f"property uchar {colour}" for colour in ("red", "green", "blue")]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}", *names]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header\n"]
    path.write_bytes("\n".join(header).encode() + vertices.tobytes() + faces.tobytes())
