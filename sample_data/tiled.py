"""A rolling floor under one ornament of glazed tiles, which is repeated six by four times."""

from __future__ import annotations

import numpy as np

from nonmanifold import grid_triangles
from samples import normalised
from textured import Texture, TexturedSample

COLUMNS, ROWS = 48, 32
REPEATS = np.array([6, 4])
SIZE = 256


def make() -> TexturedSample:
    """Return the floor; its coordinates run to 6 and 4, and one texel is seen 24 times."""
    i, j = np.mgrid[: ROWS + 1, : COLUMNS + 1]
    x, z = j.ravel() / COLUMNS * 6, i.ravel() / ROWS * 4
    hills = 0.32 * np.sin(1.3 * x + 0.4) * np.cos(1.1 * z - 0.5) + 0.10 * np.sin(2.9 * x - 1.7 * z)
    coordinates = np.round(np.column_stack([j.ravel() / COLUMNS, i.ravel() / ROWS]) * REPEATS, 6)
    triangles = grid_triangles(np.arange((ROWS + 1) * (COLUMNS + 1)).reshape(ROWS + 1, COLUMNS + 1))
    centre = (np.arange(SIZE) + 0.5) / SIZE
    texture = Texture("tiles", pattern(*np.meshgrid(centre, centre)), np.ones((SIZE, SIZE), bool), "png16")
    positions = normalised(np.column_stack([x, hills, z]))
    nothing = np.zeros(len(triangles), np.int64)
    return TexturedSample(positions, coordinates, triangles, triangles, nothing, (texture,))


def pattern(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the ornament over one period, shape (..., 3) in [0, 1]: four tiles about an eight-pointed star."""
    u, v = u - 0.5, v - 0.5
    glaze = (0.05 * np.cos(2 * np.pi * u) * np.cos(2 * np.pi * v) + 0.03 * np.sin(2 * np.pi * (u + v)))[
        ..., None
    ]
    colours = np.array([0.93, 0.89, 0.79]) + glaze
    a, b = np.abs(u), np.abs(v)
    reach, slanted = np.maximum(a, b), (a + b) / 2**0.5
    corner = np.hypot(a - 0.5, b - 0.5)
    turn = np.arctan2(v, u)
    petal = np.hypot(u, v) < 0.115 + 0.035 * np.cos(8 * turn)
    side = np.hypot(np.maximum(a, b) - 0.5, np.minimum(a, b))
    layers = (
        (corner < 0.235, (0.20, 0.42, 0.48), 1.2),
        (corner < 0.195, (0.93, 0.89, 0.79), 1.0),
        (corner < 0.165, (0.76, 0.36, 0.22), 1.6),
        (corner < 0.065, (0.95, 0.76, 0.34), 1.0),
        ((reach < 0.255) | (slanted < 0.255), (0.14, 0.26, 0.50), 1.5),
        ((reach < 0.222) | (slanted < 0.222), (0.93, 0.89, 0.79), 1.0),
        ((reach < 0.200) | (slanted < 0.200), (0.22, 0.44, 0.66), 2.0),
        (petal, (0.95, 0.76, 0.34), 1.5),
        (np.hypot(u, v) < 0.05, (0.76, 0.36, 0.22), 1.0),
        (side < 0.10, (0.36, 0.56, 0.40), 1.2),
        (side < 0.05, (0.95, 0.76, 0.34), 1.0),
        (np.minimum(np.abs(a - 0.5), np.abs(b - 0.5)) < 0.010, (0.50, 0.47, 0.43), 0.5),
        (np.minimum(a, b) < 0.006, (0.50, 0.47, 0.43), 0.5),
    )
    for where, rgb, strength in layers:
        colours[where] = np.array(rgb) + strength * glaze[where]
    return colours
