"""Interfaces of geometry and levels: the samples of a manifold, and means of groups of samples."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar, Protocol

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Indices, Uint8s
from beltrami_cli.flow.manifolds.blocks import block_rows, in_parallel
from beltrami_cli.flow.manifolds.kernel_work import KernelWork
from beltrami_cli.flow.mixing import Mixing
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.surface import large_arrays

Stack = Float32s

# Number of steps between neighbours whose median is within 0.3 % of that of all.
ENOUGH_STEPS = 200_000


class Samples(ABC):
    """Samples of a surface, or means of groups of them.

    A *stack* is an array of channels for all samples in the inner layout: rows of samples on a mesh, planes of cells on
    a grid. *Planes* are per-sample scalars, along the first axis in both layouts.
    """

    axis: ClassVar[int]
    """The axis of the channels in a stack."""

    @property
    @abstractmethod
    def shape(self) -> tuple[int, ...]:
        """The shape of one plane."""

    def planes(self, count: int) -> Float32s:
        """Return planes of zeros."""
        planes: Float32s = large_arrays.zeros((count, *self.shape), np.float32)
        return planes


class Domain(Samples):
    """Samples over which per-sample scalars are summed and averaged."""

    width: float
    """Standard deviation of `spread`, in sample spacings."""

    noise: float
    """Variance of the noise, relative to that of the averaged samples."""

    @abstractmethod
    def total(self, planes: Float32s) -> Float64s:
        """Sum planes over the samples that have a kernel."""

    @abstractmethod
    def spread(self, planes: Float32s) -> Float32s:
        """Average planes over the surface, nearly by a Gaussian of standard deviation `width`."""


class Regions(Domain):
    """Samples, or means of squares of them, over which scalars of all samples are gathered, and enlarged again."""

    side: int
    """Number of rows of samples in a row of means."""

    @abstractmethod
    def means_of_rows(self, planes: Float32s, rows: slice) -> tuple[slice, Float32s]:
        """Average planes of some rows, in whole multiples of `side`; return the rows of the means, and the means."""

    @abstractmethod
    def enlarged(self, planes: Float32s, rows: slice) -> Float32s:
        """Interpolate planes of means at some rows of samples."""

    def gathered(self, count: int, terms: Callable[[slice], Float32s], like: Array, threads: int) -> Float32s:
        """Compute `count` terms row by row, and average them to regions; `like`: a stack of all samples."""
        planes = self.planes(count)

        def gather(rows: slice) -> None:
            rows_of_means, means = self.means_of_rows(terms(rows), rows)
            planes[:, rows_of_means] = means

        in_parallel(gather, threads, ((rows,) for rows in block_rows(like, self.side)))
        return planes


class Gaussian(Protocol):
    """Gaussian of the regularised metric, in which distances are measured on slightly smoothed colours.

    Averages are still taken of the colours themselves. Smoothing reduces the noise in the metric by a known gain, and
    beta is divided by it. Noise then contributes the same to distances with and without regularisation, and beta keeps
    its meaning.
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
        """Number of samples that an iteration visits, for its progress."""

    @property
    @abstractmethod
    def kernels(self) -> int:
        """Number of samples that have a kernel."""

    @property
    @abstractmethod
    def kind(self) -> Uint8s:
        """EMPTY, OWNED or HALO, see `surface.atlas`, as a stack of one channel."""

    def unit(self, parameters: KernelParameters) -> float:
        """Return the unit of length of the parameters, in sample spacings."""
        return self.spacing if parameters.units == "world" else 1.0

    @abstractmethod
    def work(self, unit: float) -> KernelWork:
        """Return the workload of kernels for a unit of length, in sample spacings."""

    @abstractmethod
    def take(self, stack: Stack, samples: Indices) -> Float32s:
        """Return the channels of some samples, one row per sample."""

    @abstractmethod
    def steps(self, stack: Stack) -> Float32s:
        """Differences of a stack between neighbouring samples, shape (K, G)."""

    @abstractmethod
    def isolated(self, marked: Bools) -> Bools:
        """Return the marked samples without marked neighbours."""

    @abstractmethod
    def smoothable(self, colours: Stack) -> tuple[Float32s, int]:
        """Return the channels of the samples that can be smoothed, and the number of empty ones, which are 0."""

    @abstractmethod
    def gaussian(self, scale: float) -> Gaussian:
        """Make the Gaussian of the regularised metric, `scale` sample spacings wide."""

    def refresh(self, stack: Stack) -> None:
        """Update the samples that a stack repeats, such as beyond seams."""

    def drop_distances(self) -> None:
        """Free memory that only kernels use; it is computed again if needed."""

    def drop_samples(self) -> None:
        """Free memory that only reading and writing of colours uses; it is computed again if needed."""


class CoarseLevel(Domain):
    """Means of groups of neighbouring samples, which are the samples of a coarser surface."""

    relative: Float32s
    """Variance of the noise of each mean, relative to `noise`."""

    @abstractmethod
    def means(self, stack: Stack) -> Stack: ...

    @abstractmethod
    def collaborate(
        self, noisy: Stack, pilot: Stack, mixing: Mixing, progress: Callable[[int], None] | None = None, *,
        shared: bool = False,
    ) -> Stack:  # fmt: skip
        """Estimate means from patches that are similar in the pilot; `shared` noise is the same in all means."""

    @abstractmethod
    def probe(self, means: Stack, noise: Float64s) -> Stack:
        """Draw random means, shaped like `means`, with a covariance of the channels."""

    @abstractmethod
    def add_enlarged(self, stack: Stack, changes: Stack) -> None:
        """Add interpolated changes of means to a stack, in place."""
