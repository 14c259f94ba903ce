"""The geometry of a triangulated surface; its samples are sorted for cache locality."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar, TypeAlias

import numpy as np

from beltrami_cli._native import SegmentManifold, TriangulatedManifold, vertex_order
from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Indices, Int32s, Uint8s
from beltrami_cli.flow.chunks import Resources
from beltrami_cli.flow.manifolds.geometry import ENOUGH_DIFFERENCES, Geometry, Stack
from beltrami_cli.flow.manifolds.iteration import Metric
from beltrami_cli.flow.manifolds.mesh.fingerprints import fingerprints, quantised
from beltrami_cli.flow.manifolds.mesh.kernel_work import MeshWork
from beltrami_cli.flow.mesh_gaussian import MeshGaussian
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.flow.vertex_graph import Graph
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import OWNED
from beltrami_cli.surface.geometry import (
    distinct_edges,
    edges_in_space,
    local_spacing,
    mean_side,
    vertex_areas,
)
from beltrami_cli.surface.incidence import RowsOfSamples
from beltrami_cli.surface.large_arrays import kept
from beltrami_cli.surface.records import SampledSurface

KernelSolver: TypeAlias = SegmentManifold | TriangulatedManifold


@dataclass(frozen=True, eq=False)
class MeshMetric(Metric):
    """The metric of a whole mesh, induced by positions and features."""

    positions: Float64s
    features: Float32s
    beta: float  # units of length per unit of the features


@dataclass(kw_only=True, eq=False)
class MeshGeometry(Geometry):
    """Vertices, triangles and edges; stacks have one row per vertex."""

    axis: ClassVar[int] = 1

    order: Int32s  # the caller's number of each sample
    positions: Float64s
    faces: Int32s
    edges: Int32s  # without bridges over hard colour edges
    lengths: Float64s  # of edges, in spacings around them
    spacing: float
    scales: Float32s | None  # factors of lengths that scale the local spacing to 1
    weights: Float32s | None  # areas
    is_along_segments: bool
    threads: int
    gain: float | None = None  # of the regularised metric of the whole surface; None: its own

    _solver: tuple[KernelSolver, MeshMetric | None] | None = field(default=None, init=False)

    @classmethod
    def of(cls, surface: SampledSurface, parameters: KernelParameters) -> MeshGeometry:
        order = vertex_order(surface.positions, surface.all_faces)
        rank, positions = rank_in(order), kept(surface.positions[order])
        faces = kept(rank[surface.all_faces])
        length = mean_side(surface.positions, surface.faces) if parameters.units == "world" else 1.0
        edges, lengths = edges_in_space(distinct_edges(faces), positions)
        spacing = local_spacing(len(order), edges, lengths)
        mean = float(lengths.mean()) if len(lengths) else 0.0
        for block in large_arrays.blocks(len(edges)):
            low, high = edges[block].T
            lengths[block] /= np.sqrt(spacing[low] * spacing[high])
        return cls(
            order=order, positions=positions, faces=faces, edges=edges,
            lengths=lengths, spacing=mean,
            scales=(1 / spacing).astype(np.float32) if parameters.units == "spacing" else None,
            weights=vertex_areas(positions, rank[surface.faces]) if parameters.weights == "area" else None,
            is_along_segments=parameters.is_along_segments(length), threads=parameters.thread_count,
        )  # fmt: skip

    @property
    def size(self) -> int:
        return len(self.positions)

    @property
    def shape(self) -> tuple[int, ...]:
        return (self.size,)

    @property
    def kernels(self) -> int:
        return self.size

    @property
    def kind(self) -> Uint8s:
        return np.broadcast_to(np.uint8(OWNED), (self.size, 1))

    def solver_with(self, metric: MeshMetric, threads: int) -> KernelSolver:
        """Return the solver of the compiled core, which has one metric at a time, set to this metric."""
        kind = SegmentManifold if self.is_along_segments else TriangulatedManifold
        solver, last = self._solver or (kind(self.faces, self.size), None)
        if last is not metric:
            solver.update_metric(metric.positions, metric.features, metric.beta, self.scales, threads)
            self._solver = solver, metric
        return solver

    def refresh(self, stack: Stack) -> None:
        """No sample of a mesh repeats another."""

    def drop_distances(self) -> None:
        self._solver = None

    def drop_samples(self) -> None:
        """Their order is not computed again."""

    def __getstate__(self) -> dict[str, object]:
        fields = {each.name: getattr(self, each.name) for each in dataclasses.fields(self)}
        return {**fields, "_solver": None}

    def graph(self, colours: Stack, resources: Resources) -> Graph:
        """Return the graph of the samples, with priorities from the colours."""
        joined, places = self._is_joined(), kept(_in_three_dimensions(self.positions))
        axes = _axes(places, colours) if joined.all() else _axes(places[joined], colours[joined])
        priorities = kept(fingerprints(quantised(colours), self.edges))
        return Graph(places, self.edges, priorities, axes, self.threads, resources=resources)

    def scaled_lengths(self, edges: Int32s) -> Float32s:
        """Return the lengths of edges in the unit of length of the parameters, shape (E,)."""
        low, high = edges.T
        lengths = np.linalg.norm(self.positions[low] - self.positions[high], axis=1)
        if self.scales is not None:
            lengths *= np.sqrt(self.scales[low] * self.scales[high])
        return np.asarray(lengths, np.float32)

    def cut(self, samples: Array) -> MeshGeometry:
        """Cut out some samples, ascending."""
        (faces, _), (edges, rows) = (each.among(samples) for each in self._rows)
        scales, weights = self.scales, self.weights
        return dataclasses.replace(
            self, order=np.zeros(0, self.order.dtype),
            positions=self.positions[samples],
            faces=faces, edges=edges, lengths=self.lengths[rows],
            scales=None if scales is None else scales[samples],
            weights=None if weights is None else weights[samples],
        )  # fmt: skip

    @cached_property
    def _rows(self) -> tuple[RowsOfSamples, RowsOfSamples]:
        """Triangles and edges, indexed by sample."""
        return RowsOfSamples(self.faces, self.size), RowsOfSamples(self.edges, self.size)

    def in_order(self, rows: Array) -> Array:
        """Restore the caller's order of rows."""
        ordered = np.empty_like(rows)
        ordered[self.order] = rows
        return ordered

    def work(self, unit: float) -> MeshWork:
        return MeshWork(self.size, unit, self.edges, len(self.faces))

    def take(self, stack: Stack, samples: Indices) -> Float32s:
        return stack[samples]

    def differences(self, stack: Stack) -> Float32s:
        low, high = self.edges[:: 1 + len(self.edges) // ENOUGH_DIFFERENCES].T
        differences: Float32s = stack[low] - stack[high]
        return differences

    def isolated(self, marked: Bools) -> Bools:
        isolated = marked.copy()
        isolated[self.edges[marked[self.edges].all(axis=1)]] = False
        return isolated

    def smoothable(self, colours: Stack) -> tuple[Float32s, int]:
        """Return the channels of all samples but isolated ones, which keep their colours."""
        return np.ascontiguousarray(colours[self._is_joined()].T), 0

    def gaussian(self, scale: float) -> MeshGaussian:
        return MeshGaussian.of(self.size, self.edges, self.lengths, scale, self.gain, self.threads)

    def _is_joined(self) -> Bools:
        joined = np.zeros(self.size, bool)
        joined[self.edges] = True
        return joined


def rank_in(order: Int32s) -> Int32s:
    """Return the position of each sample in an order of all samples."""
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order), dtype=rank.dtype)
    return rank


def _in_three_dimensions(positions: Float64s) -> Float64s:
    """Pad positions with zeros, or project them on their three principal directions."""
    if positions.shape[1] > 3:
        offsets = positions - positions.mean(axis=0)
        directions = np.linalg.eigh(np.einsum("ij,ik->jk", offsets, offsets))[1]
        return np.ascontiguousarray(np.einsum("ij,jk->ik", offsets, directions[:, -3:]))
    places = np.zeros((len(positions), 3))
    places[:, : positions.shape[1]] = positions
    return places


def _axes(positions: Float64s, colours: Float32s) -> Float64s:
    """Two directions that rotate with the model, shape (2, 3): to brighter and to more intense colours."""
    if not len(positions):
        return np.eye(3)[:2]
    offsets = positions - positions.mean(axis=0)
    level = colours.sum(axis=1, dtype=np.float64)
    level -= level.mean()
    return np.stack([np.einsum("i,ij->j", weights, offsets) for weights in (level, level**2)])
