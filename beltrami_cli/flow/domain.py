"""What numbers on a surface are summed and averaged over: the samples of a manifold, and means of groups of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Uint8s
from beltrami_cli.flow.clipping import ClippedChannels
from beltrami_cli.flow.records import KernelWork, Mixing
from beltrami_cli.flow.regularisation import Gaussian
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import Indices

Stack = Float32s

# The median of this many steps between neighbours is within 0.3 % of that of all.
ENOUGH_STEPS = 200_000


class Domain(ABC):
    """Samples that numbers are summed and averaged over.

    A *stack* is an array of channels for all samples in the inner layout: rows of samples on a mesh, planes of cells on
    a grid. *Planes* are numbers that are no colours, along the first axis in both layouts.
    """

    axis: ClassVar[int]
    """The axis of the channels in a stack."""

    width: ClassVar[float]
    """Standard deviation of `spread`, in sample spacings."""

    @abstractmethod
    def planes(self, count: int) -> Float32s:
        """Return zeros for numbers of samples."""

    @abstractmethod
    def total(self, planes: Float32s) -> Float64s:
        """Sum planes over the samples that have a kernel."""

    @abstractmethod
    def spread(self, planes: Float32s) -> Float32s:
        """Average planes over the surface by about a Gaussian of standard deviation `width`."""


class Geometry(Domain):
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
    def find_clipped(self, colours: Stack, sigma: Float64s) -> ClippedChannels | None:
        """Find the channels whose noise, of standard deviation `sigma`, was cut off at 0 or at full scale."""

    @abstractmethod
    def gaussian(self, scale: float) -> Gaussian:
        """Make the Gaussian of the regularised metric, `scale` sample spacings wide."""

    def refresh(self, stack: Stack) -> None:
        """Copy samples to where a stack shows them again, as beyond seams."""

    def drop_distances(self) -> None:
        """Free the memory of what only kernels need; it is computed again if more of them are run."""

    def for_kernels(self) -> Geometry:
        """Return the geometry without what only parts that are cut from it need."""
        return self


class CoarseLevel(Domain):
    """Means of groups of neighbouring samples, as fewer samples of the same surface."""

    noise: float
    """The variance of the noise of means, by that of samples."""

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


def in_blocks(axis: int, *stacks: Array) -> Iterator[tuple[Array, ...]]:
    """Go through stacks together in blocks, with the channels, which are at `axis`, first."""
    whole = [np.moveaxis(stack, axis, 0) for stack in stacks]
    size = max(1, large_arrays.CACHED // max(1, whole[0][0, :1].size))
    for rows in large_arrays.blocks(whole[0].shape[1], size):
        yield tuple(stack[:, rows] for stack in whole)
