"""The image manifold of colours on a triangulated surface."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from beltrami_cli._native import PATCH_BLOCK_SIZE
from beltrami_cli.arrays import Array, Float32s, Int32s
from beltrami_cli.flow.chunks import IN_ONE_PIECE, Chunk, Chunking, KernelCounts, Resources
from beltrami_cli.flow.cuts import runs
from beltrami_cli.flow.manifolds.geometry import Gaussian, Stack
from beltrami_cli.flow.manifolds.guides import Guide, GuideStack
from beltrami_cli.flow.manifolds.iteration import (
    Averaged,
    Metric,
    SampledKernel,
    Step,
    at_step,
    kernel_values,
)
from beltrami_cli.flow.manifolds.manifold import Manifold, PartAndCore, SampleTrial
from beltrami_cli.flow.manifolds.mesh.fingerprints import fingerprints, quantised
from beltrami_cli.flow.manifolds.mesh.geometry import KernelSolver, MeshGeometry, MeshMetric, rank_in
from beltrami_cli.flow.manifolds.mesh.kernel_work import without_hubs
from beltrami_cli.flow.manifolds.mesh.levels import Clusters, clusters_for
from beltrami_cli.flow.manifolds.mesh.patches import collaborate_on_graph
from beltrami_cli.flow.manifolds.mesh.perturbations import draw_perturbations
from beltrami_cli.flow.manifolds.mesh.regions import SingleSamples
from beltrami_cli.flow.manifolds.mesh.trial import choose_discs
from beltrami_cli.flow.manifolds.metric_channels import MetricChannels, gaussian_for, joined_channels
from beltrami_cli.flow.manifolds.moving_positions import MovingPositions, PositionParameters
from beltrami_cli.flow.manifolds.new_colours import NewColours
from beltrami_cli.flow.manifolds.search_range import ON_MESHES, RULE_ON_MESHES, wanted_probes
from beltrami_cli.flow.manifolds.stabilised_colours import StabilisedColours
from beltrami_cli.flow.mixing import Mixing
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.flow.vertex_graph import Graph
from beltrami_cli.surface.geometry import distinct_edges
from beltrami_cli.surface.incidence import Neighbours
from beltrami_cli.surface.large_arrays import Droppable, kept
from beltrami_cli.surface.records import SampledSurface

# Ratio of path lengths along edges to straight ones: up to 1.16 on a triangular lattice, and seldom more than 1.5
# elsewhere. Samples missed by that are at the ends of kernels, where weights are least.
_STRETCH = 1.5

# Margin of a chunk beyond its kernels, in sample spacings: the triangles around the last samples determine the reach of
# segments and unfolded corners, and the regularised metric averages colours over neighbours.
_CHUNK_MARGIN = 5.0


@dataclass(frozen=True, kw_only=True, eq=False)
class ColouredMesh:
    """A mesh, the input's colours of its samples, and the guides of their smoothing."""

    geometry: MeshGeometry
    colours: Stack
    parameters: KernelParameters
    deviations: Float32s | None = None  # given standard deviations of the noise, one row per sample
    is_light: bool = False  # whether colours stand for light
    guides: Sequence[Guide] = ()  # in the caller's order
    metric_channels: Sequence[int] | None = None
    moving: MovingPositions | None = None
    resources: Resources = IN_ONE_PIECE

    @classmethod
    def of(
        cls, surface: SampledSurface, parameters: KernelParameters, *,
        guides: Sequence[Guide] = (), metric_channels: Sequence[int] | None = None,
        moving: PositionParameters | None = None, deviations: Float32s | None = None, is_light: bool = False,
        resources: Resources = IN_ONE_PIECE,
    ) -> ColouredMesh:  # fmt: skip
        """Sort the samples of a surface; with `moving`, positions are smoothed, too."""
        mesh = MeshGeometry.of(surface, parameters)
        order, positions = mesh.order, None
        if moving is not None:
            positions = MovingPositions.of(
                mesh.positions, rank_in(order)[surface.faces], mesh.edges, spacing=mesh.spacing or 1.0,
                unit=mesh.unit(parameters),
                parameters=PositionParameters(moving.places[order], moving.normal_beta),
            )  # fmt: skip
        return cls(
            geometry=mesh, colours=kept(surface.colours[order]), parameters=parameters,
            deviations=None if deviations is None else deviations[order], is_light=is_light,
            guides=guides, metric_channels=metric_channels, moving=positions, resources=resources,
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class MeshColours(StabilisedColours):
    """Stabilised colours on a mesh, and the graph of samples, with priorities from the input's colours."""

    graph: Graph


def mesh_manifold(mesh: ColouredMesh, colours: MeshColours) -> MeshManifold:
    """Make the image manifold of colours of a mesh."""
    geometry, unit = mesh.geometry, mesh.geometry.unit(mesh.parameters)
    return MeshManifold(
        geometry=geometry, colours=colours.stack, noise=colours.noise, parameters=mesh.parameters, unit=unit,
        metric_channels=slice(None) if mesh.metric_channels is None else list(mesh.metric_channels),
        guides=tuple(GuideStack.of(guide, guide.values[geometry.order], geometry, unit) for guide in mesh.guides),
        moving=mesh.moving, outliers=colours.outliers, graph=colours.graph,
        resources=mesh.resources,
    )  # fmt: skip


_NO_GRAPH = Graph(np.zeros((0, 3)), np.zeros((0, 2), np.int32), np.zeros(0, np.uint64))


@dataclass(frozen=True, kw_only=True, eq=False)
class MeshManifold(Manifold):
    """The image manifold of a sampled surface."""

    geometry: MeshGeometry
    graph: Graph  # of the samples, for patches and clusters; empty in parts, where only kernels run
    plain_levels = 2, 1
    search_range, rule = ON_MESHES, RULE_ON_MESHES

    def measure(self, colours: Stack, step: Step, gaussian: Gaussian | None = None) -> Metric:
        """Induce the metric, eq. (1). In chunks, averaging induces the metric of each chunk."""
        if self.chunking is not None:
            return Metric(step, None)
        mesh, moving = self.geometry, self.moving
        positions = mesh.positions if moving is None else moving.positions
        features = () if moving is None else (MetricChannels(moving.normals, moving.beta),)
        gaussian = gaussian_for(self, step, gaussian)
        channels, beta = joined_channels(self, colours, step, gaussian, features=features)
        return MeshMetric(step, gaussian, positions, channels, beta)

    def average(
        self, stacks: list[Stack], metric: Metric, progress: Callable[[int], None] | None = None
    ) -> Averaged:
        """Average the channels, and the positions if they move, by eq. (9)."""
        everywhere, moving = slice(0, self.geometry.size), self.moving
        if moving is None:
            after, (samples, truncated) = self._apply_kernels(stacks, metric, everywhere, progress)
            return Averaged(after, samples, truncated)
        before = moving.channels()
        (*after, moved), (samples, truncated) = self._apply_kernels(
            [*stacks, before], metric, everywhere, progress
        )

        def average_moves(moves: Float32s) -> Float32s:
            return self._apply_kernels([moves], metric, everywhere)[0][0]

        return Averaged(after, samples, truncated, moving.moved(before, moved, average_moves))

    def average_core_in_place(
        self, stacks: list[Stack], step: Step, core: slice
    ) -> tuple[list[Stack], KernelCounts]:
        return self._apply_kernels(stacks, self.measure(stacks[0], step), core)

    def _apply_kernels(
        self, stacks: list[Stack], metric: Metric, rows: slice, progress: Callable[[int], None] | None = None
    ) -> tuple[list[Stack], KernelCounts]:
        """Average some rows of stacks, in one pass; return also the numbers of samples and of truncated kernels."""
        parameters, widths = at_step(self.parameters, metric.step), [stack.shape[1] for stack in stacks]
        channels = stacks[0] if len(stacks) == 1 else np.concatenate(stacks, axis=1)
        smoothed, samples, truncated = self.solver_with(metric).smooth(
            channels, self.geometry.weights, parameters.t, parameters.radius, parameters.max_samples,
            parameters.thread_count, progress, rows.start, rows.stop,
        )  # fmt: skip
        parts = np.split(smoothed[rows], np.cumsum(widths)[:-1], axis=1)
        return [np.ascontiguousarray(part) for part in parts], KernelCounts(samples, truncated)

    def solver_with(self, metric: Metric) -> KernelSolver:
        assert isinstance(metric, MeshMetric)
        return self.geometry.solver_with(metric, self.parameters.thread_count)

    @property
    def _whole(self) -> MeshManifold:
        """The manifold without chunks, whose metric is of all samples."""
        return dataclasses.replace(self, resources=IN_ONE_PIECE)

    @property
    def chunking(self) -> Chunking | None:
        if self.moving is not None:  # moves are averaged again, over the whole surface
            return None
        return self.resources.chunking_of_mesh(self.geometry.size, self.geometry.threads)

    def _cut_for_kernels(self, count: int) -> list[Chunk[PartAndCore]]:
        mesh, parameters, whole = self.geometry, self.parameters, self
        if parameters.metric_steps and parameters.metric_scale > 0:
            gain = mesh.gaussian(parameters.metric_scale).gain
            whole = dataclasses.replace(self, geometry=dataclasses.replace(mesh, gain=gain))
        reach = _STRETCH * parameters.radius + _CHUNK_MARGIN * (
            (mesh.spacing or 1.0) if mesh.scales is None else 1.0
        )
        # Edges including bridges.
        neighbours = Neighbours(mesh.size, distinct_edges(mesh.faces), mesh.scaled_lengths)
        chunks: list[Chunk[PartAndCore]] = []
        for first, last in runs(mesh.size, count):
            near = np.isfinite(neighbours.distances(first, last, reach))
            # Sort samples by index, so that the compiled core groups them as in the whole mesh.
            missing = -int(np.count_nonzero(near[:first])) % PATCH_BLOCK_SIZE
            near[np.flatnonzero(~near[:first])[:missing]] = True
            samples = np.flatnonzero(near).astype(np.int32)
            core = slice(*np.searchsorted(samples, [first, last]).tolist())
            chunks.append(Chunk(partial(whole._cut_chunk, samples, core), samples, slice(first, last)))
        return chunks

    def _cut_chunk(self, samples: Array, core: slice) -> tuple[MeshManifold, slice]:
        """Return a part and the index of the chunk's own samples within it."""
        part = self.cut(samples)
        # A worker may have fewer threads than this process.
        return dataclasses.replace(part, geometry=dataclasses.replace(part.geometry, threads=1)), core

    def kernel_at(self, sample: int, step: Step) -> SampledKernel:
        """Return the kernel of a sample, which is numbered in the caller's order."""
        parameters, mesh = at_step(self.parameters, step), self.geometry
        (source,) = np.flatnonzero(mesh.order == sample)
        reached, distances = self.distances_at(step)(int(source))
        weights = kernel_values(distances, parameters.t)
        if mesh.weights is not None:
            weights = weights * mesh.weights[reached]
        colours = self.noise.to_input(self.colours[reached])
        return SampledKernel(mesh.order[reached].astype(np.int64), distances, weights, colours)

    def distances_at(self, step: Step) -> Callable[[int], tuple[Int32s, Float32s]]:
        """Return a function from a sample to the samples in its kernel, nearest first, and their distances."""
        parameters = at_step(self.parameters, step)
        solver = self.solver_with(self._whole.measure(self.colours, step))
        return lambda source: solver.distances(source, parameters.radius, parameters.max_samples)

    def collaborate(
        self, noisy: Stack, pilot: Stack, mixing: Mixing, progress: Callable[[int], None] | None, *,
        replaces_pilot: bool = False,
    ) -> Stack:  # fmt: skip
        """Estimate colours from patches in tangent planes."""
        relative = None if self.noise.relative is None else self.noise.relative[:, 0]
        return collaborate_on_graph(self.graph, noisy, pilot, mixing, relative, progress)

    def perturbation(self) -> Droppable[Array]:
        """Draw random signs that depend only on nearby colours."""
        graph, colours = self.graph, quantised(self.colours)
        return Droppable(draw_perturbations(graph, self.noise, colours, graph.priorities, 1)[0])

    def levels(self, most: int) -> list[Clusters]:
        return clusters_for(self.graph, most, self.noise.relative)

    @property
    def regions(self) -> SingleSamples:
        return SingleSamples(self.geometry)

    def trial(self) -> SampleTrial:
        colours, edges, size = self.colours, self.geometry.edges, self.geometry.size
        around = fingerprints(colours, edges)
        # A disc that reached a hub would contain all vertices around it.
        discs = choose_discs(colours, around, without_hubs(size, edges))
        count = wanted_probes(int(np.count_nonzero(discs.scored)))
        signs = draw_perturbations(self.graph, self.noise, colours, around, count)
        part, samples = self._whole, discs.samples
        if len(samples) < size:
            part, colours, signs = self.cut(samples), colours[samples], signs[:, samples]
        scored = np.flatnonzero(discs.scored) if not discs.scored.all() else None
        return SampleTrial(part, colours, signs, scored)

    def cut(self, samples: Array) -> MeshManifold:
        """Cut out some samples, ascending, without their colours."""
        geometry = self.geometry.cut(samples)
        return self._part_of(geometry, lambda stack: stack[samples], moving=None, graph=_NO_GRAPH)

    def new_colours(self) -> NewColours:
        mesh, moving = self.geometry, self.moving
        new = self._with_outliers(NewColours.of(mesh.in_order(self.noise.to_input(self.colours))), mesh.order)
        return new if moving is None else dataclasses.replace(new, positions=mesh.in_order(moving.positions))


def mean_samples_per_kernel(manifold: MeshManifold, kernels: int, step: Step) -> float:
    """Measure the mean number of samples per kernel on evenly spread kernels."""
    distances, size = manifold.distances_at(step), manifold.geometry.size
    sources = np.linspace(0, size - 1, min(kernels, size), dtype=int)
    return float(np.mean([len(distances(int(source))[0]) for source in sources]))
