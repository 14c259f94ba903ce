"""Image manifolds: measurement of distances, averages, and what choices and patches need of them.

A sample has a position X and a colour I, and is embedded as (X, beta I). There are two kinds of manifolds: triangulated
surfaces and regular grids. A manifold consists of a geometry, which has positions and neighbours, of colours, and of
the kernels of the metric that both induce. Equations: A. Spira, R. Kimmel, N. Sochen, "A short time Beltrami kernel for
smoothing images on manifolds", IEEE Trans. Image Processing 16(6), 2007, https://doi.org/10.1109/TIP.2007.894253
"""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, ClassVar, Self, TypeAlias

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s, Int64s
from beltrami_cli.flow.chunks import IN_ONE_PIECE, Chunk, Chunking, KernelCounts, Resources
from beltrami_cli.flow.manifolds.beta import choose_beta
from beltrami_cli.flow.manifolds.domain import CoarseLevel, Regions
from beltrami_cli.flow.manifolds.geometry import Gaussian, Geometry, Stack
from beltrami_cli.flow.manifolds.guides import GuideStack
from beltrami_cli.flow.manifolds.iteration import Averaged, Metric, SampledKernel, Step
from beltrami_cli.flow.manifolds.moving_positions import MovingPositions
from beltrami_cli.flow.manifolds.new_colours import NewColours
from beltrami_cli.flow.manifolds.search_range import Rule, SearchRange
from beltrami_cli.flow.manifolds.stabilised_colours import Outliers
from beltrami_cli.flow.mixing import Mixing
from beltrami_cli.flow.noise.model import NoiseModel
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.large_arrays import Droppable

# Beta times sigma: the distance of colours at which the first kernel should decay, in units of the noise. A search over
# vertex colours and textures at sigma 20 of 255, with t = 2.4, a growth of 2, two regularised and three plain
# iterations, has its flat optimum here.
_CONTRAST = 0.8

PartAndCore: TypeAlias = "tuple[Manifold, Any]"
"""A part of a manifold, and the index of the chunk's own samples within it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Manifold(ABC):
    """An image manifold or a part of it.

    An iteration is `measure`, then `average` or `average_in_place`; `kernel_at` shows one of its kernels. The choice of
    parameters needs a `trial`, the patches need `collaborate`, `perturbation`, `levels` and `regions`.
    """

    geometry: Geometry
    colours: Stack  # stabilised, see `StabilisedColours`; before or after iterations
    noise: NoiseModel  # of the colours
    parameters: KernelParameters
    unit: float  # of length, for t and beta, in sample spacings
    metric_channels: list[int] | slice
    guides: tuple[GuideStack, ...] = ()
    moving: MovingPositions | None = None  # positions that are smoothed along with the colours
    outliers: Outliers | None = None  # that were filled
    resources: Resources = IN_ONE_PIECE

    search_range: ClassVar[SearchRange]
    """The parameters that are tried when they are chosen from the data."""

    rule: ClassVar[Rule]
    """The parameters for a noise level where nothing is tried."""

    plain_levels: ClassVar[tuple[int, ...]]
    """The levels at which plain colours are estimated, coarse to fine."""

    @property
    def beta(self) -> float:
        """The given beta, or one chosen for the noise, in length per unit of stabilised colours."""
        beta = self.parameters.beta
        if beta is None or not len(self.metric_sigma):
            return self.beta_at(_CONTRAST) / math.sqrt(self.parameters.strength)
        return beta

    def beta_at(self, contrast: float) -> float:
        """Return the beta at which noise has a length of `contrast` spacings; 0 without colours in the metric."""
        sigma = self.metric_sigma
        return choose_beta(sigma, contrast) * self.unit if len(sigma) else 0.0

    @property
    def metric_sigma(self) -> Float64s:
        """Standard deviation of the noise by channel of the metric."""
        return self.noise.sigma[self.metric_channels]

    @property
    def relative_variance(self) -> Stack:
        """The variance of the noise relative to its mean, a stack of one channel."""
        if self.noise.relative is not None:
            return self.noise.relative
        return np.broadcast_to(np.float32(1), self.geometry.kind.shape)

    def with_parameters(self, **values: Any) -> Self:
        return dataclasses.replace(self, parameters=dataclasses.replace(self.parameters, **values))

    @abstractmethod
    def measure(self, colours: Stack, step: Step, gaussian: Gaussian | None = None) -> Metric:
        """Induce the metric, eq. (1), from colours; `gaussian` of an earlier metric is used again.

        On grids and in chunks, averaging induces it part by part from its first stack, and colours are not read here.
        """

    @abstractmethod
    def average(
        self, stacks: list[Stack], metric: Metric, progress: Callable[[int], None] | None = None
    ) -> Averaged:
        """Average stacks by the kernels of the metric, eqs. (8) and (9), in one piece.

        The first stack contains the colours from which the metric was measured.
        """

    def average_in_place(
        self, stacks: list[Stack], metric: Metric, progress: Callable[[int], None] | None = None
    ) -> Averaged:
        """Average stacks in chunks, if the surface is cut; the averages may take the memory of the stacks."""
        if self.chunking is None:
            return self.average(stacks, metric, progress)
        geometry, results = self.geometry, [large_arrays.zeros(stack.shape, np.float32) for stack in stacks]
        samples, truncated = self.chunking.apply(
            self._kernel_chunks, partial(_average_chunk_in_place, step=metric.step), stacks, results, progress,
            size=geometry.size, threads=geometry.threads,
        )  # fmt: skip
        for result in results:
            geometry.refresh(result)
        return Averaged(results, samples, truncated)

    @abstractmethod
    def average_core_in_place(
        self, stacks: list[Stack], step: Step, core: Any
    ) -> tuple[list[Stack], KernelCounts]:
        """Average stacks of a part; return the averages of the chunk's own samples, which have the index `core`."""

    @property
    def chunking(self) -> Chunking | None:
        return self.resources.chunking

    @cached_property
    def _kernel_chunks(self) -> list[Chunk[PartAndCore]]:
        assert self.chunking is not None
        return self._cut_for_kernels(self.chunking.count)

    @abstractmethod
    def _cut_for_kernels(self, count: int) -> list[Chunk[PartAndCore]]:
        """Cut into up to `count` chunks for one iteration."""

    def drop_kernels(self) -> None:
        """Free memory that only kernels use; it is computed again if needed."""
        vars(self).pop("_kernel_chunks", None)
        self.geometry.drop_distances()

    @abstractmethod
    def kernel_at(self, sample: int, step: Step) -> SampledKernel:
        """Return the kernel of a sample in an iteration from the present colours."""

    @abstractmethod
    def collaborate(
        self, noisy: Stack, pilot: Stack, mixing: Mixing, progress: Callable[[int], None] | None, *,
        replaces_pilot: bool = False,
    ) -> Stack:  # fmt: skip
        """Estimate colours from patches that are similar in the pilot.

        `replaces_pilot`: the pilot is not needed any more, and the estimates may take its memory.
        """

    @abstractmethod
    def perturbation(self) -> Droppable[Array]:
        """Draw a stack of random signs, or of noise that is correlated like that of the colours."""

    @abstractmethod
    def levels(self, most: int) -> Sequence[CoarseLevel]:
        """Make up to `most` levels, fine to coarse, each with means of about four samples of the previous one."""

    @property
    @abstractmethod
    def regions(self) -> Regions:
        """The samples or means over which regions of the surface are averaged."""

    @abstractmethod
    def trial(self) -> SampleTrial:
        """Choose the samples on which parameters are tried, and draw the perturbations of their colours."""

    @abstractmethod
    def new_colours(self) -> NewColours:
        """Return the colours, read block by block, and their extension beyond seams, to be written to the document."""

    def _part_of(self, geometry: Geometry, pick: Callable[[Stack], Stack], **changes: Any) -> Self:
        """Replace the geometry by that of some samples, which `pick` takes from stacks; without colours."""
        noise = self.noise
        if noise.relative is not None:
            noise = dataclasses.replace(noise, relative=pick(noise.relative))
        guides = tuple(dataclasses.replace(guide, stack=pick(guide.stack)) for guide in self.guides)
        return dataclasses.replace(
            self, geometry=geometry, colours=self.colours[:0], noise=noise, guides=guides,
            resources=IN_ONE_PIECE, **changes,
        )  # fmt: skip

    def _with_outliers(self, new: NewColours, order: Array | None = None) -> NewColours:
        """Restore the outliers in new colours, whose samples are in an order, if outliers are kept."""
        outliers = self.outliers
        if outliers is None or self.parameters.outliers != "keep":
            return new
        samples = outliers.samples if order is None else order[outliers.samples]
        return new.with_kept(samples, outliers.channels, outliers.colours)


@dataclass(frozen=True)
class SampleTrial:
    """A part of a manifold on which iterations are tried; `scored_samples` are evaluated, None: all."""

    part: Manifold
    start: Stack  # the noisy colours
    signs: Float32s  # perturbations, each a stack like `start`
    scored_samples: Int64s | None

    @property
    def samples(self) -> int:
        return len(self.scored(self.start))

    @property
    def relative_variance(self) -> Float32s | float:
        """The variance of the noise relative to its mean."""
        return 1.0 if self.part.noise.relative is None else self.scored(self.part.noise.relative)

    def step(self, colours: Stack, step: Step) -> Stack:
        metric = self.part.measure(colours, step, self._gaussian if step.regularised else None)
        return self.part.average([colours], metric).stacks[0]

    @cached_property
    def _gaussian(self) -> Gaussian:
        return self.part.geometry.gaussian(self.part.parameters.metric_scale)

    def scored(self, stack: Stack) -> Float32s:
        """Return the channels of the evaluated samples, shape (S, N)."""
        return stack if self.scored_samples is None else self.part.geometry.take(stack, self.scored_samples)


def _average_chunk_in_place(
    part: PartAndCore, stacks: list[Stack], threads: int, step: Step
) -> tuple[list[Stack], KernelCounts]:
    manifold, core = part
    return manifold.with_parameters(threads=threads).average_core_in_place(stacks, step, core)
