"""A planet on a cube map: six charts of linear light in half floats, brighter than white where the sun glints."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from baking import baked
from nonmanifold import grid_triangles
from samples import normalised
from solid_noise import fractal, solid_noise
from textured import Texture, TexturedSample

Array = NDArray[np.float64]
CUTS = 14  # edges along a side of the cube
CELL, GUTTER = 96, 4  # texels of a chart with its gutter
SHEET = (3, 2)  # charts side by side, and below each other
# Right, up and forward of each side of the cube.
SIDES = np.array([
    [(0, 0, -1), (0, 1, 0), (1, 0, 0)], [(1, 0, 0), (0, 1, 0), (0, 0, 1)], [(0, 0, 1), (0, 1, 0), (-1, 0, 0)],
    [(1, 0, 0), (0, 0, -1), (0, 1, 0)], [(-1, 0, 0), (0, 1, 0), (0, 0, -1)], [(1, 0, 0), (0, 0, 1), (0, -1, 0)],
], float)  # fmt: skip
SUN = np.array([-0.42, 0.36, 0.83])


def make() -> TexturedSample:
    """Return the sphere; the charts meet along the twelve edges of the cube."""
    i, j = np.mgrid[: CUTS + 1, : CUTS + 1]
    across, up = (np.tan((part.ravel() / CUTS - 0.5) * np.pi / 2)[:, None] for part in (i, j))
    grid = np.arange((CUTS + 1) ** 2).reshape(CUTS + 1, CUTS + 1)
    points, coordinates, corners = [], [], []
    inner = CELL - 2 * GUTTER
    for number, (right, above, ahead) in enumerate(SIDES):
        cube = across * right + up * above + ahead
        points.append(cube / np.linalg.norm(cube, axis=1, keepdims=True))
        row, column = divmod(number, SHEET[0])
        texels = (
            np.column_stack([i.ravel(), CUTS - j.ravel()]) / CUTS * inner
            + GUTTER
            + (column * CELL, row * CELL)
        )
        coordinates.append(np.round(texels / (SHEET[0] * CELL, SHEET[1] * CELL), 6))
        corners.append(grid_triangles(grid) + number * len(grid) ** 2)
    every = normalised(np.round(np.concatenate(points), 7))
    positions, vertex_of = np.unique(every, axis=0, return_inverse=True)
    flat, triangles = np.concatenate(coordinates), np.concatenate(corners)
    vertices = vertex_of.reshape(-1)[triangles]
    size = SHEET[0] * CELL, SHEET[1] * CELL
    texture = Texture("planet", *baked(pattern, positions[vertices], flat[triangles], size, GUTTER), "exr")
    return TexturedSample(
        positions, flat, vertices, triangles, np.zeros(len(triangles), np.int64), (texture,)
    )


def pattern(positions: Array) -> Array:
    """Return sRGB display values, shape (K, 3): seas, coasts, land, ice and clouds; the glint is above 1."""
    y = positions[:, 1]
    ground = fractal(positions, 3.1, 501, 5)
    sea, depth = ground < 0.12, np.clip(0.12 - ground, 0, 1)[:, None]
    colours = np.array([0.16, 0.42, 0.58]) - depth * np.array([0.14, 0.26, 0.18])
    plain = np.array([0.42, 0.56, 0.26]) + solid_noise(positions, 9, 511)[:, None] * np.array(
        [0.10, 0.05, 0.04]
    )
    dry = np.clip(1.6 - 7 * np.abs(np.abs(y) - 0.16), 0, 1)[:, None]
    plain += 0.8 * dry * (np.array([0.82, 0.68, 0.42]) - plain)
    rock = np.array([0.50, 0.42, 0.34]) + (ground[:, None] - 0.6) * 0.4
    land = np.where((ground > 0.55)[:, None], rock, plain)
    colours = np.where(sea[:, None], colours, land)
    colours[~sea & (ground < 0.17)] = (0.88, 0.80, 0.60)
    colours[np.abs(y) + 0.05 * fractal(positions, 6, 521, 2) > 0.43] = (0.92, 0.95, 0.97)
    cloud = np.clip((fractal(positions * (1, 2.2, 1), 3.4, 531, 4) - 0.50) * 4, 0, 0.85)[:, None]
    colours += cloud * (0.97 - colours)
    away = 1 - positions @ (SUN / np.linalg.norm(SUN)) * 2
    return colours + (0.9 * np.exp(-away / 0.006) + 0.25 * np.exp(-away / 0.05))[:, None] * (1, 0.96, 0.85)
