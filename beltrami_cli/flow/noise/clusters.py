"""Neighbourhoods of meshes and point clouds: clusters of about 400 vertices, the fifth level of `vertex_graph`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import islice, pairwise
from typing import ClassVar

import numpy as np

from beltrami_cli._native import pilot_of_graph
from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int64s
from beltrami_cli.flow.noise.cells import KindStatistics
from beltrami_cli.flow.noise.components import PAIRS, SCALES, in_components
from beltrami_cli.flow.noise.even_cells import EvenCells, EvenScale
from beltrami_cli.flow.noise.neighbourhoods import (
    MIN_SAMPLES,
    Neighbourhoods,
    Scale,
    ThreeChannels,
    ranks_within,
)
from beltrami_cli.flow.vertex_graph import Graph, Level, levels_of

# Maximum number of blocks of consecutive samples that are read from a large surface, and samples per block.
_MAX_BLOCKS, _BLOCK = 16, 4096

# A neighbourhood has at least `_ENOUGH` samples, or half as many as the largest one if that is less, but never fewer
# than `_LEAST`.
_ENOUGH, _LEAST = 64, 16

# Number of scales whose residuals, which are free of slopes, are features. At coarser scales slopes are not larger than
# other details.
_SCALES_OF_RESIDUALS = 2

# Width in sample spacings over which variances of adjacent neighbourhoods are blended. Neighbourhoods are about twenty
# spacings wide.
_SPREAD = 4.0

# Minimum number of neighbours of a part whose residual is used. Parts with fewer lie at a border, and the mean of their
# neighbours is on one side of them.
_NEIGHBOURS = 3


@dataclass(frozen=True)
class ClusterScale(Scale):
    """A scale whose cells are clusters of parts."""

    parents: Int64s  # the cell of each part
    of_cells: Int64s  # the neighbourhood of each cell
    slot: Int64s  # the number of each cell within its neighbourhood
    edges: Int64s  # pairs of neighbouring parts, shape (E, 2)

    @cached_property
    def _samples(self) -> Float64s:
        """Number of samples in each cell, at least 1."""
        return np.maximum(self.sums(self.counts), 1)

    def sums(self, values: Array) -> Float64s:
        if values.ndim > 1:
            return np.stack([self.sums(own) for own in values])
        return np.bincount(self.parents, values, len(self.of_cells)).astype(np.float64, copy=False)

    def means(self, values: Array) -> Float64s:
        return self.sums(self.counts * values) / self._samples

    def spread(self, values: Array) -> Array:
        return values[..., self.parents]

    def details(self, fine: Array, coarse: Array) -> Array:
        return (fine - self.spread(coarse)) * np.sqrt(self.counts)

    def sums_of_details(self, values: Array) -> Float64s:
        return self.sums(values)

    def padded(self, values: Array, empty: float = 0.0) -> Float32s:
        shape = int(self.of_cells.max(initial=-1)) + 1, int(self.slot.max(initial=0)) + 1
        table = np.full((*values.shape[:-1], *shape), empty, np.float32)
        table[..., self.of_cells, self.slot] = values
        return table

    @cached_property
    def across(self) -> tuple[Int64s, Int64s, Int64s]:
        """Pairs of neighbouring parts in different cells, in both orders, and the neighbourhood of the first part."""
        one, other = self.edges[np.diff(self.parents[self.edges], axis=1)[:, 0] != 0].T
        ends = np.concatenate([one, other])
        return ends, np.concatenate([other, one]), self.of_cells[self.parents[ends]]

    @cached_property
    def degree(self) -> Int64s:
        """Number of neighbours of each part."""
        return np.bincount(self.edges.ravel(), minlength=len(self.parents)).astype(np.int64)

    @cached_property
    def deviations_of_residuals(self) -> Float64s:
        """Standard deviation of independent noise in the difference of each part from the mean of its neighbours."""
        around = self.sums_around(1 / self.counts) / np.maximum(self.degree, 1) ** 2
        return np.asarray(np.sqrt(1 / self.counts + around), np.float64)

    def sums_around(self, values: Float64s) -> Float64s:
        """Return the sums of values over the neighbours of each part."""
        (one, other), count = self.edges.T, len(values)
        return np.asarray(np.bincount(one, values[other], count) + np.bincount(other, values[one], count))


@dataclass(frozen=True, eq=False)
class VertexClusters(Neighbourhoods):
    """Clusters of samples joined by edges."""

    kind: ClassVar[str] = "cluster"

    scales: list[ClusterScale]
    graph: Graph
    chosen: Int64s  # indices of the samples that are read, ascending

    @classmethod
    def of(cls, graph: Graph) -> VertexClusters:
        """Choose the large neighbourhoods.

        Consecutive samples must be close to each other, since a large surface is read in blocks of these.
        """
        candidates, part = _some_samples(graph)
        levels = list(islice(levels_of(part), SCALES + 2))
        large = _large_ones(levels[-1].counts)
        parts = [_PartOfLevel(level, large[levels[-1].members[level.centres]]) for level in levels]
        chosen, of_samples = candidates[parts[0].is_read], parts[0].neighbourhoods_read
        sums = [np.bincount(of_samples, own) for own in graph.positions[chosen].T]
        centres = np.stack(sums, axis=1) / np.bincount(of_samples)[:, None]
        scales = [_scale_between(fine, coarse) for fine, coarse in pairwise(parts)]
        return cls(scales, of_samples, centres, graph, chosen)

    def sampled(self, planes: Float32s) -> Float32s:
        return planes[:, self.chosen]

    def channel_energies(self, channels: ThreeChannels) -> Float32s:
        finest = self.scales[0]
        means = np.stack([finest.means(own)[finest.parents] for own in channels.colours])
        return np.asarray(np.abs(channels.colours - means).sum(axis=1), np.float32)

    def features(self, channels: ThreeChannels) -> list[Array]:
        """Return features of the number of samples, and of the number of neighbours per sample."""
        degree = np.bincount(self.graph.edges.ravel(), minlength=self.graph.size)[self.chosen]
        return [np.log2(self.counts) / 4, self.means(degree[None])[0] / 4]

    def even_features(self, even: EvenScale) -> list[Array]:
        def of_cells(cells: EvenCells) -> list[Array]:
            return [*cells.noise, cells.scatter, cells.surroundings, *cells.noise_of_residuals]

        return [even.count, even.usable_share, *even.by_share(of_cells), *even.energies_of_blocks]

    def statistics(self, channels: ThreeChannels, number: int) -> KindStatistics:
        return KindStatistics(
            mean_squares=self._mean_squares(channels, number),
            others=self._correlations(self.scales[number], channels.details[number]),
            clipped=self._clipped_around(channels, number),
            residuals=self._residuals(channels, number) if number < _SCALES_OF_RESIDUALS else None,
        )

    def _clipped_around(self, channels: ThreeChannels, number: int) -> Float32s:
        """Return the share of clipped samples in the cell of the next scale around each cell."""
        *below, scale, above = self.scales[: number + 2]
        clipped = channels.is_clipped.mean(axis=0, dtype=np.float64)
        for each in (*below, scale, above):
            clipped = each.means(clipped)
        return scale.padded(above.spread(clipped))

    def _mean_squares(self, channels: ThreeChannels, number: int) -> Float32s:
        """Return the mean squares of the energies of cells in each neighbourhood, by component, shape (P, 3)."""
        scale, energies = self.scales[number], channels.products[number][:3]
        used = scale.freedom > 0
        sums = [np.bincount(scale.of_cells[used], own[used] ** 2, self.count) for own in energies]
        cells = np.maximum(np.bincount(scale.of_cells[used], minlength=self.count), 1)
        return (np.stack(sums, axis=1) / cells[:, None]).astype(np.float32)

    def _correlations(self, scale: ClusterScale, details: Float64s) -> Float32s:
        """Return the correlation of neighbouring details in each neighbourhood, by component, shape (P, 3)."""
        one, other, of_one = scale.across
        columns = []
        for values in details:
            both = np.bincount(of_one, values[one] * values[other], self.count)
            energy = np.bincount(of_one, values[one] ** 2 + values[other] ** 2, self.count) / 2
            columns.append(both / np.maximum(energy, 1e-9))
        return np.stack(columns, axis=1).astype(np.float32)

    def _residuals(self, channels: ThreeChannels, number: int) -> Float32s:
        """Return the mean products of the residuals in each cell, or of the details where there are no residuals."""
        scale, values = self.scales[number], in_components(channels.means[number].astype(np.float64))
        inside = scale.degree >= _NEIGHBOURS
        differences = [own - scale.sums_around(own) / np.maximum(scale.degree, 1) for own in values]
        residuals = np.stack(differences)[:, inside] / scale.deviations_of_residuals[inside]
        parents, cells = scale.parents[inside], len(scale.of_cells)
        sums = np.stack([np.bincount(parents, residuals[k] * residuals[m], cells) for k, m in PAIRS])
        count = np.bincount(parents, minlength=cells)
        products = channels.products[number]
        return scale.padded(np.where(count > 0, sums / np.maximum(count, 1), products))

    def pilot(self, colours: Float32s, variances: Float32s) -> Float32s:
        return pilot_of_graph(colours, self.scales[0].edges, variances)

    def product_of_neighbours(self, values: Float32s) -> float:
        one, other = self.scales[0].edges.T
        products = [float(np.einsum("e,e->", plane[one], plane[other])) for plane in values]
        return sum(products) / max(1, len(values) * len(one))

    def over_samples(self, variances: Float64s, parts: Float64s) -> Float32s:
        whole = variances[self.nearest(self.graph.positions)].astype(np.float32)
        for scale in reversed(self.scales[:-1]):
            parts = scale.spread(parts)
        whole[self.chosen] = np.where(np.isnan(parts), whole[self.chosen], parts)
        blended = self.graph.smoothed(whole[:, None], _SPREAD**2)
        return np.asarray(blended / blended.mean(dtype=np.float64), np.float32)


@dataclass(frozen=True)
class _PartOfLevel:
    """A level, and the neighbourhood of each of its clusters; -1: it is not read."""

    level: Level
    neighbourhoods: Int64s

    @property
    def is_read(self) -> Bools:
        return self.neighbourhoods >= 0

    @property
    def neighbourhoods_read(self) -> Int64s:
        return self.neighbourhoods[self.is_read]

    @cached_property
    def numbers(self) -> Int64s:
        """Consecutive numbers of the clusters that are read; -1: not read."""
        return _numbered(self.is_read)


def _scale_between(fine: _PartOfLevel, coarse: _PartOfLevel) -> ClusterScale:
    """Return the scale whose parts are the clusters of a level, and whose cells are those of the next one."""
    of_cells = coarse.neighbourhoods_read
    parents = coarse.numbers[coarse.level.members[fine.level.centres]][fine.is_read]
    edges = fine.numbers[fine.level.graph.edges]
    return ClusterScale(
        counts=fine.level.counts[fine.is_read].astype(np.float64),
        freedom=(np.bincount(parents, minlength=len(of_cells)) - 1).astype(np.float64),
        is_whole=np.ones(len(of_cells), bool),
        parents=parents,
        of_cells=of_cells,
        slot=ranks_within(of_cells, np.argsort(of_cells, kind="stable")),
        edges=edges[(edges >= 0).all(axis=1)],
    )


def _some_samples(graph: Graph) -> tuple[Int64s, Graph]:
    """Choose evenly spread blocks of samples and the edges among these; a small surface is kept whole."""
    if graph.size <= _BLOCK * _MAX_BLOCKS:
        return np.arange(graph.size), graph
    first = np.linspace(0, graph.size - _BLOCK, _MAX_BLOCKS).astype(np.int64)
    chosen = (first[:, None] + np.arange(_BLOCK)).ravel()
    is_chosen: Bools = np.zeros(graph.size, bool)
    is_chosen[chosen] = True
    rank = np.cumsum(is_chosen, dtype=np.int32) - 1
    edges = rank[graph.edges[is_chosen[graph.edges].all(axis=1)]]
    return chosen, Graph(graph.positions[chosen], edges, graph.priorities[chosen])


def _large_ones(counts: Float32s) -> Int64s:
    """Assign consecutive numbers to the clusters with enough samples, and -1 to others."""
    is_large = counts >= max(_LEAST, min(_ENOUGH, counts.max(initial=0) / 2))
    return _numbered(is_large & (counts[is_large].sum() >= MIN_SAMPLES))


def _numbered(mask: Bools) -> Int64s:
    return np.where(mask, np.cumsum(mask) - 1, -1)
