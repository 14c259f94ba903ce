"""Means of clusters of neighbouring vertices, at which plain colours are estimated better than vertex by vertex.

A cluster is a vertex and neighbours of it: the vertices in the middle form a maximal independent set of the graph of
edges, by priorities that do not depend on the order of the vertices [1]_. Clusters that share an edge are neighbours,
so clusters can be clustered again.

References
----------
.. [1] M. Luby, "A simple parallel algorithm for the maximal independent set problem", SIAM J. Computing 15(4), 1986.
   https://doi.org/10.1137/0215074
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from beltrami_cli.flow.manifold import CoarseLevel
from beltrami_cli.flow.regularisation import MeshGaussian

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.arrays import Bools, Float32s, Float64s, Int32s, Int64s
    from beltrami_cli.flow.manifold import Stack
    from beltrami_cli.flow.records import Mixing

# Clusters of clusters are the largest: some twenty samples. Fewer of them hold no patches that could be compared.
_LEVELS, _FEWEST = 2, 500

# Standard deviation of the Gaussian of one pass over neighbours, in spacings: all count about alike. On a triangle
# lattice a pass adds so many squared spacings to the variance.
_FLAT, _PASS = 3.0, 0.43


@dataclass(frozen=True)
class Graph:
    """Samples joined by edges, with their places and priorities."""

    positions: Float64s  # (S, 3)
    edges: Int32s  # (E, 2)
    priorities: NDArray[np.uint64]  # (S,)

    @property
    def size(self) -> int:
        """The number of samples."""
        return len(self.positions)

    def clustered(self, members: Int32s, centres: Int64s) -> Graph:
        """Return the clusters of samples, joined where any of their samples are."""
        counts = np.bincount(members)[:, None]
        sums = [np.bincount(members, column) for column in self.positions.T]
        ends = np.sort(members[self.edges], axis=1).astype(np.int64)
        ends = ends[ends[:, 0] != ends[:, 1]]
        pairs = np.sort(ends[:, 0] * len(centres) + ends[:, 1])
        pairs = pairs[np.diff(pairs, prepend=-1) > 0]  # unlike numpy.unique, this loads no other module
        edges = np.stack(np.divmod(pairs, len(centres)), axis=1).astype(np.int32)
        return Graph(np.stack(sums, axis=1) / counts, edges, self.priorities[centres])

    def clusters(self) -> tuple[Int32s, Int64s]:
        """Return the cluster of each sample, and the samples in the middle of clusters."""
        rank = np.empty(self.size, np.int64)
        rank[np.argsort(self.priorities, kind="stable")] = np.arange(self.size)
        is_centre = _independent(rank, self.edges)
        centres = np.flatnonzero(is_centre)
        # Centres of high rank have the fewest neighbours left, so they get those that could join several.
        best = np.where(is_centre, rank, -1)
        for this, other in (self.edges.T, self.edges.T[::-1]):
            joins = is_centre[other] & ~is_centre[this]
            np.maximum.at(best, this[joins], rank[other[joins]])
        number = np.empty(self.size, np.int32)
        number[rank[centres]] = np.arange(len(centres))
        return number[best], centres


def _independent(rank: Int64s, edges: Int32s) -> Bools:
    """Return a maximal independent set: samples of lower rank than all neighbours, round by round."""
    chosen = np.zeros(len(rank), bool)
    is_open, left = np.ones(len(rank), bool), edges
    while is_open.any():
        least = np.full(len(rank), len(rank))
        for this, other in (left.T, left.T[::-1]):
            np.minimum.at(least, this, rank[other])
        found = is_open & (rank < least)
        chosen |= found
        is_open &= ~found
        for this, other in (left.T, left.T[::-1]):
            is_open[this[found[other]]] = False
        left = left[is_open[left].all(axis=1)]
    return chosen


class Clusters(CoarseLevel):
    """Means of clusters of samples, as a stack with a row a cluster."""

    axis: ClassVar[int] = 1
    width: ClassVar[float] = 3.0

    def __init__(
        self,
        samples: Graph,
        graph: Graph,
        members: Int32s,
        axes: Float64s,
        differing: Float32s | None,
        threads: int,
    ) -> None:
        from beltrami_cli._native import SurfacePatches

        self._samples, self._graph, self._members, self._threads = samples, graph, members, threads
        self._counts = np.bincount(members, minlength=graph.size).astype(np.float32)
        self.noise = float(1 / self._counts.mean())
        self._patches = SurfacePatches(graph.positions, graph.edges, axes, graph.priorities, threads)
        ones = np.ones((samples.size, 1), np.float32)
        self.relative = self.means(ones if differing is None else differing)[:, 0]

    def means(self, stack: Stack) -> Float32s:
        """Return the means of rows of samples."""
        sums = [np.bincount(self._members, column, self._graph.size) for column in stack.T]
        return np.stack([(own / self._counts).astype(np.float32) for own in sums], axis=1)

    def collaborate(self, noisy: Stack, pilot: Stack, mixing: Mixing) -> Stack:
        """Estimate means from patches of clusters in tangent planes."""
        estimates, weights = np.zeros_like(noisy), np.zeros_like(noisy)
        own = mixing.forth, mixing.back, mixing.variances
        relative = self.relative / (self._counts * np.float32(self.noise))
        self._patches.collaborate(
            noisy, pilot, own, relative, mixing.has_pilot, estimates, weights, self._threads, None
        )
        return estimates

    def add_enlarged(self, stack: Stack, changes: Stack) -> None:
        """Add changes of clusters to their samples, smoothed as far as linear interpolation smooths squares."""
        variance = 1 / (12 * self.noise)
        stack += _smoothed(self._samples, changes[self._members], variance)

    def planes(self, count: int) -> Float32s:
        """Return rows of zeros."""
        return np.zeros((count, self._graph.size), np.float32)

    def total(self, planes: Float32s) -> Float64s:
        """Sum rows over all samples."""
        return np.asarray(np.sum(planes * self._counts, axis=1, dtype=np.float64))

    def spread(self, planes: Float32s) -> Float32s:
        """Average rows over the clusters around."""
        rows = np.ascontiguousarray((planes * (self._counts * np.float32(self.noise))).T)
        return np.ascontiguousarray(_smoothed(self._graph, rows, self.width**2).T)


def _smoothed(graph: Graph, rows: Float32s, variance: float) -> Float32s:
    """Smooth rows of samples over their neighbours; `variance` in squared spacings."""
    means = MeshGaussian(graph.size, graph.edges, np.ones(len(graph.edges)), _FLAT, gain=1.0)
    for _ in range(max(1, round(variance / _PASS))):
        rows = means.smooth(rows)
    return rows


def clusters_for(samples: Graph, axes: Float64s, differing: Float32s | None, threads: int) -> list[Clusters]:
    """Return the levels of clusters, coarse to fine, that hold enough of them; `axes`: see `SurfacePatches`."""
    found: list[Clusters] = []
    graph, members = samples, np.arange(samples.size, dtype=np.int32)
    for _ in range(_LEVELS):
        own, centres = graph.clusters()
        if len(centres) < _FEWEST:
            break
        graph, members = graph.clustered(own, centres), own[members]
        found.insert(0, Clusters(samples, graph, members, axes, differing, threads))
    return found
