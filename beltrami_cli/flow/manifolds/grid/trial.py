"""Blocks of a canvas on which parameters are tried, each with a rim."""

from __future__ import annotations

import dataclasses

import numpy as np

from beltrami_cli.arrays import Bools, Indices, Int64s
from beltrami_cli.surface.atlas import EMPTY, OWNED, Atlas, Halo

# Side of the core of a block in cells; only the core is evaluated.
_CORE_SIDE = 64

# Width of the rim in cells. Iterations spread errors inwards from a block's border; most of a kernel's weight lies
# within this distance.
_RIM_CELLS = 8


def choose_blocks(atlas: Atlas, budget: int, reach: int) -> tuple[Int64s, Bools]:
    """Choose evenly spread blocks: their cells, and which are in a core, shape (blocks * side, side)."""
    rows, columns = atlas.kind.shape
    across = np.arange(0, columns, _CORE_SIDE)
    bands = (atlas.kind[top : top + _CORE_SIDE] == OWNED for top in range(0, rows, _CORE_SIDE))
    totals = np.cumsum([np.add.reduceat(band.sum(axis=0), across) for band in bands])
    count = max(1, budget // _CORE_SIDE**2)
    chosen = np.unique(np.searchsorted(totals, (np.arange(count) + 0.5) * totals[-1] / count))
    top, left = np.divmod(chosen, -(-columns // _CORE_SIDE))
    margin = _RIM_CELLS + reach
    side = np.arange(-margin, _CORE_SIDE + margin)
    row = (top[:, None] * _CORE_SIDE + side)[:, :, None]
    column = (left[:, None] * _CORE_SIDE + side)[:, None, :]
    on_canvas = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    # Cells beyond the canvas get the flat index of its last cell, which is in the margin.
    cells = np.where(on_canvas, row * columns + column, atlas.kind.size - 1).reshape(-1, len(side))
    inside = (side >= 0) & (side < _CORE_SIDE)
    core = np.tile(inside[:, None] & inside, (len(chosen), 1))
    return cells.astype(np.int64), core


def with_halo(part: Atlas, whole: Atlas, cells: Int64s, core: Bools) -> Atlas:
    """Complete the atlas of some cells of `whole` by the halo cells whose owned cells are included."""
    # A cell in several blocks is taken from the block whose core contains it.
    owned = part.owned_cells
    order = np.lexsort([~core.reshape(-1)[owned], cells.reshape(-1)[owned]])
    owned = owned[order]
    mirrored = np.flatnonzero(part.kind != EMPTY)
    rank = _rank(whole.halo.cells, cells.reshape(-1)[mirrored])
    mirrored, rank = mirrored[rank >= 0], rank[rank >= 0]
    place = _rank(cells.reshape(-1)[owned], whole.halo.taps[rank])
    taps = np.where(place >= 0, owned[place], -1) if len(owned) else place
    complete = np.all((taps >= 0) | (whole.halo.weights[rank] == 0), axis=1)
    rank = rank[complete]
    taps = np.maximum(taps[complete], 0).astype(np.int64)
    halo = Halo(mirrored[complete], taps, whole.halo.weights[rank], whole.halo.seams[rank])
    return dataclasses.replace(part, halo=halo)


def _rank(ascending: Indices, numbers: Indices) -> Int64s:
    """Index of each number in an ascending list, the first of equal ones; -1 if absent."""
    if not len(ascending):
        return np.full(numbers.shape, -1, np.int64)
    rank = np.minimum(np.searchsorted(ascending, numbers), len(ascending) - 1)
    return np.where(ascending[rank] == numbers, rank, -1)
