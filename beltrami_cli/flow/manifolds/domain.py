"""Interfaces of sums and means over a surface: over its samples, and over groups of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s
from beltrami_cli.flow.manifolds.blocks import block_rows, in_parallel
from beltrami_cli.flow.manifolds.geometry import Stack
from beltrami_cli.flow.mixing import Mixing
from beltrami_cli.surface import large_arrays


class Domain(ABC):
    """Samples over which per-sample scalars are summed and averaged."""

    width: float
    """Standard deviation of `spread`, in sample spacings."""

    @property
    @abstractmethod
    def noise_ratio(self) -> float:
        """Variance of the noise, relative to that of the averaged samples."""

    @property
    @abstractmethod
    def shape(self) -> tuple[int, ...]:
        """The shape of one plane."""

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
        planes = large_arrays.zeros((count, *self.shape), np.float32)

        def gather(rows: slice) -> None:
            rows_of_means, means = self.means_of_rows(terms(rows), rows)
            planes[:, rows_of_means] = means

        in_parallel(gather, threads, ((rows,) for rows in block_rows(like, self.side)))
        return planes


class CoarseLevel(Domain):
    """Means of groups of neighbouring samples, which are the samples of a coarser surface."""

    axis: ClassVar[int]
    """The axis of the channels in a stack."""

    relative_variances: Float32s
    """Variance of the noise of each mean, relative to `noise_ratio`."""

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
    def add_enlarged_in_place(self, stack: Stack, changes: Stack) -> None:
        """Add interpolated changes of means to a stack."""
