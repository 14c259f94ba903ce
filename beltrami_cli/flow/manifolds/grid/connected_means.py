"""Means over a window of a grid that do not reach over cuts of the surface.

A convolution would average cells on both sides of a cut. Near cuts, means are over the cells that are connected to the
middle of the window inside of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Int64s, Uint8s
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import EMPTY, Atlas
from beltrami_cli.surface.grid_atlas import STEPS, ends_of


@dataclass(frozen=True, eq=False)
class ConnectedMeans:
    """Means over the cells of a square window that are connected to its centre inside the window."""

    shape: tuple[int, int]
    weights: Float32s  # of the cells of the window
    cells: Int64s  # cells, not empty, whose window contains a cell at a cut
    reached_bits: Uint8s  # connected cells of each window, as bits

    @classmethod
    def of(cls, atlas: Atlas, taps: Float32s) -> ConnectedMeans:
        weights, reach = np.outer(taps, taps).reshape(-1), len(taps) // 2
        cells = _near_cuts(atlas, reach)
        reached = [
            np.packbits(_connected_cells(atlas, cells[block], reach), axis=1)
            for block in _blocks(0, len(cells), len(weights))
        ]
        bits = np.concatenate(reached) if reached else np.zeros((0, 1), np.uint8)
        return cls(atlas.kind.shape, weights, cells, bits)

    def write(self, plane: Float32s, result: Float32s, first: int) -> None:
        """Write the means of cells near cuts to `result`; `plane` and `result` are canvas rows from `first` on."""
        (rows, columns), size = self.shape, len(self.weights)
        last, reach = first + len(plane), math.isqrt(size) // 2
        top = first + reach if first else 0
        bottom = last - reach if last < rows else last
        begin, end = np.searchsorted(self.cells, [top * columns, max(top, bottom) * columns])
        for block in _blocks(begin, end, size):
            cells = self.cells[block]
            weights = np.unpackbits(self.reached_bits[block], axis=1, count=size) * self.weights
            window = _window(self.shape, cells, reach)[0] - first * columns
            means = np.einsum("kw,kw->k", plane.reshape(-1)[window], weights) / weights.sum(axis=1)
            result.reshape(-1)[cells - first * columns] = means


def _blocks(begin: int, end: int, window: int) -> Iterator[slice]:
    size = max(1, large_arrays.BLOCK // window)
    for first in range(begin, end, size):
        yield slice(first, min(first + size, end))


def _near_cuts(atlas: Atlas, reach: int) -> Int64s:
    """Return the cells, not empty, whose window contains a cell at a cut."""
    near, shape = np.zeros(atlas.kind.size, bool), atlas.kind.shape
    rows, columns = np.divmod(atlas.cut_cells, shape[1])
    for down in range(-reach, reach + 1):
        for right in range(-reach, reach + 1):
            row, column = rows + down, columns + right
            inside = (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
            near[row[inside] * shape[1] + column[inside]] = True
    return np.flatnonzero(near & (atlas.kind.reshape(-1) != EMPTY)).astype(np.int64)


def _window(shape: tuple[int, int], cells: Int64s, reach: int) -> tuple[Int64s, Bools]:
    """Return the cells of the windows around cells, shape (K, W), and which of them are on the canvas."""
    offsets = np.arange(-reach, reach + 1)
    rows = (cells // shape[1])[:, None, None] + offsets[:, None]
    columns = (cells % shape[1])[:, None, None] + offsets
    inside = (rows >= 0) & (rows < shape[0]) & (columns >= 0) & (columns < shape[1])
    flat = np.where(inside, rows * shape[1] + columns, cells[:, None, None])
    return flat.reshape(len(cells), -1), inside.reshape(len(cells), -1)


def _connected_cells(atlas: Atlas, cells: Int64s, reach: int) -> Bools:
    """Which cells of each window are connected to its centre by edges, shape (K, W)."""
    side = 2 * reach + 1
    window, inside = _window(atlas.kind.shape, cells, reach)
    filled = (inside & (atlas.kind.reshape(-1)[window] != EMPTY)).reshape(-1, side, side)
    reached = np.zeros_like(filled)
    reached[:, reach, reach] = True
    edges = []
    for lengths, step in zip(atlas.squared_lengths, STEPS, strict=True):
        here, there = ((..., *slices) for slices in ends_of(step))
        joined = np.isfinite(lengths.reshape(-1)[window]).reshape(filled.shape)
        edges.append((here, there, joined[here] & filled[here] & filled[there]))
    before, count = -1, 0
    while before < count:
        for here, there, joined in edges:
            reached[there] |= reached[here] & joined
            reached[here] |= reached[there] & joined
        before, count = count, int(np.count_nonzero(reached))
    return np.asarray(reached.reshape(len(cells), -1), bool)
