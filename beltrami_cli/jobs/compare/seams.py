"""What is near the seams of an atlas, what its texels stand for, and how colours go on over its seams."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.surface.atlas import EMPTY, refresh_halo
from beltrami_cli.surface.lookup import within
from beltrami_cli.surface.seam_lines import REACH, at_seam, lines_over_seams

if TYPE_CHECKING:
    from beltrami_cli.arrays import Bools, Float32s, Float64s, Int64s

from beltrami_cli.surface.atlas import Atlas

# Distance from a seam that counts as near, in texels.
_NEAR = 4


def near_seams(atlas: Atlas) -> Bools:
    """Return which owned cells are within 4 texels of a seam, shape (T,)."""
    beside = np.zeros(atlas.kind.shape, bool)
    for inner, *_ in lines_over_seams(atlas, 1):
        beside.reshape(-1)[inner] = True
    # Charts are further apart on the canvas than this reaches.
    return within(beside, _NEAR - 1).reshape(-1)[atlas.owned_cells]


def seam_steps(atlas: Atlas, colours: Float32s) -> tuple[Int64s, Float64s]:
    """Return the owned cells at seams (rows of `colours`, shape (T, N)) and the jump there, mean over channels."""
    # The colours of three texels on a line across the seam are extrapolated to it, from both sides.
    planes = np.zeros((colours.shape[1], *atlas.kind.shape), np.float32)
    planes.reshape(len(planes), -1)[:, atlas.owned_cells] = colours.T
    refresh_halo(planes, atlas, interpolated=True)
    flat = planes.reshape(len(planes), -1)
    cells, steps = [np.zeros(0, np.int64)], [np.zeros(0)]
    for line in lines_over_seams(atlas, REACH):
        jump = at_seam([flat[:, o] - flat[:, i] for i, o in zip(line[:REACH], line[REACH:], strict=True)])
        cells.append(line[0])
        steps.append(np.abs(jump).mean(axis=0))
    return np.searchsorted(atlas.owned_cells, np.concatenate(cells)), np.concatenate(steps)


def texel_areas(atlas: Atlas) -> Float64s:
    """Return the surface area of each owned cell, shape (T,), in the surface's own unit squared."""
    across, down, diagonal = (plane.astype(np.float64) for plane in atlas.squared_lengths[:3])
    known = (atlas.kind != EMPTY)[:-1, :-1] & (atlas.kind != EMPTY)[1:, 1:]
    known &= (atlas.kind != EMPTY)[:-1, 1:] & (atlas.kind != EMPTY)[1:, :-1]
    sides = across[:-1, :-1], down[:-1, :-1], diagonal[:-1, :-1]
    known &= np.isfinite(sides[0]) & np.isfinite(sides[1]) & np.isfinite(sides[2])
    a, b, c = (np.where(known, side, 0) for side in sides)
    # Each square of four cells is the parallelogram of its sides; a cell has the mean of the squares around it.
    # |a x b|^2 = |a|^2 |b|^2 - (a . b)^2, where a . b follows from |a + b|^2.
    area = np.sqrt(np.maximum(a * b - ((c - a - b) / 2) ** 2, 0))
    total, count = np.zeros(atlas.kind.shape), np.zeros(atlas.kind.shape)
    for rows in (slice(None, -1), slice(1, None)):
        for columns in (slice(None, -1), slice(1, None)):
            total[rows, columns] += area
            count[rows, columns] += known
    owned_total, owned_count = (plane.reshape(-1)[atlas.owned_cells] for plane in (total, count))
    measured = owned_count > 0
    usual = float(np.mean(owned_total[measured] / owned_count[measured])) if measured.any() else 1.0
    return np.where(measured, owned_total / np.maximum(owned_count, 1), usual)
