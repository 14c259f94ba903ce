"""How many edges away from some vertices the others are."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


class Neighbours:
    """The neighbours of every vertex.

    Parameters
    ----------
    count : int
        Vertices.
    edges : ndarray of int32, shape (E, 2)
        Distinct edges.
    """

    def __init__(self, count: int, edges: NDArray[np.int32]) -> None:
        both = np.concatenate([edges[:, 0], edges[:, 1]])
        order = np.argsort(both, kind="stable")
        self._targets = np.concatenate([edges[:, 1], edges[:, 0]])[order]
        self._offsets = np.zeros(count + 1, np.int64)
        np.cumsum(np.bincount(both, minlength=count), out=self._offsets[1:])

    def rings(self, first: int, last: int, most: int) -> NDArray[np.int32]:
        """Return for each vertex how many edges it is away from those in [first, last); -1: more than `most`."""
        ring = np.full(len(self._offsets) - 1, -1, np.int32)
        ring[first:last] = 0
        front: NDArray[np.int32] = np.arange(first, last, dtype=np.int32)
        for number in range(1, most + 1):
            beside: NDArray[np.int32] = np.unique(self._beside(front))
            front = beside[ring[beside] < 0]
            if not len(front):
                break
            ring[front] = number
        return ring

    def _beside(self, vertices: NDArray[np.int32]) -> NDArray[np.int32]:
        starts = self._offsets[vertices]
        counts = self._offsets[vertices + 1] - starts
        # Entry i of a row of `counts` numbers that begins at `starts`.
        places = np.arange(int(counts.sum())) + np.repeat(starts - (np.cumsum(counts) - counts), counts)
        beside: NDArray[np.int32] = self._targets[places]
        return beside
