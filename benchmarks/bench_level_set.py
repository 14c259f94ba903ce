"""Noise removed on level sets, on the mesh that is smoothed and on that of marching cubes: needs the extra volumes.

``python benchmarks/bench_level_set.py``, from the project's root; prints PSNR at the vertices in dB.
"""

import sys
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from beltrami_cli import smooth
from beltrami_cli.surface import reconstruction
from beltrami_cli.surface.reconstruction import GridColours, Lattice, interpolate_colours, places

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from oracles import level_sets

RADIUS = 40  # voxels
SIGMAS = (10, 20, 40)  # of 255


def painting(directions):
    """Return colours of unit vectors: fields with sharp edges, one of them shaded."""
    x, y, z = np.moveaxis(directions, -1, 0)
    field = (np.floor(4 * np.arctan2(y, x) / np.pi) + np.floor(2 * z + 2)) % 2
    shade = 0.5 + 0.4 * np.sin(5 * x + 2) * np.cos(4 * y)
    return np.stack([0.2 + 0.6 * field, shade, 0.3 + 0.4 * field * shade], axis=-1)


def meshes(values):
    """Return the vertices and triangles of both meshes by their names."""
    crossings = reconstruction.find_crossings(values, 0)
    whole = reconstruction.compacted
    reconstruction.compacted = lambda vertices, faces: (vertices, faces)
    plain = reconstruction.triangulate_level_set(values, 0, crossings)
    reconstruction.compacted = whole
    return {
        "marching cubes": plain,
        "a vertex a voxel": reconstruction.triangulate_level_set(values, 0, crossings),
    }


def psnr(colours, truth):
    return -10 * np.log10(np.mean((colours - truth) ** 2))


def main():
    random = np.random.default_rng(0)
    values, steps, origin = level_sets.sphere(1 / RADIUS)
    lattice = Lattice(np.diag(steps), origin)
    clean = painting(level_sets.directions(level_sets.places(values.shape, steps, origin)))
    table = Table("mesh", "vertices", "shortest edge", "noise of 255", "noisy, dB", "smooth, dB", "beta")
    for name, (at, faces) in meshes(values).items():
        positions = places(lattice, at)
        truth = painting(level_sets.directions(positions))
        shortest = np.linalg.norm(at[faces] - at[np.roll(faces, 1, axis=1)], axis=2).min()
        for sigma in SIGMAS:
            noisy = clean + sigma / 255 * random.standard_normal(clean.shape)
            colours = interpolate_colours(GridColours(lattice, noisy), positions)
            result = smooth(positions, faces, colours)
            row = (
                len(at),
                f"{shortest:.3f} voxels",
                sigma,
                psnr(colours, truth),
                psnr(result.colours, truth),
            )
            table.add_row(
                name, *(f"{v:.1f}" if isinstance(v, float) else str(v) for v in row), f"{result.beta:.1f}"
            )
    Console().print(table)


if __name__ == "__main__":
    main()
