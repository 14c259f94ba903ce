"""The image manifold of colours on a triangulated surface.

The samples are kept in a cache-friendly order; what goes in and comes out is in the caller's order.
"""

from __future__ import annotations

import dataclasses
from copy import copy
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from beltrami_cli.flow.clipping import find_clipped
from beltrami_cli.flow.geometry import GeometryParameters, MovingPositions
from beltrami_cli.flow.kernel_work import MeshWork, without_hubs
from beltrami_cli.flow.manifold import (
    Averaged,
    Manifold,
    NewColours,
    SampledKernel,
    SampleTrial,
    at_step,
    kernel_values,
)
from beltrami_cli.flow.noise.mesh import estimate_sigma
from beltrami_cli.flow.regularisation import MeshGaussian
from beltrami_cli.flow.search_range import ON_MESHES, RULE_ON_MESHES
from beltrami_cli.flow.tuning.mesh_trial import choose_patches, fingerprints, random_signs
from beltrami_cli.flow.tuning.sure import wanted_probes
from beltrami_cli.surface.geometry import edges_in_space, local_spacing, mean_side, vertex_areas

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from beltrami_cli._native import SegmentManifold, SurfacePatches, TriangulatedManifold
    from beltrami_cli.flow.clipping import ClippedChannels
    from beltrami_cli.flow.embedding import Guide
    from beltrami_cli.flow.manifold import Mixing, Step
    from beltrami_cli.flow.parameters import KernelParameters
    from beltrami_cli.surface.records import SampledSurface


# Steps of colours, far above their rounding, by which signs and the patches that start groups are chosen.
_COARSE = np.float32(256)

# Sums of the blend are taken by passes over neighbours. On a triangle lattice each pass adds 0.43 squared spacings to
# the variance: as many passes as `MeshManifold.width` needs.
_SPREAD, _PASSES = 3.0, 38


class MeshManifold(Manifold):
    """The image manifold of a sampled surface; `geometry`: positions are smoothed, too."""

    axis: ClassVar[int] = 1
    search_range, rule = ON_MESHES, RULE_ON_MESHES

    width: ClassVar[float] = 4.0

    moving: MovingPositions | None = None
    """The positions, if they are smoothed along with the colours."""

    def __init__(
        self,
        surface: SampledSurface,
        parameters: KernelParameters,
        *,
        guides: Sequence[Guide] = (),
        metric_channels: Sequence[int] | None = None,
        geometry: GeometryParameters | None = None,
    ) -> None:
        from beltrami_cli._native import vertex_order

        super().__init__(parameters, metric_channels)
        self.order = vertex_order(surface.positions, surface.all_faces)
        self.size = self.kernels = len(self.order)
        rank = np.empty_like(self.order)
        rank[self.order] = np.arange(self.size, dtype=rank.dtype)
        self.positions = surface.positions[self.order]
        self.colours = surface.colours[self.order]
        self.faces = rank[surface.all_faces]
        length = mean_side(surface.positions, surface.faces) if parameters.units == "world" else 1.0
        self._along_segments = parameters.is_along_segments(length)
        self._core: SegmentManifold | TriangulatedManifold | None = None
        self._patches: SurfacePatches | None = None
        # Bridges over hard colour edges join samples at one place: they carry no information about spacing or noise.
        self.edges, lengths = edges_in_space(self.core.edges(), self.positions)
        self.spacing = float(lengths.mean()) if len(lengths) else 0.0
        spacing = local_spacing(self.size, self.edges, lengths)
        self._scales: NDArray[np.float32] | None = None
        if parameters.units == "spacing":
            self._scales = (1 / spacing).astype(np.float32)
        self.unit = self.spacing if parameters.units == "world" else 1.0
        self._lengths = lengths / np.sqrt(spacing[self.edges[:, 0]] * spacing[self.edges[:, 1]])
        self._weights: NDArray[np.float32] | None = None
        if parameters.weights == "area":
            self._weights = vertex_areas(self.positions, rank[surface.faces])
        self.sigma = estimate_sigma(self.colours, self.edges)
        self._gain: float | None = None
        self.embed([dataclasses.replace(guide, values=guide.values[self.order]) for guide in guides])
        if geometry is not None:
            places = GeometryParameters(geometry.places[self.order], geometry.normal_beta)
            self.moving = MovingPositions(
                self.positions, rank[surface.faces], self.edges, self.spacing or 1.0, self.unit, places
            )

    @property
    def core(self) -> SegmentManifold | TriangulatedManifold:
        """The manifold of the compiled core, made when it is first needed."""
        if self._core is None:
            from beltrami_cli._native import SegmentManifold, TriangulatedManifold

            solver = SegmentManifold if self._along_segments else TriangulatedManifold
            self._core = solver(self.faces, self.size)
        return self._core

    @property
    def is_along_segments(self) -> bool:
        """Whether distances are found along segments, and not by fast marching."""
        return self._along_segments

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_core": None, "_patches": None}

    def measure(self, colours: NDArray[np.float32], step: Step) -> None:
        """Induce the metric, eq. (1)."""
        channels, beta = self.channels(colours, step)
        self.core.update_metric(self.positions, channels, beta, self._scales, self.threads)
        self._measured = at_step(self.parameters, step)

    def average(
        self, stacks: list[NDArray[np.float32]], progress: Callable[[int], None] | None = None
    ) -> Averaged:
        """Average the channels, and the positions if they move, by eq. (9)."""
        widths = np.cumsum([stack.shape[1] for stack in stacks])
        channels = stacks[0] if len(stacks) == 1 else np.concatenate(stacks, axis=1)
        if self.moving is None:
            smoothed, samples, truncated = self.apply_kernel(channels, progress)
        else:
            before = self.moving.channels()
            smoothed, samples, truncated = self.apply_kernel(np.hstack([channels, before]), progress)
            self.moving.move(before, smoothed[:, widths[-1] :], lambda moves: self.apply_kernel(moves)[0])
            self.positions = self.moving.positions
        if smoothed.shape[1] == stacks[0].shape[1]:
            return Averaged([smoothed], samples, truncated)
        parts = np.split(smoothed, widths, axis=1)[: len(stacks)]
        return Averaged([np.ascontiguousarray(part) for part in parts], samples, truncated)

    def apply_kernel(
        self, channels: NDArray[np.float32], progress: Callable[[int], None] | None = None
    ) -> tuple[NDArray[np.float32], int, int]:
        """Average channels; return them, the samples held, and the kernels cut short."""
        own = self._measured
        return self.core.smooth(
            channels, self._weights, own.t, own.radius, own.max_samples, self.threads, progress
        )

    def marked(self, marks: NDArray[np.float32], max_samples: int) -> NDArray[np.bool_]:
        """Find the samples whose kernels hold a marked one, with kernels of up to `max_samples`."""
        radius = self._measured.radius
        # With such a long time step no kernel value is small.
        t = max(radius, 1e-6) ** 2
        averages = self.core.smooth(marks, None, t, radius, max_samples, self.threads, None)[0]
        return np.asarray(averages.any(axis=1))

    def cut(self, samples: NDArray[np.int64], *others: Any) -> MeshManifold:
        """Return a part of some samples, ascending; `others`: their places in a larger part, and its size."""
        places, size = others or (np.arange(len(samples)), len(samples))
        part = copy(self)
        part._core, part._patches, part._gaussian, part.moving = None, None, None, None
        rank = np.full(self.size, -1, np.int32)
        rank[samples] = places
        part.size = size
        corners, ends = rank[self.faces], rank[self.edges]
        part.faces = corners[(corners >= 0).all(axis=1)]
        inside = (ends >= 0).all(axis=1)
        part.edges, part._lengths = ends[inside], self._lengths[inside]

        def spread(rows: NDArray[Any], filling: float = 0) -> NDArray[Any]:
            if size == len(samples):
                return rows[samples]
            whole = np.full((size, *rows.shape[1:]), filling, rows.dtype)
            whole[places] = rows[samples]
            return whole

        part.positions = spread(self.positions)
        part.colours = np.zeros((0, 0), np.float32)
        part.order = np.zeros(0, self.order.dtype)
        part._scales = None if self._scales is None else spread(self._scales, 1)
        part._weights = None if self._weights is None else spread(self._weights, 1)
        part.guides = [(spread(values), beta) for values, beta in self.guides]
        return part

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
        signs = random_signs(colours, around, wanted_probes(int(np.count_nonzero(patches.scored))))
        part, samples = self, patches.samples
        if len(samples) < self.size:
            part, colours, signs = self.cut(samples), colours[samples], signs[:, samples]
        scored = np.flatnonzero(patches.scored) if not patches.scored.all() else None
        return SampleTrial(part, colours, signs, scored)

    def fix_gain(self) -> None:
        """Let the parts that are cut from now on have the gain of the regularised metric of this surface."""
        self._gain = self._smoothing().gain

    def release(self) -> None:
        """Give back the triangles, which only cuts need."""
        self.faces = self.faces[:0]

    def rows(self, stacks: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
        """Return the channels of all stacks, in the inner order."""
        return stacks[0] if len(stacks) == 1 else np.concatenate(stacks, axis=1)

    def put_rows(self, rows: NDArray[np.float32], stacks: Sequence[NDArray[np.float32]]) -> None:
        """Put rows in the inner order back."""
        first = 0
        for stack in stacks:
            stack[:] = rows[:, first : first + stack.shape[1]]
            first += stack.shape[1]

    def take(self, stack: NDArray[np.float32], samples: NDArray[np.int64]) -> NDArray[np.float32]:
        """Return the rows of some samples."""
        return stack[samples]

    def values(self) -> NDArray[np.float32]:
        """Return the colours as they are now, shape (S, N), in the caller's order."""
        return self.in_order(self.colours)

    def new_colours(self) -> NewColours:
        """Return the same as blocks to be written back."""
        return NewColours.of(self.values())

    def in_order(self, rows: NDArray[Any]) -> NDArray[Any]:
        """Bring rows back to the order that the caller gave them in."""
        ordered = np.empty_like(rows)
        ordered[self.order] = rows
        return ordered

    def find_clipped(self) -> ClippedChannels | None:
        """Find the channels that were cut off; isolated samples keep their colours, and do not count."""
        joined = np.zeros(self.size, bool)
        joined[self.edges] = True
        return find_clipped(self.colours[joined], self.sigma)

    def marks(self, clipped: ClippedChannels) -> NDArray[np.float32]:
        """Return the marks of the samples at a limit, shape (S, M)."""
        return np.ascontiguousarray(clipped.marks(self.colours.T).T)

    def restore(
        self, clipped: ClippedChannels, colours: NDArray[np.float32], marks: NDArray[np.float32]
    ) -> None:
        """Turn averages of clipped colours into estimates of the colours without noise."""
        clipped.restore(colours.T, marks.T)

    def collaborate(
        self,
        noisy: NDArray[np.float32],
        pilot: NDArray[np.float32],
        mixing: Mixing,
        *,
        has_pilot: bool,
        progress: Callable[[int], None] | None = None,
    ) -> NDArray[np.float32]:
        """Estimate colours from patches in tangent planes."""
        assert self._patches is not None
        estimates, weights = np.zeros_like(noisy), np.zeros_like(noisy)
        own = mixing.forth, mixing.back, mixing.variances
        self._patches.collaborate(noisy, pilot, own, has_pilot, estimates, weights, self.threads, progress)
        return estimates

    def perturbation(self) -> NDArray[np.float32]:
        """Find the patches, and return random signs; both depend only on nearby colours, which change from then on."""
        from beltrami_cli._native import SurfacePatches

        places, coarse = _in_three_dimensions(self.positions), np.round(self.colours * _COARSE)
        joined = np.zeros(self.size, bool)
        joined[self.edges] = True
        axes, around = _axes(places[joined], self.colours[joined]), fingerprints(coarse, self.edges)
        self._patches = SurfacePatches(places, self.edges, axes, around, self.threads)
        signs: NDArray[np.float32] = random_signs(coarse, around, 1)[0]
        return signs

    def planes(self, count: int) -> NDArray[np.float32]:
        """Return rows of zeros."""
        return np.zeros((count, self.size), np.float32)

    def total(self, planes: NDArray[np.float32]) -> NDArray[np.float64]:
        """Sum rows over all samples."""
        return np.asarray(planes.sum(axis=1, dtype=np.float64))

    def spread(self, planes: NDArray[np.float32]) -> NDArray[np.float32]:
        """Average rows over the surface, in passes over the neighbours of each sample."""
        means = MeshGaussian(self.size, self.edges, self._lengths, _SPREAD, gain=1.0)
        rows = np.ascontiguousarray(planes.T)
        for _ in range(_PASSES):
            rows = means.smooth(rows)
        return np.ascontiguousarray(rows.T)

    def kernel_at(self, sample: int, step: Step) -> SampledKernel:
        """Return the kernel of a sample, in the caller's numbers."""
        self.measure(self.colours, step)
        own = self._measured
        (source,) = np.flatnonzero(self.order == sample)
        held, distances = self.core.distances(int(source), own.radius, own.max_samples)
        weights = kernel_values(distances, own.t)
        if self._weights is not None:
            weights = weights * self._weights[held]
        return SampledKernel(self.order[held].astype(np.int64), distances, weights, self.colours[held])

    def samples_per_kernel(self, kernels: int, step: Step) -> float:
        """Measure how many samples a kernel holds, from some kernels spread evenly."""
        self.measure(self.colours, step)
        own = self._measured
        sources = np.linspace(0, self.size - 1, min(kernels, self.size), dtype=int)
        held = [len(self.core.distances(int(source), own.radius, own.max_samples)[0]) for source in sources]
        return float(np.mean(held))

    def _smoothing(self) -> MeshGaussian:
        return MeshGaussian(self.size, self.edges, self._lengths, self.parameters.metric_scale, self._gain)

    def _laid_out(self, guide: Guide) -> NDArray[np.float32]:
        return guide.values

    def steps(self, stack: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return differences along all edges."""
        return stack[self.edges[:, 0]] - stack[self.edges[:, 1]]

    def _features(self, step: Step) -> list[tuple[NDArray[np.float32], float]]:
        if self.moving is None:
            return []
        normals = self.moving.normals, self.moving.beta
        return [self.regularised(*normals) if step.regularised else normals]


def _in_three_dimensions(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return positions with zeros added, or projected on the three directions in which they extend most."""
    if positions.shape[1] > 3:
        offsets = positions - positions.mean(axis=0)
        directions = np.linalg.eigh(np.einsum("ij,ik->jk", offsets, offsets))[1]
        return np.ascontiguousarray(np.einsum("ij,jk->ik", offsets, directions[:, -3:]))
    places = np.zeros((len(positions), 3))
    places[:, : positions.shape[1]] = positions
    return places


def _axes(positions: NDArray[np.float64], colours: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return two directions, shape (2, 3), that turn with the model: to where colours are brighter and stronger."""
    offsets = positions - positions.mean(axis=0)
    level = colours.sum(axis=1, dtype=np.float64)
    level -= level.mean()
    return np.stack([np.einsum("i,ij->j", weights, offsets) for weights in (level, level**2)])
