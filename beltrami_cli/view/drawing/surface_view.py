"""Views of coloured triangles, drawn by ray tracing with Embree.

I. Wald, S. Woop, C. Benthin, G. S. Johnson, M. Ernst, "Embree: a kernel framework for efficient CPU ray tracing",
ACM Transactions on Graphics 33(4), 2014, doi:10.1145/2601097.2601199.
"""

from __future__ import annotations

import importlib
from functools import cached_property
from typing import Any

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s, Int32s, Int64s
from beltrami_cli.errors import ProcessingError, install_hint
from beltrami_cli.surface.geometry import unit_vectors, vertex_normals, without_unused
from beltrami_cli.surface.grouping import group_equal_rows
from beltrami_cli.surface.large_arrays import blocks
from beltrami_cli.surface.memory import memory_reserved
from beltrami_cli.view.drawing.cameras import SAMPLES, Camera, Window, size_between
from beltrami_cli.view.drawing.surface_colours import SurfaceColours

AMBIENT = 0.35  # share of ambient light
# Direction of the lamp in view coordinates: upper left, behind the eye.
LAMP = np.array([-0.4, 0.5, 0.77]) / np.linalg.norm([-0.4, 0.5, 0.77])

_CREASE = np.cos(np.radians(40))  # smoothed normals further than this from the triangle's are not used
# Rays at a time: arrays of more leave the processor's cache, and memory is asked for again for each of them.
_BLOCK = 1 << 12
_OPAQUE = 0.999  # opacity from which surfaces behind are invisible
_LAYERS = 16  # most transparent surfaces along a ray
_FACE_BYTES = 100  # that Embree takes, besides its threads
_STEP = 1e-5  # in sizes of the model: distance behind a transparent surface at which the ray continues


def require_embree() -> tuple[Any, Any]:
    """Import the two modules that cast rays; ProcessingError says what to install if they are missing."""
    try:
        scenes = importlib.import_module("embreex.rtcore_scene")
        return scenes, importlib.import_module("embreex.mesh_construction")
    except ImportError as error:
        # Linux on ARM, where this package does not ask for it.
        cause = "to draw surfaces, the package embreex is needed"
        raise ProcessingError(f"{cause}; {install_hint('embreex')}") from error


class SurfaceView:
    """A coloured surface of at least one triangle, seen from both sides, to be looked at from anywhere."""

    def __init__(self, positions: Float64s, faces: Int32s, colours: SurfaceColours) -> None:
        scenes, meshes = require_embree()
        self.positions, self.faces = without_unused(positions, faces)
        self._colours = colours
        low, high = self.positions.min(axis=0), self.positions.max(axis=0)
        # Embree computes in single precision: around the middle and of unit size, large coordinates lose no digits.
        self._middle, self._size = (low + high) / 2, size_between(low, high)
        with memory_reserved(_FACE_BYTES * len(faces)):
            self._scene = scenes.EmbreeScene(robust=True)
            self._mesh = meshes.TriangleMesh(self._scene, self._normalised(self.positions), self.faces)
            self._cast(positions[:1], np.array([[0.0, 0.0, 1.0]]))  # builds the tree now

    def _cast(self, starts: Float64s, directions: Float64s) -> tuple[Int64s, Int32s, Float32s, Float64s]:
        """Return which rays hit, (K,), and the faces, barycentric weights, (K, 3), and distances of these places."""
        # Rays from an eye have one start, which is normalised once.
        origins = self._normalised(starts if starts.strides[0] else starts[:1])
        origins = np.ascontiguousarray(np.broadcast_to(origins, starts.shape))
        found = self._scene.run(origins, np.ascontiguousarray(directions, np.float32), output=1)
        rays = np.flatnonzero(found["primID"] >= 0)
        faces, u, v, distances = (found[name][rays] for name in ("primID", "u", "v", "tfar"))
        return rays, faces, np.stack([1 - u - v, u, v], axis=1), distances.astype(np.float64) * self._size

    def _normalised(self, positions: Float64s) -> Float32s:
        return np.ascontiguousarray((positions - self._middle) / self._size, np.float32)

    def draw(self, camera: Camera, size: tuple[int, int], window: Window, *, lit: bool) -> Float32s:
        """Draw a window of a view, `size` = (width, height) pixels: linear light times opacity, and opacity."""
        width, height = size
        image = np.zeros((height, width, 4), np.float32)
        shares = [(np.arange(side * SAMPLES) + 0.5) / (side * SAMPLES) for side in size]
        x, y = (window[k] + (window[k + 2] - window[k]) * share for k, share in enumerate(shares))
        left, upper, right, lower = self._covered(camera, size, window)
        x, y, pixel = x[left * SAMPLES : right * SAMPLES], y[upper * SAMPLES : lower * SAMPLES], x[1] - x[0]
        for rows in blocks(lower - upper, max(1, _BLOCK // width)):
            # One ray through each pixel at a time, so that sums go over whole blocks.
            down, part = y[rows.start * SAMPLES : rows.stop * SAMPLES, None], image[upper:, left:right][rows]
            for row, column in np.ndindex(SAMPLES, SAMPLES):
                starts, directions = camera.rays(x[column::SAMPLES], down[row::SAMPLES], np.float32)
                part += self._seen(camera, starts, directions, pixel, lit=lit).reshape(part.shape)
            part /= SAMPLES**2
        return image

    def _covered(self, camera: Camera, size: tuple[int, int], window: Window) -> list[int]:
        """Return first and last (exclusive) column and row of the pixels that may show the surface."""
        places, depths = camera.project(self.positions)
        if not camera.is_orthographic and depths.min() <= 0:
            return [0, 0, *size]
        corner, extent = np.array(window[:2]), np.subtract(window[2:], window[:2])
        low, high = ((each - corner) / extent * size for each in (places.min(axis=0), places.max(axis=0)))
        first, last = np.floor(low) - 1, np.ceil(high) + 1  # a pixel more, as rays are rounded
        return [int(each) for each in np.clip([*first, *last], 0, [*size, *size])]

    def _seen(
        self, camera: Camera, starts: Float64s, directions: Float64s, pixel: float, *, lit: bool
    ) -> Float32s:  # fmt: skip
        """Return the light along rays, (K, 4), also through transparent surfaces."""
        seen = np.zeros((len(starts), 4), np.float32)
        active = np.arange(len(starts))
        travelled = np.zeros(len(starts))
        for _ in range(_LAYERS):
            rays, faces, weights, distances = self._cast(starts, directions)
            directions, active = directions[rays], active[rays]
            travelled = travelled[rays] + distances
            colours = self._colours(faces, weights, (camera.breadth(travelled) * pixel) ** 2)
            if lit:
                colours[:, :3] *= self._light(camera, faces, weights, directions)[:, None]
            if self._colours.is_opaque:
                seen[active] = colours
                break
            total = seen[active]
            total += (1 - total[:, 3:]) * colours
            seen[active] = total
            on = np.flatnonzero(total[:, 3] < _OPAQUE)
            if not len(on):
                break
            starts = starts[rays]
            step = _STEP * self._size
            starts = starts[on] + (distances[on] + step)[:, None] * directions[on]
            directions, active, travelled = directions[on], active[on], travelled[on] + step
        return seen

    def _light(self, camera: Camera, faces: Int32s, weights: Float32s, directions: Float64s) -> Float32s:
        normals = np.einsum("kc,kcx->kx", weights, self._corner_normals[faces])
        normals /= np.maximum(np.sqrt(np.einsum("kx,kx->k", normals, normals)), 1e-30)[:, None]
        away = np.einsum("kx,kx->k", self._face_normals[faces], directions) > 0
        towards = normals @ (LAMP @ camera.rotation).astype(np.float32)
        lambert = np.maximum(np.where(away, -towards, towards), 0)
        return np.asarray(AMBIENT + (1 - AMBIENT) * lambert, np.float32)

    @cached_property
    def _face_normals(self) -> Float32s:
        corners = self.positions[self.faces]
        crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return np.asarray(unit_vectors(crosses), np.float32)

    @cached_property
    def _corner_normals(self) -> Float32s:
        """Normals of the corners of triangles, (F, 3, 3): smooth, except at creases."""
        place_of, _ = group_equal_rows(*self.positions.T)
        smooth = vertex_normals(self.positions, self.faces, place_of).astype(np.float64)[self.faces]
        flat = self._face_normals[:, None, :]
        creased = (smooth * flat).sum(axis=2, keepdims=True) < _CREASE
        return np.asarray(np.where(creased, flat, smooth), np.float32)
