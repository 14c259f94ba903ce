"""Gaussian means on a regular grid, for the regularised metric and for averages over coarse levels."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from beltrami_cli._native import convolve
from beltrami_cli.arrays import Bools, Float32s, Int32s, Int64s, Uint8s
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import EMPTY, Atlas
from beltrami_cli.surface.grid_atlas import STEPS, ends_of

# Rows per block for steps that need temporary memory. The rounding of sums depends on it.
SUMMED_ROWS = 64


def gaussian_taps(scale: float) -> Float32s:
    """Weights of a Gaussian with a standard deviation in cells, shape (2 reach + 1,), of sum 1."""
    # Beyond 2.5 standard deviations lies one per cent of a Gaussian.
    reach = max(1, int(np.ceil(2.5 * scale - 0.5)))
    taps = np.exp(-(np.arange(-reach, reach + 1) ** 2) / (2 * scale**2))
    return np.asarray(taps / taps.sum(), np.float32)


def gaussian_reach(scale: float) -> int:
    """Reach of a `GridGaussian` to each side in cells."""
    return len(gaussian_taps(scale)) // 2 if scale > 0 else 0


@dataclass(frozen=True, eq=False)
class GridGaussian:
    """Gaussian means over the filled cells of a grid, shape (R, C)."""

    taps: Float32s
    # Cells at which means do not stop; None: charts are so far apart that they need not stop
    reachable: Bools | None
    partial: Int32s  # flat indices of the filled cells that lack a neighbour
    totals: Float32s  # sums of their weights
    cut_means: _ConnectedMeans | None
    threads: int
    first: int = 0  # row of the canvas at which planes begin

    @classmethod
    def of(cls, atlas: Atlas, scale: float, *, stop_at_holes: bool, threads: int) -> GridGaussian:
        """Prepare a standard deviation of `scale` cells: find the cells that lack a neighbour."""
        taps, reachable = gaussian_taps(scale), atlas.is_filled if stop_at_holes else None
        partial, totals = _partial_totals(atlas.kind, taps, threads, stop_at_holes=stop_at_holes)
        cut_means = _ConnectedMeans.of(atlas, taps) if len(atlas.cut_cells) else None
        return cls(taps, reachable, partial, totals, cut_means, threads)

    @property
    def gain(self) -> float:
        """Standard deviation of smoothed white noise of unit variance, away from borders."""
        return float(np.sum(self.taps**2))

    def from_row(self, first: int) -> GridGaussian:
        """Return the Gaussian for planes that begin with row `first`; within reach of their ends, means are wrong."""
        return dataclasses.replace(self, first=first)

    def smooth(self, planes: Float32s) -> Float32s:
        """Smooth planes, shape (N, K, C), which must be 0 where cells are not filled."""
        first, (count, columns) = self.first, planes.shape[1:]
        reachable = None if self.reachable is None else self.reachable[first : first + count]
        smoothed = _convolved(planes, self.taps, reachable, self.threads)
        here = slice(*np.searchsorted(self.partial, [first * columns, (first + count) * columns]))
        partial = self.partial[here] - first * columns
        for plane, result in zip(planes, smoothed, strict=True):
            result.reshape(-1)[partial] /= self.totals[here]
            if self.cut_means is not None:
                self.cut_means.apply(plane, result, first)
        return smoothed


def _partial_totals(
    kind: Uint8s, taps: Float32s, threads: int, *, stop_at_holes: bool
) -> tuple[Int32s, Float32s]:
    """Find the filled cells (flat indices) that lack a neighbour, and the sums of their weights."""
    reach = len(taps) // 2
    # Most cells have all neighbours, where weights sum to 1 up to rounding. The least weight is in a corner.
    enough = 1 - taps[0] ** 2 / 2
    cells, totals = [np.zeros(0, np.int32)], [np.zeros(0, np.float32)]
    # Row by row: whole planes would need the memory that this class saves.
    for rows in large_arrays.blocks(len(kind), SUMMED_ROWS):
        above = min(rows.start, reach)
        band = kind[rows.start - above : rows.stop + reach] != EMPTY
        (total,) = _convolved(band[None].astype(np.float32), taps, band if stop_at_holes else None, threads)
        here = slice(above, above + rows.stop - rows.start)
        total = total[here]
        lacking = np.flatnonzero((total < enough) & band[here])
        cells.append((lacking + rows.start * kind.shape[1]).astype(np.int32))
        totals.append(total.reshape(-1)[lacking])
    return np.concatenate(cells), np.concatenate(totals)


def _convolved(planes: Float32s, taps: Float32s, reachable: Bools | None, threads: int) -> Float32s:
    """Convolve planes; if the unreachable cells are given, stop at them."""
    if reachable is None:
        return convolve(planes, taps, threads)
    along = [_convolve_up_to_holes(plane, reachable, taps) for plane in planes]
    return np.stack([_convolve_up_to_holes(plane.T, reachable.T, taps).T for plane in along])


def _convolve_up_to_holes(plane: Float32s, filled: Bools, taps: Float32s) -> Float32s:
    """Convolve along the first axis, from each cell only up to the next cell that is not filled."""
    reach = len(taps) // 2
    result = np.where(filled, taps[reach] * plane, np.float32(0))
    for ahead in (True, False):
        seen = filled
        for step in range(1, min(reach, len(plane) - 1) + 1):
            near, far = (
                (slice(None, -step), slice(step, None)) if ahead else (slice(step, None), slice(None, -step))
            )
            # All cells from the nearest to the furthest.
            seen = (seen[:-1] if ahead else seen[1:]) & filled[far]
            result[near] += taps[reach + step] * np.where(seen, plane[far], np.float32(0))
    return result


@dataclass(frozen=True, eq=False)
class _ConnectedMeans:
    """Means over the cells of a square window that are connected to its centre inside the window."""

    shape: tuple[int, int]
    weights: Float32s  # of the cells of the window
    cells: Int64s  # cells, not empty, whose window contains a cell at a cut
    reached_bits: Uint8s  # connected cells of each window, as bits

    @classmethod
    def of(cls, atlas: Atlas, taps: Float32s) -> _ConnectedMeans:
        weights, reach = np.outer(taps, taps).reshape(-1), len(taps) // 2
        cells = _near_cuts(atlas, reach)
        reached = [
            np.packbits(_connected_cells(atlas, cells[chunk], reach), axis=1)
            for chunk in _chunks(0, len(cells), len(weights))
        ]
        bits = np.concatenate(reached) if reached else np.zeros((0, 1), np.uint8)
        return cls(atlas.kind.shape, weights, cells, bits)

    def apply(self, plane: Float32s, result: Float32s, first: int = 0) -> None:
        """Write the means of cells near cuts to `result`; `plane` and `result` are canvas rows from `first` on."""
        (rows, columns), size = self.shape, len(self.weights)
        last, reach = first + len(plane), math.isqrt(size) // 2
        top = first + reach if first else 0
        bottom = last - reach if last < rows else last
        begin, end = np.searchsorted(self.cells, [top * columns, max(top, bottom) * columns])
        for chunk in _chunks(begin, end, size):
            cells = self.cells[chunk]
            weights = np.unpackbits(self.reached_bits[chunk], axis=1, count=size) * self.weights
            window = _window(self.shape, cells, reach)[0] - first * columns
            means = np.einsum("kw,kw->k", plane.reshape(-1)[window], weights) / weights.sum(axis=1)
            result.reshape(-1)[cells - first * columns] = means


def _chunks(begin: int, end: int, window: int) -> Iterator[slice]:
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
