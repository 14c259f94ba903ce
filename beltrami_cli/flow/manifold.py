"""The interface of image manifolds: measuring distances, and averaging by them.

A sample has a position X and a colour I, and is embedded as (X, beta I). Two kinds of manifolds are sampled:
triangulated surfaces, and regular grids. Equations are those of A. Spira, R. Kimmel, N. Sochen, "A short time
Beltrami kernel for smoothing images on manifolds", IEEE Trans. Image Processing 16(6), 2007,
https://doi.org/10.1109/TIP.2007.894253
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Bools, Float32s, Float64s, Int64s
from beltrami_cli.flow.clipping import ClippedChannels
from beltrami_cli.flow.domain import CoarseLevel, Domain, Stack
from beltrami_cli.flow.embedding import Guide, beta_of, choose_guide_beta, join_channels
from beltrami_cli.flow.geometry import MovingPositions
from beltrami_cli.flow.noise.model import NoiseModel
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.flow.partitions import Partition
from beltrami_cli.flow.records import Averaged, KernelWork, Mixing, NewColours, SampledKernel, Step
from beltrami_cli.flow.regularisation import GridGaussian, MeshGaussian
from beltrami_cli.flow.search_range import Rule, SearchRange


class Manifold(Domain):
    """Samples of an image manifold, or of a part of one, ready to be measured and averaged.

    The first stack holds the colours; the others are averaged by the same kernels.
    """

    search_range: ClassVar[SearchRange]
    """The parameters that are tried when they are chosen from the data."""

    rule: ClassVar[Rule]
    """The parameters for a noise level where nothing is tried."""

    size: int
    """Samples that an iteration goes through, for its progress."""

    kernels: int
    """Samples that have a kernel."""

    spacing: float
    """Mean sample spacing, in the surface's own unit of length; 0 where samples have no neighbours."""

    plain_levels: ClassVar[tuple[int, ...]]
    """The levels at which plain colours are estimated, coarse to fine."""

    unit: float
    """The unit of length of t and beta, in sample spacings."""

    colours: Float32s
    """The stack of the colours, before or after iterations."""

    noise: NoiseModel
    """The noise of the colours."""

    moving: MovingPositions | None = None
    """The positions, if they are smoothed along with the colours."""

    @property
    def relative(self) -> Float32s:
        """The variance of the noise relative to its mean, a stack of one channel like that of the colours."""
        if self.noise.relative is not None:
            return self.noise.relative
        shape = list(self.colours.shape)
        shape[self.axis] = 1
        return np.broadcast_to(np.float32(1), shape)

    @property
    def metric_sigma(self) -> Float64s:
        """Standard deviation of the noise of the channels that enter the metric."""
        return self.noise.sigma if self.chosen is None else self.noise.sigma[self.chosen]

    @property
    def beta(self) -> float:
        """The given beta, or else one for the noise, in units of length per unit of stabilised colours."""
        return beta_of(self.parameters, self.metric_sigma, self.unit) if len(self.metric_sigma) else 0.0

    def having(self, **values: Any) -> Self:
        """Return the same manifold with other parameters, noise or colours."""
        other = object.__new__(type(self))  # copying would drop the compiled core, which is not pickled
        other.__dict__ |= {**self.__dict__, **values}
        return other

    def coarse_levels(self) -> Iterator[CoarseLevel]:
        """Go through levels, coarse to fine, at which plain colours are estimated better than sample by sample."""
        if self.noise.is_shared:  # which they have been estimated for
            return
        levels = self.levels(max(self.plain_levels))
        yield from (levels[number - 1] for number in self.plain_levels if number <= len(levels))

    def refresh(self, stack: Stack) -> None:
        """Let samples show new colours where they are shown again, as beyond seams."""

    def __init__(self, parameters: KernelParameters, metric_channels: Sequence[int] | None) -> None:
        self.parameters, self.threads = parameters, parameters.thread_count
        self.chosen = None if metric_channels is None else list(metric_channels)
        self.guide_betas: dict[str, float] = {}
        self.guides: list[tuple[Float32s, float]] = []
        self._gaussian: MeshGaussian | GridGaussian | None = None

    def lay_out_guides(self, guides: Sequence[Guide]) -> None:
        for guide in guides:
            stack, beta = self._laid_out(guide), guide.beta
            if beta is None:
                beta = choose_guide_beta(guide.values, self.steps(stack)) * self.unit
            self.guide_betas[guide.name] = beta
            self.guides.append((stack, beta))

    def channels(self, colours: Float32s, step: Step) -> tuple[Float32s, float]:
        """Return the channels that enter the metric besides the positions, and their beta."""
        beta = step.beta
        if self.chosen is not None:
            colours = np.ascontiguousarray(np.take(colours, self.chosen, axis=self.axis))
        if self.noise.relative is not None:  # differences count by the noise where they are
            colours = np.divide(colours, np.sqrt(self.noise.relative), dtype=np.float32)
        own = self.regularised(colours, beta) if step.regularised else (colours, beta)
        return join_channels([own, *self.guides, *self._features(step)], self.axis)

    def regularised(self, channels: Float32s, beta: float) -> tuple[Float32s, float]:
        """Return smoothed channels for the metric, and their beta."""
        if beta == 0:
            return channels, beta
        if self._gaussian is None:
            self._gaussian = self._smoothing()
        return self._gaussian.smooth(channels), beta / self._gaussian.gain

    def forget_smoothing(self) -> None:
        """Free the memory that only regularised iterations need."""
        self._gaussian = None

    @property
    @abstractmethod
    def work(self) -> KernelWork:
        """How much work its kernels are."""

    @abstractmethod
    def trial(self) -> SampleTrial:
        """Choose samples to try parameters on, and draw the perturbations of their colours."""

    @abstractmethod
    def release(self) -> None:
        """Free the memory that only cuts need."""

    @abstractmethod
    def measure(self, colours: Float32s, step: Step) -> None:
        """Induce the metric, eq. (1), by colours."""

    @abstractmethod
    def average(self, stacks: list[Float32s], progress: Callable[[int], None] | None = None) -> Averaged:
        """Average stacks by the kernels of the metric, eqs. (8) and (9); they may be changed in place."""

    @abstractmethod
    def partitions(
        self, count: int, widening: int, steps: Sequence[Step], channels: int
    ) -> Sequence[Partition]:
        """Cut into up to `count` partitions; those that prove too narrow are cut again, with a greater `widening`."""

    @abstractmethod
    def cut(self, samples: Any, *others: Any) -> Manifold:
        """Return a part of the manifold as a manifold without colours; its metric is that of the whole."""

    @abstractmethod
    def rows(self, stacks: Sequence[Float32s]) -> Float32s:
        """Return the channels of all stacks, with a row a sample."""

    @abstractmethod
    def put_rows(self, rows: Float32s, stacks: Sequence[Float32s]) -> None:
        """Put rows of samples back into stacks, in place."""

    @abstractmethod
    def take(self, stack: Float32s, samples: Int64s) -> Float32s:
        """Return the channels of some samples, with a row a sample."""

    @abstractmethod
    def values(self) -> Float32s:
        """Return the colours as they are now, shape (S, N), in the caller's order."""

    @abstractmethod
    def new_colours(self) -> NewColours:
        """Return the colours block by block, with those beyond seams, to be written back to the document."""

    @abstractmethod
    def find_clipped(self) -> ClippedChannels | None:
        """Find the channels whose noise was cut off at 0 or at full scale."""

    @abstractmethod
    def marks(self, clipped: ClippedChannels) -> Float32s:
        """Return the stack of marks of the samples at a limit."""

    @abstractmethod
    def restore(self, clipped: ClippedChannels, colours: Float32s, marks: Float32s) -> None:
        """Turn averages of clipped colours, in place, into estimates of the colours without noise."""

    @abstractmethod
    def collaborate(
        self, noisy: Stack, pilot: Stack, mixing: Mixing, progress: Callable[[int], None] | None
    ) -> Stack:
        """Estimate colours from patches that look alike in the pilot."""

    @abstractmethod
    def perturbation(self) -> Float32s | NDArray[np.int8]:
        """Return a stack of random signs, or of noise that neighbours share as they share that of the colours."""

    @abstractmethod
    def single(self, marked: Bools) -> Bools:
        """Return which of the marked samples have no marked ones beside them."""

    @abstractmethod
    def levels(self, most: int, tick: Callable[[], None] | None = None) -> Sequence[CoarseLevel]:
        """Return up to `most` levels, fine to coarse, each of some four samples of the one before."""

    @abstractmethod
    def kernel_at(self, sample: int, step: Step) -> SampledKernel:
        """Return the kernel that an iteration from the present colours has at a sample."""

    @abstractmethod
    def _smoothing(self) -> MeshGaussian | GridGaussian:
        """Make the Gaussian of the regularised metric."""

    @abstractmethod
    def _laid_out(self, guide: Guide) -> Float32s:
        """Return the stack of a guide."""

    @abstractmethod
    def steps(self, stack: Float32s) -> Float32s:
        """Return differences of a stack between neighbouring samples, shape (K, G)."""

    def _features(self, step: Step) -> list[tuple[Float32s, float]]:
        """Return further channels that count as distance, with their beta."""
        del step
        return []


@dataclass(frozen=True)
class SampleTrial:
    """A part of a manifold to try iterations on; samples in `scored_samples` count, None: all."""

    part: Manifold
    start: Float32s  # stack of the noisy colours
    signs: Float32s  # stacks like `start`
    scored_samples: Int64s | None
    correlated: bool = False  # neighbours share noise, and so do the perturbations

    @property
    def samples(self) -> int:
        """How many samples count."""
        return len(self.scored(self.start))

    @property
    def relative(self) -> Float32s | float:
        """The variance of the noise relative to its mean."""
        return 1.0 if self.part.noise.relative is None else self.scored(self.part.noise.relative)

    def step(self, state: Float32s, step: Step) -> Float32s:
        """Return the colours after an iteration."""
        self.part.measure(state, step)
        return self.part.average([state]).stacks[0]

    def scored(self, state: Float32s) -> Float32s:
        """Return the colours of the samples that count, shape (S, N)."""
        return state if self.scored_samples is None else self.part.take(state, self.scored_samples)
