"""Colours in neighbourhoods, and the details of their cells, scale by scale.

A neighbourhood is a square of 32 x 32 cells of a grid, or a cluster of about 400 vertices. About four samples
form a cell, about four of these cells form a cell of the next scale, and so on. The details of a cell are the
differences of its parts from their mean, weighted so that independent noise has the same variance in all details. On a
grid they are the Haar details.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import ClassVar

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int64s
from beltrami_cli.flow.noise.cells import CellStatistics, KindStatistics
from beltrami_cli.flow.noise.components import PAIRS, STEPS, in_components
from beltrami_cli.flow.noise.even_cells import EvenScale
from beltrami_cli.surface import large_arrays

# Number of samples of the smallest training surfaces. With fewer, hard-edged paint is not distinguishable from noise.
MIN_SAMPLES = 256

# Share of clipped samples from which on the noise of a neighbourhood is underestimated.
_MAX_CLIPPED_SHARE = 0.01

# Number of neighbourhoods that are compared at one place: 3 x 3 squares on a grid.
_AROUND = 9


@dataclass(frozen=True)
class Scale(ABC):
    """Parts (samples, or cells of the scale below) and the cells that they form."""

    counts: Array  # samples of each part
    freedom: Array  # number of details in each cell; 0: a cell of one part
    is_whole: Bools  # mask of cells that lack no part

    @abstractmethod
    def sums(self, values: Array) -> Array:
        """Return the sums of values of parts in each cell, along the last axis."""

    @abstractmethod
    def means(self, values: Array) -> Array:
        """Return the means of values of parts over the samples of each cell."""

    @abstractmethod
    def spread(self, values: Array) -> Array:
        """Return the values of cells at each of their parts."""

    @abstractmethod
    def details(self, fine: Array, coarse: Array) -> Array:
        """Return the details, given the means of parts and of their cells, shape (N, ...)."""

    @abstractmethod
    def sums_of_details(self, values: Array) -> Array:
        """Return the sums of values of details, shape (...), in each cell."""

    @abstractmethod
    def padded(self, values: Array, empty: float = 0.0) -> Float32s:
        """Lay out values of cells by neighbourhood, shape (..., P, n)."""


@dataclass(frozen=True, eq=False)
class Neighbourhoods(ABC):
    """The neighbourhoods of a surface from which noise is read."""

    kind: ClassVar[str]  # whose weights read them

    scales: Sequence[Scale]  # and one coarser scale that shows where the last one is even
    of_samples: Int64s  # the neighbourhood of each sample that is read
    centres: Float64s  # positions of the neighbourhoods, shape (P, D)

    @abstractmethod
    def sampled(self, planes: Float32s) -> Float32s:
        """Return the values of planes at the samples that are read, shape (N, n)."""

    @abstractmethod
    def channel_energies(self, channels: ThreeChannels) -> Float32s:
        """Return the energy of the finest details of each channel, by which channels are sorted."""

    @abstractmethod
    def features(self, channels: ThreeChannels) -> list[Array]:
        """Return features of each neighbourhood, shape (P,) each, that are specific to its kind."""

    @abstractmethod
    def even_features(self, even: EvenScale) -> list[Array]:
        """Return the features of the even cells of a scale that the network of the kind reads, in its order."""

    @abstractmethod
    def statistics(self, channels: ThreeChannels, number: int) -> KindStatistics:
        """Return the statistics of the cells of a scale that depend on the kind."""

    @abstractmethod
    def pilot(self, colours: Float32s, variances: Float32s) -> Float32s:
        """Return a quick estimate of the clean colours of the samples that are read.

        It averages neighbouring samples, with weights that fall to 0 at differences that noise rarely reaches, so that
        edges are preserved. It is too coarse for a result, but its levels are nearly free of noise.

        Colours have the shape (3, n). Variances of the noise are means over the channels, shape (n,), or (1,) for all.
        """

    def quiet_energies(self, channels: ThreeChannels, variances: Float64s) -> Float64s | None:
        """Return the energy of quiet parts of each neighbourhood, relative to the noise of components, shape (P,).

        NaN marks neighbourhoods that lack samples. The result is None if such parts cannot be distinguished.
        """
        return None

    @abstractmethod
    def product_of_neighbours(self, values: Float32s) -> float:
        """Return the mean product of neighbouring samples over all channels; values have the shape (3, n)."""

    @abstractmethod
    def over_samples(self, variances: Float64s, parts: Float64s) -> Float32s:
        """Return the variance at each sample relative to its mean, a stack of one channel.

        `parts` are the variances of the parts of neighbourhoods, in the order of the last scale. Where they are NaN,
        and where nothing was read, the variance of the nearest neighbourhood is used.
        """

    def nearest(self, positions: Float64s) -> Int64s:
        """Return the neighbourhood whose centre is nearest to each position."""
        middle, nearest = self.centres.mean(axis=0), np.empty(len(positions), np.int64)
        centres = np.ascontiguousarray((self.centres - middle).T)
        halves = np.square(centres).sum(axis=0) / 2
        # |p - c|^2 / 2 without |p|^2 / 2. For 100,000 positions and the 164 neighbourhoods that are read of a large
        # mesh this takes 28 ms, and SciPy's tree 40 ms and 250 ms to import.
        for block in large_arrays.blocks(len(positions), 1024):
            products = np.einsum("pd,dc->pc", positions[block] - middle, centres)
            nearest[block] = (halves - products).argmin(axis=1)
        return nearest

    @cached_property
    def around(self) -> Int64s:
        """Indices of each neighbourhood and of those nearest to it, shape (P, K)."""
        squares = np.square(self.centres[:, None] - self.centres).sum(axis=2)
        return np.argsort(squares, axis=1, kind="stable")[:, :_AROUND]

    @cached_property
    def counts(self) -> Int64s:
        """Number of samples in each neighbourhood."""
        return np.bincount(self.of_samples).astype(np.int64)

    @property
    def count(self) -> int:
        """Number of neighbourhoods."""
        return len(self.counts)

    def means(self, rows: Array) -> Float32s:
        """Return the means of rows of samples over each neighbourhood."""
        return np.stack([np.bincount(self.of_samples, own) / self.counts for own in rows]).astype(np.float32)

    def cut(self, planes: Float32s, order: Int64s | None = None) -> ThreeChannels:
        """Return the samples that are read from three channels; by default `order` sorts these by energy."""
        channels = ThreeChannels(self, self.sampled(planes) * STEPS, np.arange(len(planes)))
        if order is None:
            order = np.argsort(self.channel_energies(channels), kind="stable")
        return ThreeChannels(self, channels.colours[order], order)


@dataclass(frozen=True)
class ThreeChannels:
    """Three channels of the samples of P neighbourhoods.

    They are sorted by the energy of their finest details, so that features do not depend on the order of the input.
    """

    neighbourhoods: Neighbourhoods
    colours: Float32s  # shape (3, n), in steps of 8 bits
    order: Int64s  # index of each channel in the input

    @property
    def scales(self) -> Sequence[Scale]:
        return self.neighbourhoods.scales

    @property
    def is_clipped(self) -> Bools:
        """Mask of clipped samples, which are at a limit of the colours."""
        return (self.colours <= 0) | (self.colours >= STEPS)

    @property
    def is_unclipped(self) -> Bools:
        """Mask of neighbourhoods with hardly any clipped samples, in the worst channel, shape (P,)."""
        return np.asarray(self.neighbourhoods.means(self.is_clipped).max(axis=0) < _MAX_CLIPPED_SHARE)

    @cached_property
    def means(self) -> list[Array]:
        """The means of the parts of each scale by channel, shape (3, n)."""
        means: list[Array] = [self.colours]
        for scale in self.scales:
            means.append(scale.means(means[-1]))
        return means

    @cached_property
    def details(self) -> list[Array]:
        """The details of the components of each scale, shape (3, ...)."""
        # Details are computed by channel first, so that equal colours have details of exactly 0.
        return [
            in_components(scale.details(*means))
            for scale, means in zip(self.scales, pairwise(self.means), strict=True)
        ]

    @cached_property
    def products(self) -> list[Array]:
        """The mean products of the components' details in each cell of each scale, shape (6, cells)."""
        found = []
        for scale, details in zip(self.scales, self.details, strict=True):
            sums = np.stack([scale.sums_of_details(details[k] * details[m]) for k, m in PAIRS])
            found.append(sums / np.maximum(scale.freedom, 1))
        return found

    @cached_property
    def cells(self) -> list[CellStatistics]:
        """The statistics of the cells of each scale but the coarsest."""
        cells = []
        for number, (scale, above) in enumerate(pairwise(self.scales)):
            products = self.products[number]
            blocks = above.sums(scale.freedom * products[:3]) / np.maximum(above.sums(scale.freedom), 1)
            cells.append(
                CellStatistics(
                    products=scale.padded(products),
                    freedom=scale.padded(scale.freedom),
                    blocks=above.padded(np.where(above.is_whole, blocks, np.inf), np.inf),
                    unevenness=scale.padded(self.unevenness(number), np.inf),
                    of_kind=self.neighbourhoods.statistics(self, number),
                )
            )
        return cells

    def unevenness(self, number: int) -> Array:
        """Return the energy of the next two scales around each cell of a scale; infinite where it is unknown."""
        above, *further = self.scales[number + 1 : number + 3]
        totals = [3 * products[:3].sum(axis=0) for products in self.products[number + 1 : number + 3]]
        if further:
            totals[0] = totals[0] + further[0].spread(totals[1])
        return above.spread(np.where(above.is_whole, totals[0], np.inf))


def ranks_within(groups: Int64s, order: Int64s) -> Int64s:
    """Return the rank of each row within its group, given an order of the rows that sorts them by group."""
    counts, ranks = np.bincount(groups), np.empty(len(groups), np.int64)
    ranks[order] = np.arange(len(groups)) - np.repeat(np.cumsum(counts) - counts, counts)
    return ranks
