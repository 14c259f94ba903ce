"""Image manifolds: measuring distances, and averaging by them.

A sample has a position X and a colour I, and is embedded as (X, beta I). Two kinds of manifolds are sampled:
triangulated surfaces, and regular grids. A manifold is composed of its geometry, which holds positions and neighbours,
of colours, and of the kernels of the metric that both induce. Equations: A. Spira, R. Kimmel, N. Sochen,
"A short time Beltrami kernel for smoothing images on manifolds", IEEE Trans. Image Processing 16(6), 2007,
https://doi.org/10.1109/TIP.2007.894253
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Float32s, Int64s
from beltrami_cli.flow.clipping import ClippedChannels
from beltrami_cli.flow.domain import CoarseLevel, Geometry, Stack, in_blocks
from beltrami_cli.flow.embedding import Guide, choose_beta, choose_guide_beta, join_channels
from beltrami_cli.flow.noise.haar_noise import NoiseModel
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.flow.records import Averaged, Mixing, NewColours, SampledKernel, Step
from beltrami_cli.flow.regularisation import Gaussian
from beltrami_cli.flow.search_range import Rule, SearchRange
from beltrami_cli.surface.atlas import EMPTY

if TYPE_CHECKING:
    from beltrami_cli.flow.moving_positions import MovingPositions


@dataclass(frozen=True)
class Metric:
    """The metric of an iteration, eq. (1).

    That of a mesh is in the compiled core, until the next is measured; that of a grid is induced by the first
    `channels` of the first stack, row block by row block, while they are averaged.
    """

    step: Step
    channels: int
    gaussian: Gaussian | None  # None: not regularised


@dataclass(frozen=True)
class GuideStack:
    """A guide as a stack, with its beta."""

    name: str
    stack: Stack
    beta: float

    @classmethod
    def of(cls, guide: Guide, stack: Stack, geometry: Geometry, unit: float) -> GuideStack:
        """Choose a beta that is not given by the usual steps of the guide."""
        beta = guide.beta
        if beta is None:
            beta = choose_guide_beta(guide.values, geometry.steps(stack)) * unit
        return cls(guide.name, stack, beta)


@dataclass(frozen=True, kw_only=True, eq=False)
class Manifold(ABC):
    """Samples of an image manifold, or of a part of one, ready to be measured and averaged."""

    geometry: Geometry
    colours: Stack  # before or after iterations
    noise: NoiseModel  # of the colours
    parameters: KernelParameters
    unit: float  # of length, for t and beta, in sample spacings
    metric_channels: list[int] | slice
    guides: tuple[GuideStack, ...] = ()
    moving: MovingPositions | None = None  # positions that are smoothed along with the colours
    is_in_one_block: bool = False  # averaged at once, whatever its size; stacks stay as they are

    search_range: ClassVar[SearchRange]
    """The parameters that are tried when they are chosen from the data."""

    rule: ClassVar[Rule]
    """The parameters for a noise level where nothing is tried."""

    plain_levels: ClassVar[tuple[int, ...]]
    """The levels at which plain colours are estimated, coarse to fine."""

    @property
    def beta(self) -> float:
        """The given beta, or else one for the noise, in units of length per unit of stabilised colours."""
        sigma, own = self.noise.sigma[self.metric_channels], self.parameters
        if not len(sigma):
            return 0.0
        if own.beta is not None:
            return own.beta
        return choose_beta(sigma) * self.unit / math.sqrt(own.strength)

    @abstractmethod
    def measure(self, colours: Stack, step: Step, gaussian: Gaussian | None = None) -> Metric:
        """Induce the metric, eq. (1), by colours; `gaussian`: that of an earlier metric, to be used again."""

    @abstractmethod
    def average(
        self, stacks: list[Stack], metric: Metric, progress: Callable[[int], None] | None = None
    ) -> Averaged:
        """Average stacks by the kernels of the metric, eqs. (8) and (9); they may be changed in place.

        The first stack holds the colours that the metric was measured by.
        """

    @abstractmethod
    def kernel_at(self, sample: int, step: Step) -> SampledKernel:
        """Return the kernel that an iteration from the present colours has at a sample."""

    @abstractmethod
    def collaborate(
        self, noisy: Stack, pilot: Stack, mixing: Mixing, progress: Callable[[int], None] | None, *,
        replaces_pilot: bool = False,
    ) -> Stack:  # fmt: skip
        """Estimate colours from similar patches, compared on the pilot, whose memory they may replace."""

    @abstractmethod
    def perturbation(self) -> Float32s | NDArray[np.int8]:
        """Return a stack of random signs, or of noise that neighbours share as they share that of the colours."""

    @abstractmethod
    def levels(self, most: int, tick: Callable[[], None] | None = None) -> Sequence[CoarseLevel]:
        """Return up to `most` levels, fine to coarse, each of some four samples of the one before."""

    @abstractmethod
    def trial(self) -> SampleTrial:
        """Choose samples to try parameters on, and draw the perturbations of their colours."""

    @abstractmethod
    def new_colours(self) -> NewColours:
        """Return the colours block by block, with those beyond seams, to be written back to the document."""

    def _regularising(self, step: Step, gaussian: Gaussian | None) -> Gaussian | None:
        if not step.regularised or (step.beta == 0 and self.moving is None):
            return None
        return self.geometry.gaussian(self.parameters.metric_scale) if gaussian is None else gaussian

    def _channels(
        self,
        colours: Stack,
        step: Step,
        gaussian: Gaussian | None,
        features: tuple[tuple[Stack, float], ...] = (),
    ) -> tuple[Stack, float]:
        """Return the channels of the metric without the positions, and their beta."""
        axis = self.geometry.axis
        if not isinstance(self.metric_channels, slice):
            colours = np.ascontiguousarray(np.take(colours, self.metric_channels, axis=axis))
        if self.noise.relative is not None:  # differences count by the noise where they are
            colours = np.divide(colours, np.sqrt(self.noise.relative), dtype=np.float32)

        def regularised(stack: Stack, beta: float) -> tuple[Stack, float]:
            if gaussian is None or not beta:
                return stack, beta
            return gaussian.smooth(stack), beta / gaussian.gain

        guides = [(guide.stack, guide.beta) for guide in self.guides]  # which are clean
        smoothed = [regularised(*feature) for feature in features]
        return join_channels([regularised(colours, step.beta), *guides, *smoothed], axis)


@dataclass(frozen=True)
class SampleTrial:
    """A part of a manifold to try iterations on; samples in `scored_samples` count, None: all."""

    part: Manifold
    start: Stack  # the noisy colours
    signs: Float32s  # stacks like `start`
    scored_samples: Int64s | None
    correlated: bool = False  # neighbours share noise, and so do the perturbations

    @property
    def samples(self) -> int:
        return len(self.scored(self.start))

    @property
    def relative(self) -> Float32s | float:
        """The variance of the noise relative to its mean."""
        return 1.0 if self.part.noise.relative is None else self.scored(self.part.noise.relative)

    def step(self, state: Stack, step: Step) -> Stack:
        metric = self.part.measure(state, step, self._gaussian if step.regularised else None)
        return self.part.average([state], metric).stacks[0]

    @cached_property
    def _gaussian(self) -> Gaussian:
        return self.part.geometry.gaussian(self.part.parameters.metric_scale)

    def scored(self, state: Stack) -> Float32s:
        """Return the colours of the samples that count, shape (S, N)."""
        return state if self.scored_samples is None else self.part.geometry.take(state, self.scored_samples)


def relative_variance(manifold: Manifold) -> Stack:
    """Return the variance of the noise relative to its mean, a stack of one channel."""
    if manifold.noise.relative is not None:
        return manifold.noise.relative
    shape = list(manifold.colours.shape)
    shape[manifold.geometry.axis] = 1
    return np.broadcast_to(np.float32(1), shape)


def mark_clipped(manifold: Manifold, clipped: ClippedChannels) -> Stack:
    """Return the stack of marks of the samples at a limit, to be averaged like colours."""
    geometry = manifold.geometry
    planes = geometry.planes(len(clipped.clipped))
    marks = np.ascontiguousarray(np.moveaxis(planes, 0, geometry.axis))
    for own, mark, kind in in_blocks(geometry.axis, manifold.colours, marks, geometry.kind):
        clipped.mark(own, mark)
        np.copyto(mark, 0, where=kind == EMPTY)
    geometry.refresh(marks)
    return marks


def restore_clipped(manifold: Manifold, clipped: ClippedChannels, colours: Stack, marks: Stack) -> None:
    """Turn averages of clipped colours, in place, into estimates of the colours without noise."""
    geometry = manifold.geometry
    for own, mark, relative in in_blocks(geometry.axis, colours, marks, relative_variance(manifold)):
        clipped.restore(own, mark, relative[0], geometry.threads)
