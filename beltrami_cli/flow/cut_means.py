"""Gaussian means beside cuts: where the surface ends between two cells, colours behind that edge do not count."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.surface.atlas import EMPTY

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from beltrami_cli.surface.atlas import Atlas

# Row and column of the neighbours whose lengths an atlas keeps: right, below, below right, below left.
_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))
# Window cells that are looked at together: a few ten megabytes.
_AT_ONCE = 1 << 20


class CutMeans:
    """Means over the cells of a square window that can be reached from its middle inside the window.

    Parameters
    ----------
    atlas : Atlas
        With cuts, near which means are taken.
    taps : ndarray of float32, shape (2 r + 1,)
        Weights along rows and along columns.
    """

    def __init__(self, atlas: Atlas, taps: NDArray[np.float32]) -> None:
        self._shape, self._reach = atlas.kind.shape, len(taps) // 2
        self._weights = np.outer(taps, taps).reshape(-1)
        self._cells = self._near(atlas)
        chunks = [self._cells[chunk] for chunk in self._chunks(0, len(self._cells))]
        reached = [np.packbits(self._reached(atlas, cells), axis=1) for cells in chunks]
        self._reached_bits = np.concatenate(reached) if reached else np.zeros((0, 1), np.uint8)

    def apply(self, plane: NDArray[np.float32], result: NDArray[np.float32], first: int = 0) -> None:
        """Put the means of a plane at the cells near cuts into another, in place.

        Parameters
        ----------
        plane, result : ndarray of float32, shape (K, C)
            Rows of the canvas. Where the window of a cell leaves them, and not the canvas, nothing is put.
        first : int
            The first of these rows.
        """
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

    def _near(self, atlas: Atlas) -> NDArray[np.int64]:
        """Find the cells, not empty, whose window holds a cell at a cut."""
        near = np.zeros(atlas.kind.size, bool)
        rows, columns = np.divmod(atlas.cut_cells, self._shape[1])
        for down in range(-self._reach, self._reach + 1):
            for right in range(-self._reach, self._reach + 1):
                row, column = rows + down, columns + right
                inside = (row >= 0) & (row < self._shape[0]) & (column >= 0) & (column < self._shape[1])
                near[row[inside] * self._shape[1] + column[inside]] = True
        return np.flatnonzero(near & (atlas.kind.reshape(-1) != EMPTY)).astype(np.int64)

    def _window(self, cells: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Return the cells of the windows about some cells, shape (K, W), and which of them lie on the canvas."""
        offsets = np.arange(-self._reach, self._reach + 1)
        rows = (cells // self._shape[1])[:, None, None] + offsets[:, None]
        columns = (cells % self._shape[1])[:, None, None] + offsets
        inside = (rows >= 0) & (rows < self._shape[0]) & (columns >= 0) & (columns < self._shape[1])
        flat = np.where(inside, rows * self._shape[1] + columns, cells[:, None, None])
        return flat.reshape(len(cells), -1), inside.reshape(len(cells), -1)

    def _reached(self, atlas: Atlas, cells: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Tell which cells of the windows are reached from their middles over edges, shape (K, W)."""
        side = 2 * self._reach + 1
        window, inside = self._window(cells)
        filled = (inside & (atlas.kind.reshape(-1)[window] != EMPTY)).reshape(-1, side, side)
        reached = np.zeros_like(filled)
        reached[:, self._reach, self._reach] = True
        edges = []
        for lengths, step in zip(atlas.squared_lengths, _STEPS, strict=True):
            here, there = _ends(step)
            joined = np.isfinite(lengths.reshape(-1)[window]).reshape(filled.shape)
            edges.append((here, there, joined[here] & filled[here] & filled[there]))
        before, count = -1, 0
        while before < count:
            for here, there, joined in edges:
                reached[there] |= reached[here] & joined
                reached[here] |= reached[there] & joined
            before, count = count, int(np.count_nonzero(reached))
        return np.asarray(reached.reshape(len(cells), -1), bool)


def _ends(step: tuple[int, int]) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Return the cells of windows at which edges in one direction start, and those at which they end."""
    down, right = step
    rows = (slice(None, -1), slice(1, None)) if down else (slice(None), slice(None))
    columns = {
        1: (slice(None, -1), slice(1, None)),
        0: (slice(None), slice(None)),
        -1: (slice(1, None), slice(None, -1)),
    }[right]
    return (slice(None), rows[0], columns[0]), (slice(None), rows[1], columns[1])
