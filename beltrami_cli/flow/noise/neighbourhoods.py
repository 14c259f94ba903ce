"""Colours in neighbourhoods, and the details of their cells, scale by scale.

A neighbourhood is a square of 32 x 32 cells of a grid, or a cluster of some 400 vertices. Some four samples form a
cell, some four of these cells one of the next scale, and so on. The details of a cell are the differences of its parts
from their mean, weighted so that independent noise has the same variance in all of them: on a grid the Haar details.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import ClassVar

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int64s
from beltrami_cli.flow.noise.features import (
    COMPONENTS,
    PAIRS,
    SCALES,
    STEPS,
    Blocks,
    Cells,
    log_deviation,
    order_of,
    variances_of_channels,
)

# A neighbourhood and those around it, on a grid of squares.
_AROUND = 9


@dataclass(frozen=True)
class Scale:
    """Parts (samples, or cells of the scale below) and the cells that they form."""

    parents: Int64s  # the cell of each part
    counts: Float64s  # samples of each part
    freedom: Float64s  # details in each cell; 0: a single part
    is_whole: Bools  # cells that lack no part
    tile: Int64s  # the neighbourhood of each cell
    slot: Int64s  # the number of each cell within its neighbourhood

    @cached_property
    def samples(self) -> Float64s:
        """The samples of the parts of each cell; at least 1."""
        return np.maximum(self.sums(self.counts), 1)

    def sums(self, values: Array) -> Float64s:
        """Return the sums of values of parts in each cell."""
        return np.bincount(self.parents, values, len(self.tile)).astype(np.float64, copy=False)

    def means(self, values: Array) -> Float64s:
        """Return the means of values of parts in each cell."""
        return self.sums(self.counts * values) / self.samples

    def padded(self, values: Array, empty: float = 0.0) -> Float32s:
        """Lay out values of cells by neighbourhood, shape (..., P, n)."""
        shape = int(self.tile.max(initial=-1)) + 1, int(self.slot.max(initial=0)) + 1
        found = np.full((*values.shape[:-1], *shape), empty, np.float32)
        found[..., self.tile, self.slot] = values
        return found


class Neighbourhoods(ABC):
    """Neighbourhoods of the samples of a surface that are read."""

    kind: ClassVar[str]

    @property
    @abstractmethod
    def scales(self) -> list[Scale]:
        """The cells of all scales, and of the next one, which shows where the last one is even."""

    @property
    @abstractmethod
    def tiles(self) -> Int64s:
        """The neighbourhood of each sample that is read."""

    @abstractmethod
    def chosen_of(self, planes: Float32s) -> Float32s:
        """Return the samples that are read, shape (N, n)."""

    @abstractmethod
    def energies_for_order(self, samples: Samples) -> Float32s:
        """Return the energy of the finest details of each channel, by which channels are sorted."""

    @abstractmethod
    def described(self, samples: Samples) -> list[Array]:
        """Return features of each neighbourhood, shape (P,), that only this kind of neighbourhood has."""

    @abstractmethod
    def described_cells(self, samples: Samples, number: int) -> tuple[Float32s, Float32s, Float32s | None]:
        """Return what only this kind of neighbourhood has of a scale: `fourth`, `others` and `residuals` of `Cells`."""

    @abstractmethod
    def over_samples(self, variances: Float64s) -> Float32s:
        """Return the variance at each sample relative to its mean, a stack of one channel, by neighbourhood."""

    @property
    @abstractmethod
    def centres(self) -> Float64s:
        """Where the neighbourhoods are, shape (P, D)."""

    def nearest(self, places: Float64s, count: int = 1) -> Int64s:
        """Return the neighbourhoods nearest to places, shape (S, count)."""
        from scipy.spatial import cKDTree  # slow to import

        return np.asarray(cKDTree(self.centres).query(places, k=np.arange(1, count + 1))[1], np.int64)

    def medians_around(self, values: Float64s) -> Float64s:
        """Return the median of values of neighbourhoods over each and those around."""
        # As they are few, there is no need for the tree of `nearest`.
        squares = np.square(self.centres[:, None] - self.centres).sum(axis=2)
        around = np.argsort(squares, axis=1, kind="stable")[:, :_AROUND]
        return np.median(values[around], axis=1)

    @cached_property
    def counts(self) -> Int64s:
        """The samples in each neighbourhood."""
        return np.bincount(self.tiles).astype(np.int64)

    @property
    def count(self) -> int:
        """How many neighbourhoods there are."""
        return len(self.counts)

    def means(self, rows: Array) -> Float32s:
        """Return the means of rows of samples over each neighbourhood."""
        return np.stack([np.bincount(self.tiles, own) / self.counts for own in rows]).astype(np.float32)

    def cut(self, planes: Float32s, order: Int64s | None = None) -> Samples:
        """Return the samples of three channels that are read."""
        samples = Samples(self, self.chosen_of(planes) * STEPS, np.arange(3))
        if order is None:
            order = order_of(self.energies_for_order(samples))
        return Samples(self, samples.colours[order], order)


@dataclass(frozen=True)
class Samples:
    """Three channels in P neighbourhoods, in the order of the energy of their finest details."""

    where: Neighbourhoods
    colours: Float32s  # shape (3, n), in steps of 8 bits
    order: Int64s  # the channels as they were given, in the order that they have here

    def with_colours(self, colours: Float32s) -> Samples:
        return dataclasses.replace(self, colours=colours)

    @property
    def is_cut_off(self) -> Bools:
        """Which samples are at a limit of the colours."""
        return (self.colours <= 0) | (self.colours >= STEPS)

    def cut_off(self) -> Float32s:
        """Return the share of the samples at a limit in each neighbourhood, of the worst channel, shape (P,)."""
        shares: Float32s = self.where.means(self.is_cut_off).max(axis=0)
        return shares

    @cached_property
    def levels(self) -> Float32s:
        """The mean levels of each neighbourhood, in steps of 8 bits, shape (3, P)."""
        return self.where.means(self.colours)

    def described(self) -> Float32s:
        """Return features of each neighbourhood that do not depend on the scale, shape (P, F)."""
        variance = self.where.means(np.square(self.colours - self.levels[:, self.where.tiles]))
        low, high = self.where.means(self.colours <= 0), self.where.means(self.colours >= STEPS)
        rows = [*self.levels / 64, *low, *high, *log_deviation(variance), *self.where.described(self)]
        return np.stack(rows, axis=1).astype(np.float32)

    @cached_property
    def _means(self) -> list[Float64s]:
        """The means of the parts of each scale by channel, shape (3, n)."""
        found = [self.colours.astype(np.float64)]
        for scale in self.where.scales:
            found.append(np.stack([scale.means(own) for own in found[-1]]))
        return found

    def components(self, number: int) -> Float64s:
        """Return the means of the components of the parts of a scale, shape (3, n)."""
        return in_components(self._means[number])

    def details(self, number: int) -> Float64s:
        """Return the details of the components of the parts of a scale, shape (3, n)."""
        scale, fine, coarse = self.where.scales[number], *self._means[number : number + 2]
        # By channel first: differences of equal colours are exactly 0.
        return in_components((fine - coarse[:, scale.parents]) * np.sqrt(scale.counts))

    @cached_property
    def _products(self) -> list[Float64s]:
        """The mean products of components in each cell, shape (6, cells)."""
        found = []
        for number, scale in enumerate(self.where.scales):
            own = self.details(number)
            sums = np.stack([scale.sums(own[k] * own[m]) for k, m in PAIRS])
            found.append(sums * scale.is_whole / np.maximum(scale.freedom, 1))
        return found

    def products(self) -> list[Float32s]:
        """Return the mean products of the components' details in each cell, at each scale."""
        pairs = zip(self.where.scales[:SCALES], self._products, strict=False)
        return [scale.padded(own) for scale, own in pairs]

    def products_of(self, number: int) -> Float64s:
        """Return the mean products of the components' details in each cell of a scale, shape (6, cells)."""
        return self._products[number]

    def cells(self) -> list[Cells]:
        """Return the details at each scale."""
        scales, found = self.where.scales, []
        cut_off = self.is_cut_off.mean(axis=0, dtype=np.float64)
        for number, (scale, above) in enumerate(pairwise(scales)):
            cut_off = scale.means(cut_off)
            products, is_grid = self._products[number], self.where.kind == "grid"
            energies = np.stack([above.sums(scale.freedom * own) for own in products[:3]])
            blocks = energies / np.maximum(above.sums(scale.freedom), 1)
            around = np.zeros(len(cut_off)) if is_grid else above.means(cut_off)[above.parents]
            fourth, others, residuals = self.where.described_cells(self, number)
            found.append(
                Cells(
                    scale.padded(products),
                    scale.padded(scale.freedom),
                    above.padded(np.where(above.is_whole, blocks, np.inf), np.inf),
                    scale.padded(self._unevenness(number), np.inf),
                    scale.padded(around),
                    fourth,
                    others,
                    residuals,
                    is_grid=is_grid,
                )
            )
        return found

    def _unevenness(self, number: int) -> Float64s:
        """Return the energy of the next two scales around each cell of a scale; infinite: not known."""
        scales = self.where.scales
        member = np.arange(len(scales[number].tile))
        total = np.where(scales[number + 1].is_whole[scales[number + 1].parents], 0, np.inf)
        for coarse in range(number + 1, min(number + 3, SCALES + 1)):
            member = scales[coarse].parents[member]
            total += 3 * self._products[coarse][:3].sum(axis=0)[member]
        return total

    def blocks(self) -> Blocks:
        """Return the whole cells of the second scale."""
        fine, coarse, *above = self.where.scales[:4]
        channels = [variances_of_channels(own.T.astype(np.float32)).T for own in self._products[:4]]
        energy = channels[1] * coarse.freedom
        energy += np.stack([coarse.sums(fine.freedom * own) for own in channels[0]])
        freedom = coarse.freedom + coarse.sums(fine.freedom)
        parents = above[0].parents
        around = (channels[2][:, parents] + channels[3][:, above[1].parents[parents]]) / 2
        used = coarse.is_whole & (freedom > 2)
        parts = self._means[2] / STEPS, energy / np.maximum(freedom, 1), around
        return Blocks(*(own[:, used].astype(np.float32) for own in parts))


def in_components(channels: Float64s) -> Float64s:
    """Transform channels, the first axis, to components."""
    return np.asarray(np.einsum("kc,c...->k...", COMPONENTS.astype(np.float64), channels), np.float64)
