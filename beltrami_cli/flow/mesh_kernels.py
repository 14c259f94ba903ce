"""The kernels of a triangulated surface: its metric, averages by it, and parts of the surface.

The samples are kept in a cache-friendly order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from typing import Any, ClassVar, Self

import numpy as np

from beltrami_cli._native import SegmentManifold, SurfacePatches, TriangulatedManifold, vertex_order
from beltrami_cli.arrays import Array, Bools, Float32s, Int32s, Int64s
from beltrami_cli.flow.manifold import Manifold
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.flow.records import Averaged, SampledKernel, Step, at_step, kernel_values
from beltrami_cli.flow.regularisation import MeshGaussian
from beltrami_cli.flow.vertex_graph import Graph
from beltrami_cli.surface.geometry import edges_in_space, local_spacing, mean_side, vertex_areas
from beltrami_cli.surface.records import SampledSurface


class MeshKernels(Manifold):
    """Samples of a surface, with what their kernels need."""

    axis: ClassVar[int] = 1

    def __init__(
        self, surface: SampledSurface, parameters: KernelParameters, metric_channels: Sequence[int] | None
    ) -> None:
        super().__init__(parameters, metric_channels)
        self.order = vertex_order(surface.positions, surface.all_faces)
        self.size = self.kernels = len(self.order)
        rank = rank_in(self.order)
        self.positions = surface.positions[self.order]
        self.colours = surface.colours[self.order]
        self.faces = rank[surface.all_faces]
        length = mean_side(surface.positions, surface.faces) if parameters.units == "world" else 1.0
        self.is_along_segments = parameters.is_along_segments(length)
        self._core: SegmentManifold | TriangulatedManifold | None = None
        self._patches: SurfacePatches | None = None
        self._graph: Graph | None = None
        # Bridges over hard colour edges join samples at one place: they carry no information about spacing or noise.
        self.edges, lengths = edges_in_space(self.core.edges(), self.positions)
        self.spacing = float(lengths.mean()) if len(lengths) else 0.0
        self.unit = self.spacing if parameters.units == "world" else 1.0
        spacing = local_spacing(self.size, self.edges, lengths)
        self._lengths = lengths / np.sqrt(spacing[self.edges[:, 0]] * spacing[self.edges[:, 1]])
        in_spacings, by_area = parameters.units == "spacing", parameters.weights == "area"
        self._scales = (1 / spacing).astype(np.float32) if in_spacings else None
        self._weights = vertex_areas(self.positions, rank[surface.faces]) if by_area else None
        self._gain: float | None = None

    @property
    def core(self) -> SegmentManifold | TriangulatedManifold:
        """The manifold of the compiled core, made when it is first needed."""
        if self._core is None:
            solver = SegmentManifold if self.is_along_segments else TriangulatedManifold
            self._core = solver(self.faces, self.size)
        return self._core

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_core": None, "_patches": None, "_graph": None}

    def measure(self, colours: Float32s, step: Step) -> None:
        """Induce the metric, eq. (1)."""
        channels, beta = self.channels(colours, step)
        self.core.update_metric(self.positions, channels, beta, self._scales, self.threads)
        self._measured = at_step(self.parameters, step)

    def average(self, stacks: list[Float32s], progress: Callable[[int], None] | None = None) -> Averaged:
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
        self, channels: Float32s, progress: Callable[[int], None] | None = None
    ) -> tuple[Float32s, int, int]:
        """Average channels; return them, the samples held, and the kernels cut short."""
        own = self._measured
        return self.core.smooth(
            channels, self._weights, own.t, own.radius, own.max_samples, self.threads, progress
        )

    def marked(self, marks: Float32s, max_samples: int) -> Bools:
        """Find the samples whose kernels hold a marked one, with kernels of up to `max_samples`."""
        radius = self._measured.radius
        # With such a long time step no kernel value is small.
        t = max(radius, 1e-6) ** 2
        averages = self.core.smooth(marks, None, t, radius, max_samples, self.threads, None)[0]
        return np.asarray(averages.any(axis=1))

    def cut(self, samples: Int64s, *others: Any) -> Self:
        """Return a part of some samples, ascending; `others`: their places in a larger part, and its size."""
        places, size = others or (np.arange(len(samples)), len(samples))
        part = copy(self)
        part._core, part._patches, part._graph, part._gaussian, part.moving = None, None, None, None, None
        rank = np.full(self.size, -1, np.int32)
        rank[samples] = places
        part.size = size
        corners, ends = rank[self.faces], rank[self.edges]
        part.faces = corners[(corners >= 0).all(axis=1)]
        inside = (ends >= 0).all(axis=1)
        part.edges, part._lengths = ends[inside], self._lengths[inside]

        def spread(rows: Array, filling: float = 0) -> Array:
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
        if self.noise.relative is not None:
            part.noise = self.noise.with_relative(spread(self.noise.relative, 1))
        part.guides = [(spread(values), beta) for values, beta in self.guides]
        return part

    def fix_gain(self) -> None:
        """Let the parts that are cut from now on have the gain of the regularised metric of this surface."""
        self._gain = self._smoothing().gain

    def kernel_at(self, sample: int, step: Step) -> SampledKernel:
        """Return the kernel of a sample, in the caller's numbers."""
        self.measure(self.colours, step)
        own = self._measured
        (source,) = np.flatnonzero(self.order == sample)
        held, distances = self.core.distances(int(source), own.radius, own.max_samples)
        weights = kernel_values(distances, own.t)
        if self._weights is not None:
            weights = weights * self._weights[held]
        return SampledKernel(
            self.order[held].astype(np.int64), distances, weights, self.noise.to_input(self.colours[held])
        )

    def samples_per_kernel(self, kernels: int, step: Step) -> float:
        """Measure how many samples a kernel holds, from some kernels spread evenly."""
        self.measure(self.colours, step)
        own = self._measured
        sources = np.linspace(0, self.size - 1, min(kernels, self.size), dtype=int)
        held = [len(self.core.distances(int(source), own.radius, own.max_samples)[0]) for source in sources]
        return float(np.mean(held))

    def _smoothing(self) -> MeshGaussian:
        return MeshGaussian(self.size, self.edges, self._lengths, self.parameters.metric_scale, self._gain)

    def _features(self, step: Step) -> list[tuple[Float32s, float]]:
        if self.moving is None:
            return []
        normals = self.moving.normals, self.moving.beta
        return [self.regularised(*normals) if step.regularised else normals]


def rank_in(order: Int32s) -> Int32s:
    """Return where each sample stands in an order of all."""
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order), dtype=rank.dtype)
    return rank
