"""What numbers on a surface are summed and averaged over: the samples of a manifold, and means of groups of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from beltrami_cli.arrays import Float32s, Float64s
from beltrami_cli.flow.records import Mixing

Stack = Float32s


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
        """Estimate means from patches that look alike in the pilot; noise that samples share is the same in all."""

    @abstractmethod
    def probe(self, means: Stack, noise: Float64s) -> Stack:
        """Return random means, of the shape of others, with a covariance of the channels."""

    @abstractmethod
    def add_enlarged(self, stack: Stack, changes: Stack) -> None:
        """Add changes of means to a stack, in place."""
