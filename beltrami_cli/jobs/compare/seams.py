"""The areas of texels, and the steps of colours at seams."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s, Indices, Int64s
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import EMPTY, REACH, Atlas, at_seam, lines_over_seams
from beltrami_cli.surface.gutters import within

# Distance from a seam that counts as near, in texels.
_SEAM_DISTANCE = 4
_CELLS = 1 << 14  # whose areas are measured at a time, in the processor's cache


def near_seams(atlas: Atlas) -> Bools:
    """Return which owned cells are within 4 texels of a seam, shape (T,)."""
    at_border = np.zeros(atlas.kind.shape, bool)
    for inner, *_ in lines_over_seams(atlas, 1):
        at_border.reshape(-1)[inner] = True
    # Charts are further apart on the canvas than this reaches.
    return within(at_border, _SEAM_DISTANCE - 1).reshape(-1)[atlas.owned_cells]


def seam_steps(atlas: Atlas, colours: Callable[[Indices], Float32s]) -> tuple[Int64s, Float64s]:
    """Return the owned cells at seams and the jump there, mean over channels; `colours` reads cells by their rows."""
    # The colours of three texels on a line across the seam are extrapolated to it, from both sides.
    lines = np.concatenate([np.stack(line) for line in lines_over_seams(atlas, REACH)], axis=1)
    cells = np.searchsorted(atlas.owned_cells, lines[0])
    steps = np.empty(len(cells))
    for block in large_arrays.blocks(len(cells), large_arrays.SCATTERED):
        values = [colours(np.searchsorted(atlas.owned_cells, inner)) for inner in lines[:REACH, block]]
        for here, beyond in zip(values, lines[REACH:, block], strict=True):
            halo = np.searchsorted(atlas.halo_cells, beyond)
            # Cells that are owned no more have the weight 0.
            taps = np.minimum(
                np.searchsorted(atlas.owned_cells, atlas.halo_taps[halo]), len(atlas.owned_cells) - 1
            )
            tapped = colours(taps.reshape(-1)).reshape(*taps.shape, -1)
            np.subtract(np.einsum("ht,htn->hn", atlas.halo_weights[halo], tapped), here, out=here)
        steps[block] = np.abs(at_seam(values)).mean(axis=1)
    return cells, steps


def texel_areas(atlas: Atlas) -> Float64s:
    """Return the surface area of each owned cell, shape (T,), in the surface's own unit squared."""
    columns, filled = atlas.kind.shape[1], atlas.kind.reshape(-1) != EMPTY
    squared_lengths = atlas.squared_lengths[:3].reshape(3, -1)
    areas = np.empty(len(atlas.owned_cells))
    for block in large_arrays.blocks(len(areas), _CELLS):
        total, count = np.zeros((2, block.stop - block.start))
        # The mean of the squares of four cells around it; all cells around an owned one lie on the canvas.
        for offset in (0, 1, columns, columns + 1):
            first = atlas.owned_cells[block] - offset
            # A parallelogram: |a x b|^2 = |a|^2 |b|^2 - (a . b)^2, where a . b follows from |a + b|^2.
            a, b, c = squared_lengths[:, first].astype(np.float64)
            known = np.isfinite(a + b + c)
            for corner in (0, 1, columns, columns + 1):
                known &= filled[first + corner]
            a, b, c = np.where(known, (a, b, c), 0)
            total += np.sqrt(np.maximum(a * b - ((c - a - b) / 2) ** 2, 0))
            count += known
        areas[block] = np.divide(total, count, out=np.full(len(total), np.nan), where=count > 0)
    measured = np.isfinite(areas)
    return np.where(measured, areas, areas[measured].mean() if measured.any() else 1.0)
