"""An open height field with a hole, of quads and triangles, unevenly spaced, coloured like a map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from samples import Sample, normalised, quantised

Array = NDArray[np.float64]
ROWS, COLUMNS = 46, 56
SEED = 20_030_612
BANDS = (  # up to this height, this colour, and how much it changes with height
    (-0.035, (0.16, 0.38, 0.66), 1.6),
    (-0.018, (0.88, 0.80, 0.58), 1.0),
    (0.060, (0.46, 0.66, 0.34), -1.6),
    (0.115, (0.22, 0.42, 0.20), 1.0),
    (0.165, (0.50, 0.44, 0.40), 1.2),
    (np.inf, (0.86, 0.88, 0.92), 0.2),
)


def make() -> Sample:
    """Return the terrain: a warped grid of 46 x 56 vertices without those inside a crater."""
    u, v = warped_grid()
    ground = height(u, v)
    kept = (u - 0.52) ** 2 + (v + 0.33) ** 2 > 0.13**2
    polygons = cells(kept)
    used = np.unique(np.concatenate([np.array(p) for p in polygons]))
    row = np.full(len(u), -1)
    row[used] = np.arange(len(used))
    positions = normalised(np.column_stack([u, ground, -v])[used])
    colours = quantised(pattern(u[used], v[used], np.round(ground[used], 6)))
    return Sample(positions, tuple(tuple(row[list(p)].tolist()) for p in polygons), colours)


def warped_grid() -> tuple[Array, Array]:
    """Return the plane coordinates of the grid's vertices, closer together in the middle, and jittered."""
    v, u = (index.ravel() for index in np.mgrid[-1 : 1 : ROWS * 1j, -1 : 1 : COLUMNS * 1j])
    jitter = np.random.Generator(np.random.PCG64(SEED)).uniform(-0.28, 0.28, (2, len(u)))
    inside = (np.abs(u) < 0.999) & (np.abs(v) < 0.999)
    u, v = u + inside * jitter[0] * 2 / (COLUMNS - 1), v + inside * jitter[1] * 2 / (ROWS - 1)
    return np.round(u * (0.55 + 0.45 * u**2), 6), np.round(0.8 * v * (0.6 + 0.4 * v**2), 6)


def height(u: Array, v: Array) -> Array:
    """Return hills, a mountain and the basin of a lake over the plane, with a crater's rim."""
    ground = 0.05 * np.sin(4.1 * u + 0.6) * np.cos(3.7 * v - 0.4) + 0.012 * np.sin(13 * u - 5 * v)
    ground += 0.24 * np.exp(-((u + 0.45) ** 2 + (v - 0.32) ** 2) / 0.055)
    ground += 0.13 * np.exp(-((u - 0.30) ** 2 / 0.05 + (v - 0.52) ** 2 / 0.02))
    ground -= 0.13 * np.exp(-((u + 0.10) ** 2 / 0.10 + (v + 0.28) ** 2 / 0.035))
    rim = np.hypot(u - 0.52, v + 0.33) - 0.15
    return ground + 0.07 * np.exp(-((rim / 0.06) ** 2))


def cells(kept: NDArray[np.bool_]) -> tuple[tuple[int, ...], ...]:
    """Return the grid's cells whose corners are all kept: seven in ten as quads, the others cut in two."""
    index = np.arange(ROWS * COLUMNS).reshape(ROWS, COLUMNS)
    corners = (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1])
    quads = np.stack(corners, axis=-1).reshape(-1, 4)
    quads = quads[kept[quads].all(axis=1)]
    kind = np.random.Generator(np.random.PCG64(SEED + 1)).integers(0, 20, len(quads))
    polygons: list[tuple[int, ...]] = []
    for (a, b, c, d), k in zip(quads.tolist(), kind.tolist(), strict=True):
        polygons += [(a, b, c, d)] if k < 14 else [(a, b, c), (a, c, d)] if k < 17 else [(a, b, d), (b, c, d)]
    return tuple(polygons)


def pattern(u: Array, v: Array, ground: Array) -> Array:
    """Return a map's colours by height with fields and a road, shape (V, 3) in [0, 1]."""
    light = 0.05 * np.cos(2.2 * u - 1.4 * v)[:, None]
    colours = np.empty((len(u), 3))
    below = -np.inf
    for limit, rgb, slope in BANDS:
        band = (ground > below) & (ground <= limit)
        colours[band] = np.array(rgb) + slope * (ground[band] - max(below, -0.1))[:, None]
        below = limit
    fields = (np.abs(u - 0.55) < 0.24) & (np.abs(v - 0.06) < 0.14)
    plot = (np.floor((u - 0.31) / 0.16) + np.floor((v + 0.08) / 0.14)).astype(int) % 2
    colours[fields] = np.array([(0.85, 0.72, 0.30), (0.62, 0.47, 0.30)])[plot[fields]]
    road = np.abs(v - 0.30 * np.round(np.sin(2.4 * u + 0.3), 6) + 0.02) < 0.026
    colours[road & (ground > -0.018)] = (0.72, 0.70, 0.69)
    return colours + light
