"""The geometry of a surface: its samples, and which of them are neighbours.

A *stack* is an array of channels for all samples in the inner layout: rows of samples on a mesh, planes of cells on a
grid. *Planes* are per-sample scalars, along the first axis in both layouts.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, Protocol

from beltrami_cli.arrays import Bools, Float32s, Indices, Uint8s
from beltrami_cli.flow.manifolds.kernel_work import KernelWork
from beltrami_cli.flow.parameters import KernelParameters

Stack = Float32s

# Number of differences between neighbours whose median is within 0.3 % of that of all.
ENOUGH_DIFFERENCES = 200_000


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


class Geometry(ABC):
    """The positions of samples in space, and which samples are neighbours."""

    axis: ClassVar[int]
    """The axis of the channels in a stack."""

    threads: int
    spacing: float
    """Mean sample spacing, in the surface's own unit of length; 0 where samples have no neighbours."""

    @property
    @abstractmethod
    def shape(self) -> tuple[int, ...]:
        """The shape of one plane."""

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
    def differences(self, stack: Stack) -> Float32s:
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

    @abstractmethod
    def refresh(self, stack: Stack) -> None:
        """Update the samples that a stack repeats, such as beyond seams."""

    @abstractmethod
    def drop_distances(self) -> None:
        """Free memory that only kernels use; it is computed again if needed."""

    @abstractmethod
    def drop_samples(self) -> None:
        """Free memory that only reading and writing of colours uses; it is computed again if needed."""
