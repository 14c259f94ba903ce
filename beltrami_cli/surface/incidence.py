"""Incidence of edges and triangles with samples, and distances along edges."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Int32s, Int64s
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.ranges import entries


class RowsOfSamples:
    """Rows of sample numbers, such as edges and triangles, indexed by sample."""

    # Blocks of samples with 16-bit numbers, which NumPy sorts in linear time.
    _BLOCKS = 1 << 16

    def __init__(self, rows: Int32s, size: int) -> None:
        """Index rows, sorted or not."""
        self._size, self._width = size, 1 + size // self._BLOCKS
        block = (reduce(np.minimum, rows.T) // self._width).astype(np.uint16)
        if np.any(block[1:] < block[:-1]):
            rows = large_arrays.kept(rows[np.argsort(block, kind="stable")])
        self._rows, counts = rows, np.bincount(block, minlength=self._BLOCKS)
        self._offsets = np.concatenate([[0], np.cumsum(counts)])

    def among(self, samples: Array) -> tuple[Int32s, Int64s]:
        """Return the rows between some samples, ascending, renumbered to these; and the index of each row."""
        rank = np.full(self._size, -1, np.int32)
        rank[samples] = np.arange(len(samples))
        blocks = np.flatnonzero(np.bincount(samples // self._width))
        places, _ = entries(self._offsets, blocks)
        rows = rank[self._rows[places]]
        known = reduce(np.logical_and, (rows >= 0).T)
        return rows[known], places[known]


class Neighbours:
    """The neighbours of samples along edges, shape (E, 2), and distances along edges."""

    def __init__(self, count: int, edges: Int32s, lengths_of: Callable[[Int32s], Float32s]) -> None:
        """Take a function that returns the lengths of edges, shape (K, 2)."""
        both = large_arrays.empty((2, len(edges)), np.int64)
        for keys, this, other in zip(both, edges.T, edges.T[::-1], strict=True):
            keys[:] = this
            keys <<= 32
            keys |= other
        both = both.reshape(-1)
        both.sort()
        self._targets = large_arrays.kept(both.astype(np.int32))  # the sample in the lower half
        self._offsets = np.zeros(count + 1, np.int64)
        for ends in edges.T:
            self._offsets[1:] += np.bincount(ends, minlength=count)
        np.cumsum(self._offsets, out=self._offsets)
        self._lengths_of = lengths_of

    def first(self, samples: Array, most: int) -> Int64s:
        """Return up to `most` neighbours of each sample, shape (B, most), padded by -1."""
        starts, ends = self._offsets[samples, None], self._offsets[samples + 1, None]
        places = starts + np.arange(most)
        neighbours = self._targets.take(places, mode="clip") if len(self._targets) else places
        return np.where(places < ends, neighbours, -1).astype(np.int64)

    def distances(self, first: int, last: int, limit: float) -> Float32s:
        """Return the distances along edges to the nearest sample in [first, last); infinite beyond the limit."""
        distances = np.full(len(self._offsets) - 1, np.inf, np.float32)
        distances[first:last] = 0
        front: Array = np.arange(first, last, dtype=np.int32)
        while len(front):
            places, counts = entries(self._offsets, front)
            sources, targets = np.repeat(front, counts), self._targets[places]
            leads_on = distances[sources] < distances[targets]
            sources, targets = sources[leads_on], targets[leads_on]
            after = distances[sources] + self._lengths_of(np.stack([sources, targets], axis=1))
            nearer = (after <= limit) & (after < distances[targets])
            np.minimum.at(distances, targets[nearer], after[nearer])
            front = np.unique(targets[nearer])
        return distances
