"""The graph of a mesh and its coarse levels: clusters of neighbouring vertices, and clusters of clusters.

A cluster is a vertex and some of its neighbours. The vertices in the middle are a maximal independent set of the graph
of edges, by priorities that do not depend on the order of the vertices [1]_. Clusters that share an edge are
neighbours, so clusters can be clustered again.

References
----------
.. [1] M. Luby, "A simple parallel algorithm for the maximal independent set problem", SIAM J. Computing 15(4), 1986.
   https://doi.org/10.1137/0215074
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from beltrami_cli._native import PATCH_BLOCK_SIZE, SurfacePatches
from beltrami_cli.arrays import Bools, Float32s, Float64s, Int32s, Int64s
from beltrami_cli.flow.chunks import IN_ONE_PIECE, Chunk, Chunking, Resources
from beltrami_cli.flow.cuts import runs
from beltrami_cli.flow.mesh_gaussian import PASS_SCALE, PASS_VARIANCE, MeshGaussian
from beltrami_cli.surface.geometry import distinct_edges
from beltrami_cli.surface.incidence import Neighbours, RowsOfSamples

# Rings from the start of a group to the samples it estimates: the 200 candidates lie within eight rings, twelve at the
# border of a surface, and the nodes of their patches within four more.
_RINGS_OF_GROUP = 16


@dataclass(frozen=True)
class Graph:
    """Samples joined by edges, with positions and priorities."""

    positions: Float64s  # (S, 3)
    edges: Int32s  # (E, 2)
    priorities: NDArray[np.uint64]  # (S,)
    axes: Float64s = field(default_factory=lambda: np.eye(3)[:2])  # (2, 3), rotate with the model
    threads: int = 1
    # Shape (S,): block in which a group starts at the sample; -1: no group starts there; None: by position.
    blocks: Int32s | None = None
    resources: Resources = IN_ONE_PIECE

    @property
    def size(self) -> int:
        return len(self.positions)

    @cached_property
    def _means(self) -> MeshGaussian:
        same = np.broadcast_to(1.0, len(self.edges))
        return MeshGaussian.of(self.size, self.edges, same, PASS_SCALE, gain=1.0, threads=self.threads)

    @cached_property
    def patches(self) -> SurfacePatches:
        """The patches of all samples, in their tangent planes."""
        return SurfacePatches(
            self.positions, self.edges, self.axes, self.priorities, self.threads, self.blocks
        )

    def __getstate__(self) -> dict[str, object]:
        return {each.name: getattr(self, each.name) for each in dataclasses.fields(self)}

    @property
    def chunking(self) -> Chunking | None:
        return self.resources.chunking_of_mesh(self.size, self.threads)

    @cached_property
    def chunks(self) -> list[Chunk[Graph]]:
        """The chunks in which patches are estimated."""
        chunking, neighbours = self.chunking, Neighbours(self.size, self.edges, _ones)
        assert chunking is not None
        chunks = []
        for first, last in runs(self.size, chunking.count):
            # Groups also estimate samples around their starts, and the choice of starts depends on the patches of the
            # starts around them.
            rings = neighbours.distances(first, last, _RINGS_OF_GROUP + 2)
            samples = np.flatnonzero(np.isfinite(rings)).astype(np.int32)
            chunks.append(Chunk(partial(self._part, samples, first, last), around=samples, place=samples))
        return chunks

    @cached_property
    def _edges_of_samples(self) -> RowsOfSamples:
        return RowsOfSamples(self.edges, self.size)

    def _part(self, samples: Int32s, first: int, last: int) -> Graph:
        """Return the subgraph of some samples, ascending, in which groups start only in [first, last)."""
        starts = (samples >= first) & (samples < last)
        return dataclasses.replace(
            self, positions=self.positions[samples], edges=self._edges_of_samples.among(samples)[0],
            priorities=self.priorities[samples], blocks=np.where(starts, samples // PATCH_BLOCK_SIZE, -1),
            resources=IN_ONE_PIECE,
        )  # fmt: skip

    def smoothed(self, rows: Float32s, variance: float) -> Float32s:
        """Average rows of samples over their neighbours; `variance` of the Gaussian in squared spacings."""
        for _ in range(max(1, round(variance / PASS_VARIANCE))):
            rows = self._means.smooth(rows)
        return rows

    def clustered(self, members: Int32s, centres: Int64s) -> Graph:
        """Return the graph of clusters, which are neighbours if any of their samples are."""
        counts = np.bincount(members)[:, None]
        sums = [np.bincount(members, column) for column in self.positions.T]
        edges = distinct_edges(members[self.edges])
        means = np.stack(sums, axis=1) / counts
        return Graph(
            means, edges, self.priorities[centres], self.axes, self.threads, resources=self.resources
        )

    def clusters(self) -> tuple[Int32s, Int64s]:
        """Return the cluster of each sample, and the sample in the middle of each cluster."""
        rank = np.empty(self.size, np.int64)
        rank[np.argsort(self.priorities, kind="stable")] = np.arange(self.size)
        is_centre = _independent(rank, self.edges)
        centres = np.flatnonzero(is_centre)
        # Centres of high rank have the fewest free neighbours, so they get the vertices that could join several
        # clusters.
        best = np.where(is_centre, rank, -1)
        for this, other in (self.edges.T, self.edges.T[::-1]):
            joins = is_centre[other] & ~is_centre[this]
            np.maximum.at(best, this[joins], rank[other[joins]])
        number = np.empty(self.size, np.int32)
        number[rank[centres]] = np.arange(len(centres))
        return number[best], centres


def _ones(edges: Int32s) -> Float32s:
    return np.ones(len(edges), np.float32)


def sums_around(rows: Float64s, edges: Int32s) -> Float64s:
    """Sum rows of samples, shape (S, K), over the neighbours of each."""
    (low, high), count = edges.T, len(rows)
    sums = [
        np.bincount(low, column[high], count) + np.bincount(high, column[low], count) for column in rows.T
    ]
    return np.stack(sums, axis=1)


def _independent(rank: Int64s, edges: Int32s) -> Bools:
    """Return a maximal independent set: in each round, the samples of lower rank than all of their neighbours."""
    chosen = np.zeros(len(rank), bool)
    is_open, left = np.ones(len(rank), bool), edges
    while is_open.any():
        least = np.full(len(rank), len(rank))
        for this, other in (left.T, left.T[::-1]):
            np.minimum.at(least, this, rank[other])
        is_least = is_open & (rank < least)
        chosen |= is_least
        is_open &= ~is_least
        for this, other in (left.T, left.T[::-1]):
            is_open[this[is_least[other]]] = False
        left = left[is_open[left].all(axis=1)]
    return chosen


@dataclass(frozen=True)
class Level:
    """Single samples, or clusters of about four, twenty, ... of them."""

    graph: Graph
    members: Int32s  # (S,): the cluster of each sample
    centres: Int64s  # the sample in the middle of each cluster

    @cached_property
    def counts(self) -> Float32s:
        return np.bincount(self.members, minlength=self.graph.size).astype(np.float32)

    def means(self, rows: Float32s) -> Float32s:
        sums = [np.bincount(self.members, column, self.graph.size) for column in rows.T]
        return np.stack([(column / self.counts).astype(np.float32) for column in sums], axis=1)


def levels_of(samples: Graph) -> Iterator[Level]:
    """Yield levels from fine to coarse, beginning with single samples."""
    graph, members = samples, np.arange(samples.size, dtype=np.int32)
    centres = members.astype(np.int64)
    while True:
        yield Level(graph, members, centres)
        cluster_of, middles = graph.clusters()
        graph, members, centres = graph.clustered(cluster_of, middles), cluster_of[members], centres[middles]
