"""The image manifold of colours on a triangulated surface; what goes in and comes out is in the caller's order."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from itertools import islice
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int64s
from beltrami_cli.flow.clipping import ClippedChannels, find_clipped
from beltrami_cli.flow.domain import Stack
from beltrami_cli.flow.embedding import Guide
from beltrami_cli.flow.geometry import GeometryParameters, MovingPositions
from beltrami_cli.flow.manifold import SampleTrial
from beltrami_cli.flow.mesh_kernels import MeshKernels, rank_in
from beltrami_cli.flow.mesh_partitions import MeshPartition, cut_mesh, first_reach
from beltrami_cli.flow.noise.by_place import relative_to_mean
from beltrami_cli.flow.noise.by_scale import FoundNoise
from beltrami_cli.flow.noise.estimate import NoiseByPlace, estimate_noise
from beltrami_cli.flow.noise.haar_noise import draw_noise_of_clusters, sigma_of_covariances
from beltrami_cli.flow.noise.mesh import estimate_sigma, find_mesh_noise, find_relative
from beltrami_cli.flow.noise.stabilising import VarianceStabiliser
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.flow.records import MeshWork, Mixing, NewColours, Step, without_hubs
from beltrami_cli.flow.regularisation import MeshGaussian
from beltrami_cli.flow.search_range import ON_MESHES, RULE_ON_MESHES
from beltrami_cli.flow.tuning.mesh_trial import choose_patches, fingerprints, random_signs
from beltrami_cli.flow.tuning.sure import wanted_probes
from beltrami_cli.flow.vertex_clusters import Clusters, clusters_for
from beltrami_cli.flow.vertex_graph import Graph, levels_of
from beltrami_cli.surface.records import SampledSurface

# Steps of colours, far above their rounding, by which signs and the patches that start groups are chosen.
_COARSE = np.float32(256)

# Sums of the blend are taken by passes over neighbours. On a triangle lattice each pass adds 0.43 squared spacings to
# the variance: as many passes as `MeshManifold.width` needs.
_SPREAD, _PASSES = 3.0, 38


def mesh_manifold(
    surface: SampledSurface,
    parameters: KernelParameters,
    *,
    guides: Sequence[Guide] = (),
    metric_channels: Sequence[int] | None = None,
    geometry: GeometryParameters | None = None,
    deviations: Float32s | None = None,
) -> MeshManifold:
    """Make the image manifold of a sampled surface; with `geometry`, positions are smoothed, too."""
    made = MeshManifold(surface, parameters, metric_channels)
    measured = None if deviations is None else relative_to_mean(deviations[made.order])
    made.noise = estimate_noise(
        made,
        parameters.given_noise,
        varies=parameters.evens_noise and geometry is None,
        least=parameters.least_noise,
        measured=measured,
    )
    made.lay_out_guides([dataclasses.replace(guide, values=guide.values[made.order]) for guide in guides])
    if geometry is not None:
        places = GeometryParameters(geometry.places[made.order], geometry.normal_beta)
        faces = rank_in(made.order)[surface.faces]
        spacing = made.spacing or 1.0
        made.moving = MovingPositions(made.positions, faces, made.edges, spacing, made.unit, places)
    return made


class MeshManifold(MeshKernels):
    """The image manifold of a sampled surface."""

    width: ClassVar[float] = 4.0
    plain_levels: ClassVar[tuple[int, ...]] = 2, 1
    search_range, rule = ON_MESHES, RULE_ON_MESHES

    def noise_by_place(self) -> NoiseByPlace:
        return NoiseByPlace(find_relative(self.colours, self.edges))

    def noise_by_scale(self, relative: Float32s | None, *, by_level: bool) -> FoundNoise:
        if not by_level or not len(self.edges):
            return FoundNoise()
        return find_mesh_noise(self.graph, self.colours, relative)

    def sigma(self, relative: Float32s | None) -> Float64s:
        return estimate_sigma(self.colours, self.edges, relative)

    def stabilise(self, stabiliser: VarianceStabiliser) -> None:
        stabiliser.stabilise(self.colours.T)

    def partitions(
        self, count: int, widening: int, steps: Sequence[Step], channels: int
    ) -> list[MeshPartition]:
        """Cut into partitions, which receive samples as far as kernels are expected to reach."""
        return cut_mesh(self, count, widening * first_reach(self), steps, channels)

    @property
    def work(self) -> MeshWork:
        """How much work its kernels are."""
        return MeshWork(self.size, self.unit, self.edges, len(self.faces))

    def trial(self) -> SampleTrial:
        """Choose patches of the surface, and draw the perturbations of their colours."""
        colours = self.colours
        around = fingerprints(colours, self.edges)
        # A patch that reached a hub would hold everything around it.
        patches = choose_patches(colours, around, without_hubs(self.size, self.edges))
        signs = self._perturbations(colours, around, wanted_probes(int(np.count_nonzero(patches.scored))))
        part, samples = self, patches.samples
        if len(samples) < self.size:
            part, colours, signs = self.cut(samples), colours[samples], signs[:, samples]
        scored = np.flatnonzero(patches.scored) if not patches.scored.all() else None
        return SampleTrial(part, colours, signs, scored, correlated=self.noise.is_shared)

    def release(self) -> None:
        """Give back the triangles, which only cuts need."""
        self.faces = np.empty((0, 3), np.int32)  # a slice would keep them

    def rows(self, stacks: Sequence[Float32s]) -> Float32s:
        """Return the channels of all stacks, in the inner order."""
        return stacks[0] if len(stacks) == 1 else np.concatenate(stacks, axis=1)

    def put_rows(self, rows: Float32s, stacks: Sequence[Float32s]) -> None:
        """Put rows in the inner order back."""
        first = 0
        for stack in stacks:
            stack[:] = rows[:, first : first + stack.shape[1]]
            first += stack.shape[1]

    def take(self, stack: Float32s, samples: Int64s) -> Float32s:
        """Return the rows of some samples."""
        return stack[samples]

    def values(self) -> Float32s:
        """Return the colours as they are now, shape (S, N), in the caller's order."""
        return self.in_order(self.noise.to_input(self.colours))

    def new_colours(self) -> NewColours:
        """Return the same as blocks to be written back."""
        return NewColours.of(self.values())

    def in_order(self, rows: Array) -> Array:
        """Bring rows back to the order that the caller gave them in."""
        ordered = np.empty_like(rows)
        ordered[self.order] = rows
        return ordered

    def find_clipped(self) -> ClippedChannels | None:
        """Find the channels that were cut off; isolated samples keep their colours, and do not count."""
        joined = np.zeros(self.size, bool)
        joined[self.edges] = True
        return find_clipped(self.colours[joined], self.noise.sigma)

    def marks(self, clipped: ClippedChannels) -> Float32s:
        """Return the marks of the samples at a limit, shape (S, M)."""
        return np.ascontiguousarray(clipped.marks(self.colours.T, self.threads).T)

    def restore(self, clipped: ClippedChannels, colours: Float32s, marks: Float32s) -> None:
        """Turn averages of clipped colours into estimates of the colours without noise."""
        clipped.restore(colours.T, marks.T, self.relative[:, 0], self.threads)

    def collaborate(
        self, noisy: Stack, pilot: Stack, mixing: Mixing, progress: Callable[[int], None] | None
    ) -> Stack:
        """Estimate colours from patches in tangent planes."""
        assert self._patches is not None
        estimates, weights = np.zeros_like(noisy), np.zeros_like(noisy)
        own = mixing.parts
        relative = None if self.noise.relative is None else self.noise.relative[:, 0]
        self._patches.collaborate(
            noisy, pilot, own, relative, mixing.has_pilot, estimates, weights, self.threads, progress
        )
        return estimates

    @property
    def graph(self) -> Graph:
        """The samples and their edges, with priorities by nearby colours when it is first needed."""
        if self._graph is None:
            places, around = _in_three_dimensions(self.positions), fingerprints(self._coarse(), self.edges)
            joined = np.zeros(self.size, bool)
            joined[self.edges] = True
            self._graph, self._axes = (
                Graph(places, self.edges, around),
                _axes(places[joined], self.colours[joined]),
            )
        return self._graph

    def _coarse(self) -> Float32s:
        return np.asarray(np.round(self.colours * _COARSE), np.float32)

    def perturbation(self) -> Float32s:
        """Find the patches, and return random signs; both depend only on nearby colours, which change from then on."""
        from beltrami_cli._native import SurfacePatches

        own = self.graph
        self._patches = SurfacePatches(own.positions, own.edges, self._axes, own.priorities, self.threads)
        signs: Float32s = self._perturbations(self._coarse(), own.priorities, 1)[0]
        return signs

    def _perturbations(self, colours: Float32s, around: NDArray[np.uint64], count: int) -> Float32s:
        """Return random stacks like the noise, by nearby colours: signs, or noise that neighbours share."""
        covariances = self.noise.covariances
        if covariances is None:
            return random_signs(colours, around, count)
        levels = list(islice(levels_of(self.graph), len(covariances) + 1))
        signs = np.split(random_signs(colours, around, count * len(levels)), count)
        drawn = np.stack([draw_noise_of_clusters(covariances, levels, own) for own in signs])
        drawn /= np.float32(np.sqrt(np.mean(np.square(sigma_of_covariances(covariances)))))
        return drawn

    def levels(self, most: int, tick: Callable[[], None] | None = None) -> list[Clusters]:
        """Return clusters of samples."""
        del tick
        return clusters_for(self.graph, most, self._axes, self.noise.relative, self.threads)

    def planes(self, count: int) -> Float32s:
        """Return rows of zeros."""
        return np.zeros((count, self.size), np.float32)

    def total(self, planes: Float32s) -> Float64s:
        """Sum rows over all samples."""
        return np.asarray(planes.sum(axis=1, dtype=np.float64))

    def single(self, marked: Bools) -> Bools:
        """Return which of the marked samples have no edge to a marked one."""
        single = marked.copy()
        single[self.edges[marked[self.edges].all(axis=1)]] = False
        return single

    def spread(self, planes: Float32s) -> Float32s:
        """Average rows over the surface, in passes over the neighbours of each sample."""
        means = MeshGaussian(self.size, self.edges, self._lengths, _SPREAD, gain=1.0)
        rows = np.ascontiguousarray(planes.T)
        for _ in range(_PASSES):
            rows = means.smooth(rows)
        return np.ascontiguousarray(rows.T)

    def _laid_out(self, guide: Guide) -> Float32s:
        return guide.values

    def steps(self, stack: Float32s) -> Float32s:
        """Return differences along all edges."""
        return stack[self.edges[:, 0]] - stack[self.edges[:, 1]]


def _in_three_dimensions(positions: Float64s) -> Float64s:
    """Return positions with zeros added, or projected on the three directions in which they extend most."""
    if positions.shape[1] > 3:
        offsets = positions - positions.mean(axis=0)
        directions = np.linalg.eigh(np.einsum("ij,ik->jk", offsets, offsets))[1]
        return np.ascontiguousarray(np.einsum("ij,jk->ik", offsets, directions[:, -3:]))
    places = np.zeros((len(positions), 3))
    places[:, : positions.shape[1]] = positions
    return places


def _axes(positions: Float64s, colours: Float32s) -> Float64s:
    """Return two directions, shape (2, 3), that turn with the model: to where colours are brighter and stronger."""
    if not len(positions):
        return np.eye(3)[:2]
    offsets = positions - positions.mean(axis=0)
    level = colours.sum(axis=1, dtype=np.float64)
    level -= level.mean()
    return np.stack([np.einsum("i,ij->j", weights, offsets) for weights in (level, level**2)])
