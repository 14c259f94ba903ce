"""Image manifolds: what enters their metric, measuring distances by it, and averaging by them.

A sample has a position X and a colour I, and is embedded as (X, beta I). Two kinds of manifolds are sampled:
triangulated surfaces, and regular grids. A manifold is composed of its geometry, which holds positions and neighbours,
of colours, and of the kernels of the metric that both induce. Equations: A. Spira, R. Kimmel, N. Sochen,
"A short time Beltrami kernel for smoothing images on manifolds", IEEE Trans. Image Processing 16(6), 2007,
https://doi.org/10.1109/TIP.2007.894253
"""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Int64s
from beltrami_cli.flow.chunks import IN_ONE_PIECE, Resources
from beltrami_cli.flow.manifolds.domain import CoarseLevel, Domain, Gaussian, Geometry, Mixing, Stack
from beltrami_cli.flow.manifolds.guides import GuideStack
from beltrami_cli.flow.manifolds.new_colours import NewColours
from beltrami_cli.flow.manifolds.search_range import Rule, SearchRange
from beltrami_cli.flow.noise.model import NoiseModel, choose_beta
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.surface.large_arrays import Droppable

if TYPE_CHECKING:
    from beltrami_cli.flow.manifolds.moving_positions import MovingPositions


@dataclass(frozen=True)
class Step:
    """One iteration: beta in units of length per unit of colour, the time step, whether the metric is regularised."""

    beta: float
    t: float
    regularised: bool


@dataclass(frozen=True)
class Metric:
    """The metric of an iteration, eq. (1).

    That of a grid, and of a mesh in chunks, is induced by the first `channels` of the first stack, part by part, while
    they are averaged; that of a whole mesh is a `MeshMetric`.
    """

    step: Step
    channels: int
    gaussian: Gaussian | None  # None: not regularised


@dataclass(frozen=True)
class Outliers:
    """The K samples that were filled, and their colours before."""

    samples: Int64s  # counted among all samples of the surface
    channels: Bools  # which are wrong, shape (K, N)
    colours: Float32s  # shape (K, N)
    share: float  # of all samples


@dataclass(frozen=True, kw_only=True, eq=False)
class StabilisedColours:
    """Colours as manifolds have them: without outliers, and with noise that is the same at all levels.

    Parameters and results are in units of the input's colours: `NoiseModel.to_input` converts colours, and
    `beta_to_input`, `difference_to_input` and `square_to_input` what is measured in them.
    """

    stack: Stack
    noise: NoiseModel  # of the stack
    outliers: Outliers | None = None  # that were filled


@dataclass(frozen=True, kw_only=True, eq=False)
class Manifold(ABC):
    """Samples of an image manifold, or of a part of one, ready to be measured and averaged."""

    geometry: Geometry
    colours: Stack  # stabilised, see `StabilisedColours`; before or after iterations
    noise: NoiseModel  # of the colours
    parameters: KernelParameters
    unit: float  # of length, for t and beta, in sample spacings
    metric_channels: list[int] | slice
    guides: tuple[GuideStack, ...] = ()
    moving: MovingPositions | None = None  # positions that are smoothed along with the colours
    is_in_one_block: bool = False  # averaged at once, whatever its size; stacks stay as they are
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

    def drop_kernels(self) -> None:
        """Free the memory of what only kernels need; it is computed again if more of them are run."""
        vars(self).pop("_kernel_chunks", None)
        self.geometry.drop_distances()

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
    def perturbation(self) -> Droppable[Array]:
        """Draw a stack of random signs, or of noise that neighbours share as they share that of the colours."""

    @abstractmethod
    def levels(self, most: int, tick: Callable[[], None] | None = None) -> Sequence[CoarseLevel]:
        """Return up to `most` levels, fine to coarse, each of some four samples of the one before."""

    @property
    @abstractmethod
    def regions(self) -> Domain:
        """The samples, or means of them, over which regions of the surface are averaged."""

    @abstractmethod
    def trial(self) -> SampleTrial:
        """Choose samples to try parameters on, and draw the perturbations of their colours."""

    @abstractmethod
    def new_colours(self) -> NewColours:
        """Return the colours block by block, with those beyond seams, to be written back to the document."""

    def _with_outliers(self, new: NewColours, order: Array | None = None) -> NewColours:
        """Return new colours, those of samples in an order, with the outliers as they were, if they are kept."""
        own = self.outliers
        if own is None or self.parameters.outliers != "keep":
            return new
        samples = own.samples if order is None else order[own.samples]
        return new.with_kept(samples, own.channels, own.colours)

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
        return _join_channels([regularised(colours, step.beta), *guides, *smoothed], axis)


@dataclass(frozen=True)
class Averaged:
    """Averages of channels by eq. (9), how many samples the kernels held, and how many kernels were cut short."""

    stacks: list[Float32s]
    samples: float
    truncated: int = 0
    moving: MovingPositions | None = None  # after the iteration


@dataclass(frozen=True)
class SampledKernel:
    """The K samples in the kernel of one sample p, p first and the others by their distance."""

    samples: Int64s  # shape (K,)
    distances: Float32s  # d(p, q), in the unit of length of the parameters; 0 at p
    weights: Float32s  # w_q exp(-d(p, q)^2 / (4 t)), eqs. (8, 9), not yet divided by their sum
    colours: Float32s  # I(q), before the iteration, in the working space, shape (K, N)
    offsets: Int64s | None = None  # on a grid, rows and columns from p, shape (K, 2)


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


def at_step(parameters: KernelParameters, step: Step) -> KernelParameters:
    """Return parameters with the time step of an iteration, which the radius of kernels follows."""
    return parameters if step.t == parameters.t else dataclasses.replace(parameters, t=step.t)


def kernel_values(distances: Float32s, t: float) -> Float32s:
    """Return exp(-d^2 / (4 t)), eq. (8)."""
    return np.asarray(np.exp(-np.square(distances.astype(np.float64)) / (4 * t)), np.float32)


def _join_channels(parts: Sequence[tuple[Float32s, float]], axis: int) -> tuple[Float32s, float]:
    """Concatenate channels of different beta, colours first, as channels of one beta; it is 0 if none has any."""
    weighted = [(values, beta) for values, beta in parts if beta > 0 and values.shape[axis] > 0]
    if len(weighted) < 2:
        return weighted[0] if weighted else (parts[0][0], 0.0)
    largest = max(beta for _, beta in weighted)
    # The first part keeps its bits, unless the others would leave the range of float32.
    common = weighted[0][1] if weighted[0][1] > 1e-9 * largest else largest
    scaled = [values if beta == common else values * np.float32(beta / common) for values, beta in weighted]
    return np.concatenate(scaled, axis=axis), common


def relative_variance(manifold: Manifold) -> Stack:
    """Return the variance of the noise relative to its mean, a stack of one channel."""
    if manifold.noise.relative is not None:
        return manifold.noise.relative
    shape = list(manifold.colours.shape)
    shape[manifold.geometry.axis] = 1
    return np.broadcast_to(np.float32(1), shape)
