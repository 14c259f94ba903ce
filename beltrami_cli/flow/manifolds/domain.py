"""Domains of sums and averages: the samples of a manifold, and means of groups of them."""

from __future__ import annotations

import logging
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar, Protocol

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Uint8s
from beltrami_cli.flow.manifolds.blocks import at_same_time, block_rows
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.surface.atlas import Indices

Stack = Float32s

# The median of this many steps between neighbours is within 0.3 % of that of all.
ENOUGH_STEPS = 200_000

LOG = logging.getLogger(__name__)
"""Says how much work is ahead, before it starts."""


class Samples(ABC):
    """Samples of a surface, or means of groups of them.

    A *stack* is an array of channels for all samples in the inner layout: rows of samples on a mesh, planes of cells on
    a grid. *Planes* are per-sample scalars, along the first axis in both layouts.
    """

    axis: ClassVar[int]
    """The axis of the channels in a stack."""

    @abstractmethod
    def planes(self, count: int) -> Float32s:
        """Return zeros."""


class Domain(Samples):
    """Samples that numbers are summed and averaged over."""

    width: float
    """Standard deviation of `spread`, in sample spacings."""

    noise: float = 1.0
    """The variance of the noise of samples, by that of the samples that these are means of."""

    side: int = 1
    """How many rows of the samples that these are means of belong to a row of these."""

    @abstractmethod
    def total(self, planes: Float32s) -> Float64s:
        """Sum planes over the samples that have a kernel."""

    @abstractmethod
    def spread(self, planes: Float32s) -> Float32s:
        """Average planes over the surface by about a Gaussian of standard deviation `width`."""

    def means_of_rows(self, planes: Float32s, rows: slice) -> tuple[slice, Float32s]:
        """Return the means of planes of some rows, whole multiples of `side`, and the rows that they are."""
        return rows, planes

    def gathered(self, count: int, terms: Callable[[slice], Float32s], like: Array, threads: int) -> Float32s:
        """Return the means of terms, which a function computes for some rows; `like`: a stack of all samples."""
        planes = self.planes(count)

        def gather(rows: slice) -> None:
            own, means = self.means_of_rows(terms(rows), rows)
            planes[:, own] = means

        at_same_time(gather, threads, ((rows,) for rows in block_rows(like, self.side)))
        return planes

    def enlarged(self, planes: Float32s, rows: slice) -> Float32s:
        """Return planes at some rows of the samples that these are means of."""
        return planes[:, rows]


class Gaussian(Protocol):
    """Makes the regularised metric: distances are taken from slightly smoothed colours, so that noise causes none.

    Averages are still taken over the colours themselves. Smoothing reduces the noise in the metric by a known gain, and
    beta is divided by it, so that noise adds the same to distances with and without it and beta keeps its meaning.
    """

    @property
    def gain(self) -> float:
        """Remaining standard deviation of white noise."""

    def smooth(self, stack: Stack, /) -> Stack: ...


class Geometry(Samples):
    """The positions of samples in space, and which samples are neighbours."""

    threads: int
    spacing: float
    """Mean sample spacing, in the surface's own unit of length; 0 where samples have no neighbours."""

    @property
    @abstractmethod
    def size(self) -> int:
        """Samples that an iteration goes through, for its progress."""

    @property
    def kernels(self) -> int:
        """How many samples have a kernel."""
        return len(self.samples)

    @property
    @abstractmethod
    def samples(self) -> Indices:
        """The places in a stack of the samples that have a kernel."""

    @property
    @abstractmethod
    def kind(self) -> Uint8s:
        """EMPTY, OWNED or HALO, see `surface.atlas`, as a stack of one channel."""

    @abstractmethod
    def work(self, unit: float) -> KernelWork:
        """Return how much work kernels are, with this unit of length in sample spacings."""

    @abstractmethod
    def take(self, stack: Stack, samples: Indices) -> Float32s:
        """Return the channels of some samples, with a row a sample."""

    @abstractmethod
    def steps(self, stack: Stack) -> Float32s:
        """Return differences of a stack between neighbouring samples, shape (K, G)."""

    @abstractmethod
    def single(self, marked: Bools) -> Bools:
        """Return which of the marked samples have no marked neighbours."""

    @abstractmethod
    def counted(self, colours: Stack) -> tuple[Float32s, int]:
        """Return the channels of the samples that can be smoothed, and how many of these are empty, and 0."""

    @abstractmethod
    def gaussian(self, scale: float) -> Gaussian:
        """Make the Gaussian of the regularised metric, `scale` sample spacings wide."""

    def refresh(self, stack: Stack) -> None:
        """Copy samples to where a stack shows them again, as beyond seams."""

    def drop_distances(self) -> None:
        """Free the memory of what only kernels need; it is computed again if more of them are run."""

    def drop_samples(self) -> None:
        """Free the memory of what only reading and writing colours needs; it is computed again for that."""


class KernelWork:
    """Work with kernels that a window bounds, as on a grid."""

    def __init__(self, kernels: int, unit: float) -> None:
        self.kernels = kernels
        self._unit = unit or 1.0

    @property
    def has_uniform_density(self) -> bool:
        """Whether the best parameters of parts are the best ones of the whole."""
        return True

    def bounded(self, parameters: KernelParameters) -> KernelParameters:
        """Return parameters with fewer samples a kernel, if the samples need that and the limit is the default."""
        return parameters

    def samples(self, parameters: KernelParameters) -> float:
        """Return how many samples all kernels of an iteration hold, at most."""
        return self.kernels * min(self._on_even_surface(parameters), parameters.window**2)

    def announce(self, parameters: KernelParameters) -> None:
        LOG.info(
            "%d samples are averaged in each of %d iterations, with at most some %.2g million neighbours in all",
            self.kernels, parameters.iterations, parameters.iterations * self.samples(parameters) / 1e6,
        )  # fmt: skip

    def _on_even_surface(self, parameters: KernelParameters) -> float:
        """Return how many samples a kernel holds where triangles are equilateral, with an area of sqrt(3) / 4."""
        circle, of_sample = math.pi * (parameters.radius / self._unit) ** 2, math.sqrt(3) / 2
        return 1 + circle / of_sample


class CoarseLevel(Domain):
    """Means of groups of neighbouring samples, as fewer samples of the same surface."""

    relative: Float32s
    """The variance of the noise of each mean, relative to this."""

    @abstractmethod
    def means(self, stack: Float32s) -> Float32s:
        """Return the means of a stack."""

    @abstractmethod
    def collaborate(self, noisy: Stack, pilot: Stack, mixing: Mixing, *, shared: bool = False) -> Stack:
        """Estimate means from patches that are similar in the pilot; noise that samples share is the same in all."""

    @abstractmethod
    def probe(self, means: Stack, noise: Float64s) -> Stack:
        """Return random means, of the shape of others, with a covariance of the channels."""

    @abstractmethod
    def add_enlarged(self, stack: Stack, changes: Stack) -> None:
        """Add changes of means to a stack, in place."""


@dataclass(frozen=True)
class Mixing:
    """How N channels are mixed so that each can be estimated by itself, shape (N, N), and their noise, shape (N,)."""

    forth: Float32s
    back: Float32s
    variances: Float32s
    shrinkage: Float32s  # what the noise is multiplied by, with a pilot, where there is no detail, shape (N,)
    least_ratio: float = 0.0  # ... and at least, where there is
    strength: float = 1.0  # ... and besides, everywhere
    has_pilot: bool = field(default=False, kw_only=True)  # patches are compared on an estimate

    @property
    def parts(self) -> tuple[Float32s, Float32s, Float32s, Float32s, float, float]:
        return self.forth, self.back, self.variances, self.shrinkage, self.least_ratio, self.strength
