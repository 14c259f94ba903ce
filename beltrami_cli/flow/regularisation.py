"""The regularised metric: distances are taken from slightly smoothed colours, so that noise does not cause them.

Averages are still taken over the colours themselves. Smoothing reduces the noise in the metric by a known gain, and
beta is divided by it, so that noise adds the same to distances with and without it and beta keeps its meaning.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s, Int32s, Int64s
from beltrami_cli.surface.atlas import EMPTY, STEPS, Atlas, ends_of

_ROWS = 256  # of a grid that are processed together


class MeshGaussian:
    """Gaussian means over the neighbours of each vertex; `lengths` and `scale` (sigma) in sample spacings."""

    def __init__(
        self, count: int, edges: Int32s, lengths: Float64s, scale: float, gain: float | None = None
    ) -> None:
        # Edges with a length in space only, not those of hard colour edges.
        self._edges, self._count = edges, count
        self._weights = np.exp(-(lengths**2) / (2 * scale**2)).astype(np.float32)
        self._total = 1 + self._gather(self._weights)
        # Remaining standard deviation of white noise.
        self.gain = self._mean_gain() if gain is None else gain

    def _mean_gain(self) -> float:
        gains = np.sqrt(1 + self._gather(self._weights**2)) / self._total
        joined = self._total > 1  # vertices without neighbours keep their noise, and do not count
        return float(gains[joined].mean()) if joined.any() else 1.0

    def smooth(self, colours: Float32s) -> Float32s:
        """Smooth colours of shape (count, N)."""
        from beltrami_cli._native import neighbour_means

        return neighbour_means(colours, self._edges, self._weights, self._total)

    def _gather(self, weights: Float32s) -> Float64s:
        low, high = self._edges.T
        sums = np.bincount(low, weights, self._count) + np.bincount(high, weights, self._count)
        return np.asarray(sums, np.float64)


class GridGaussian:
    """Gaussian means of standard deviation `scale`, in cells, over the filled cells of a grid, shape (R, C)."""

    def __init__(
        self,
        filled: Bools,
        scale: float,
        *,
        stop_at_holes: bool = False,
        atlas: Atlas | None = None,
        threads: int = 1,
    ) -> None:
        self._threads, self._first = threads, 0
        self._taps = gaussian_taps(scale)
        # Means stop at cells that are not filled. Textures, whose charts keep their distance, do without.
        self._open = filled if stop_at_holes else None
        self.gain = float(
            np.sum(self._taps**2)
        )  # remaining standard deviation of white noise, away from borders
        self._partial, self._part = self._partial_totals(filled)
        self._cut_means = None if atlas is None or not len(atlas.cut_cells) else CutMeans(atlas, self._taps)

    def from_row(self, first: int) -> GridGaussian:
        """Return the same means for planes that begin with row `first`; within reach of their ends they are wrong."""
        part = copy(self)
        part._first = first
        return part

    def smooth(self, planes: Float32s) -> Float32s:
        """Smooth planes, shape (N, K, C), which must be 0 where cells are not filled."""
        first, (count, columns) = self._first, planes.shape[1:]
        smoothed = self._convolve(planes, None if self._open is None else self._open[first : first + count])
        here = slice(*np.searchsorted(self._partial, [first * columns, (first + count) * columns]))
        partial = self._partial[here] - first * columns
        for plane, result in zip(planes, smoothed, strict=True):
            result.reshape(-1)[partial] /= self._part[here]
            if self._cut_means is not None:
                self._cut_means.apply(plane, result, first)
        return smoothed

    def _partial_totals(self, filled: Bools) -> tuple[Int32s, Float32s]:
        """Find the filled cells (flat indices) that lack a neighbour, and their total weights."""
        reach = len(self._taps) // 2
        # Most cells have all neighbours: weights sum to 1 but for rounding. The lightest neighbour is in a corner.
        enough = 1 - self._taps[0] ** 2 / 2
        cells, totals = [np.zeros(0, np.int32)], [np.zeros(0, np.float32)]
        for first in range(0, len(filled), _ROWS):  # whole planes would take the memory that this saves
            above = min(first, reach)
            band = filled[first - above : first + _ROWS + reach]
            total = self._convolve(band[None].astype(np.float32), None if self._open is None else band)[0]
            total = total[above : above + _ROWS]
            lacking = np.flatnonzero((total < enough) & filled[first : first + _ROWS])
            cells.append((lacking + first * filled.shape[1]).astype(np.int32))
            totals.append(total.reshape(-1)[lacking])
        return np.concatenate(cells), np.concatenate(totals)

    def _convolve(self, planes: Float32s, filled: Bools | None) -> Float32s:
        """Convolve planes, up to holes if `filled` is given."""
        if filled is None:
            from beltrami_cli._native import convolve

            return convolve(planes, self._taps, self._threads)
        along = [_convolve_up_to_holes(plane, filled, self._taps) for plane in planes]
        return np.stack([_convolve_up_to_holes(plane.T, filled.T, self._taps).T for plane in along])


def _convolve_up_to_holes(plane: Float32s, filled: Bools, taps: Float32s) -> Float32s:
    """Convolve along the first axis, from each cell only up to the next that is not filled."""
    reach = len(taps) // 2
    result = np.where(filled, taps[reach] * plane, np.float32(0))
    for ahead in (True, False):
        seen = filled
        for step in range(1, min(reach, len(plane) - 1) + 1):
            near, far = (
                (slice(None, -step), slice(step, None)) if ahead else (slice(step, None), slice(None, -step))
            )
            seen = (seen[:-1] if ahead else seen[1:]) & filled[
                far
            ]  # all cells from the near one to the far one
            result[near] += taps[reach + step] * np.where(seen, plane[far], np.float32(0))
    return result


def guide_radius(scale: float) -> int:
    """Return how many cells a `GridGaussian` reaches to each side."""
    return len(gaussian_taps(scale)) // 2 if scale > 0 else 0


def gaussian_taps(scale: float) -> Float32s:
    """Return the weights of a Gaussian of a standard deviation in cells, shape (2 reach + 1,), with the sum 1."""
    # Beyond 2.5 standard deviations lies one per cent of a Gaussian.
    reach = max(1, int(np.ceil(2.5 * scale - 0.5)))
    taps = np.exp(-(np.arange(-reach, reach + 1) ** 2) / (2 * scale**2))
    return np.asarray(taps / taps.sum(), np.float32)


# Window cells that are processed together: some tens of megabytes.
_AT_ONCE = 1 << 20


class CutMeans:
    """Means over the cells of a square window that can be reached from its centre inside the window."""

    def __init__(self, atlas: Atlas, taps: Float32s) -> None:
        self._shape, self._reach = atlas.kind.shape, len(taps) // 2
        self._weights = np.outer(taps, taps).reshape(-1)
        self._cells = self._near(atlas)
        chunks = [self._cells[chunk] for chunk in self._chunks(0, len(self._cells))]
        reached = [np.packbits(self._reached(atlas, cells), axis=1) for cells in chunks]
        self._reached_bits = np.concatenate(reached) if reached else np.zeros((0, 1), np.uint8)

    def apply(self, plane: Float32s, result: Float32s, first: int = 0) -> None:
        """Write the means at cells near cuts to `result`; `plane` and `result` are canvas rows from `first` on."""
        rows, columns = self._shape
        last = first + len(plane)
        top = first + self._reach if first else 0
        bottom = last - self._reach if last < rows else last
        begin, end = np.searchsorted(self._cells, [top * columns, max(top, bottom) * columns])
        for chunk in self._chunks(begin, end):
            cells = self._cells[chunk]
            weights = (
                np.unpackbits(self._reached_bits[chunk], axis=1, count=len(self._weights)) * self._weights
            )
            window = self._window(cells)[0] - first * columns
            means = np.einsum("kw,kw->k", plane.reshape(-1)[window], weights) / weights.sum(axis=1)
            result.reshape(-1)[cells - first * columns] = means

    def _chunks(self, begin: int, end: int) -> Iterator[slice]:
        size = max(1, _AT_ONCE // len(self._weights))
        for first in range(begin, end, size):
            yield slice(first, min(first + size, end))

    def _near(self, atlas: Atlas) -> Int64s:
        """Find the cells, not empty, whose window holds a cell at a cut."""
        near = np.zeros(atlas.kind.size, bool)
        rows, columns = np.divmod(atlas.cut_cells, self._shape[1])
        for down in range(-self._reach, self._reach + 1):
            for right in range(-self._reach, self._reach + 1):
                row, column = rows + down, columns + right
                inside = (row >= 0) & (row < self._shape[0]) & (column >= 0) & (column < self._shape[1])
                near[row[inside] * self._shape[1] + column[inside]] = True
        return np.flatnonzero(near & (atlas.kind.reshape(-1) != EMPTY)).astype(np.int64)

    def _window(self, cells: Int64s) -> tuple[Int64s, Bools]:
        """Return the cells of the windows around some cells, shape (K, W), and which of them lie on the canvas."""
        offsets = np.arange(-self._reach, self._reach + 1)
        rows = (cells // self._shape[1])[:, None, None] + offsets[:, None]
        columns = (cells % self._shape[1])[:, None, None] + offsets
        inside = (rows >= 0) & (rows < self._shape[0]) & (columns >= 0) & (columns < self._shape[1])
        flat = np.where(inside, rows * self._shape[1] + columns, cells[:, None, None])
        return flat.reshape(len(cells), -1), inside.reshape(len(cells), -1)

    def _reached(self, atlas: Atlas, cells: Int64s) -> Bools:
        """Return which cells of the windows can be reached from their centres over edges, shape (K, W)."""
        side = 2 * self._reach + 1
        window, inside = self._window(cells)
        filled = (inside & (atlas.kind.reshape(-1)[window] != EMPTY)).reshape(-1, side, side)
        reached = np.zeros_like(filled)
        reached[:, self._reach, self._reach] = True
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
