"""Which edges and triangles some samples of a mesh have, and how far samples are from others along edges."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Int32s, Int64s
from beltrami_cli.surface import large_arrays


def entries(offsets: Int64s, rows: Array) -> tuple[Int64s, Int64s]:
    """Return where some rows of a table have their entries, row after row, and how many each has."""
    starts, counts = offsets[rows], offsets[rows + 1] - offsets[rows]
    return np.arange(int(counts.sum())) + np.repeat(starts - (np.cumsum(counts) - counts), counts), counts


class RowsOfSamples:
    """Rows of numbers of samples, such as edges and triangles, which are found by the samples."""

    # Blocks of samples whose numbers have 16 bits, by which NumPy sorts in linear time.
    _BLOCKS = 1 << 16

    def __init__(self, rows: Int32s, size: int) -> None:
        """Take rows that are sorted already, or in no order."""
        self._size, self._width = size, 1 + size // self._BLOCKS
        block = (reduce(np.minimum, rows.T) // self._width).astype(np.uint16)
        if np.any(block[1:] < block[:-1]):
            rows = large_arrays.kept(rows[np.argsort(block, kind="stable")])
        self._rows, counts = rows, np.bincount(block, minlength=self._BLOCKS)
        self._offsets = np.concatenate([[0], np.cumsum(counts)])

    def among(self, samples: Array) -> tuple[Int32s, Int64s]:
        """Return the rows of some samples, ascending, in the numbers of these; and the place of each row."""
        rank = np.full(self._size, -1, np.int32)
        rank[samples] = np.arange(len(samples))
        blocks = np.flatnonzero(np.bincount(samples // self._width))
        places, _ = entries(self._offsets, blocks)
        rows = rank[self._rows[places]]
        known = reduce(np.logical_and, (rows >= 0).T)
        return rows[known], places[known]


class Neighbours:
    """The neighbours of every sample along edges, shape (E, 2), and how far samples are from others."""

    def __init__(self, count: int, edges: Int32s, lengths_of: Callable[[Int32s], Float32s]) -> None:
        """Take what returns the lengths of edges, shape (K, 2)."""
        both = large_arrays.empty((2, len(edges)), np.int64)
        for own, this, other in zip(both, edges.T, edges.T[::-1], strict=True):
            own[:] = this
            own <<= 32
            own |= other
        both = both.reshape(-1)
        both.sort()
        self._targets = large_arrays.kept(both.astype(np.int32))  # their lower half
        self._offsets = np.zeros(count + 1, np.int64)
        for ends in edges.T:
            self._offsets[1:] += np.bincount(ends, minlength=count)
        np.cumsum(self._offsets, out=self._offsets)
        self._lengths_of = lengths_of

    def first(self, samples: Array, most: int) -> Int64s:
        """Return up to as many neighbours of each of some samples, shape (B, most); -1: no more."""
        starts, ends = self._offsets[samples, None], self._offsets[samples + 1, None]
        places = starts + np.arange(most)
        found = self._targets.take(places, mode="clip") if len(self._targets) else places
        return np.where(places < ends, found, -1).astype(np.int64)

    def distances(self, first: int, last: int, limit: float) -> Float32s:
        """Return how far samples are from the ones in [first, last) along edges; infinite: beyond the limit."""
        found = np.full(len(self._offsets) - 1, np.inf, np.float32)
        found[first:last] = 0
        front: Array = np.arange(first, last, dtype=np.int32)
        while len(front):
            places, counts = entries(self._offsets, front)
            sources, targets = np.repeat(front, counts), self._targets[places]
            leads_on = found[sources] < found[targets]
            sources, targets = sources[leads_on], targets[leads_on]
            after = found[sources] + self._lengths_of(np.stack([sources, targets], axis=1))
            nearer = (after <= limit) & (after < found[targets])
            np.minimum.at(found, targets[nearer], after[nearer])
            front = np.unique(targets[nearer])
        return found
