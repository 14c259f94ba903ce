"""The noise level of colours on a surface, from neighbouring samples.

A sample with k neighbours differs from their mean by noise of variance sigma^2 (1 + 1/k), and by what the image does
there. Noise is estimated from the neighbourhoods in which means of means are even, so that the image does little. On
more than 131,072 samples, evenly spread blocks of consecutive samples are used.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from functools import partial
from itertools import islice

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int32s, Int64s
from beltrami_cli.flow.clipping import variance_of_clipped
from beltrami_cli.flow.noise.by_level import (
    MOST_PLAIN,
    Neighbourhoods,
    are_levels,
    by_channel,
    fit_by_level,
    mixing_by,
    mixing_for,
    most_cut_off,
    stabiliser_of,
)
from beltrami_cli.flow.noise.by_place import MOST_CUT_OFF, by_mean, louder_blocks, over_samples
from beltrami_cli.flow.noise.by_scale import SCALES, FoundNoise, noise_of_scales
from beltrami_cli.flow.noise.flat_patch_noise import (
    FEWEST_SAMPLES,
    Patches,
    WhiteNoise,
    flat_patch_sigma,
    noise_or_paint,
)
from beltrami_cli.flow.vertex_graph import Graph, Level, levels_of
from beltrami_cli.surface.records import at_limits

# The bound of noise by scale is up to a tenth less than there is, on some ten thousand samples.
_SLACK = 1.12

# Samples per block, and blocks, that suffice for an estimate.
_BLOCK, _BLOCKS = 4096, 32

# Means of squared residuals over a sample, its neighbours and theirs, on white noise on a triangle mesh of degree six:
# their degrees of freedom, and their unevenness.
_FREEDOM_AROUND = 10.8
_UNEVEN_AROUND, _SPREAD_AROUND = 0.0348, 0.675

# Share of the neighbourhoods that are taken to be free of edges and texture, and how many at least. They overlap, so
# many give little more than few; and on coarse meshes there are edges nearly everywhere. On painted, baked and
# photographed textures with noise of 5 to 40 of 255, estimates hardly differ between shares of 0.05 and 0.2.
_AROUND_SHARE, _AROUND_LEAST = 0.05, 300

# Rings over which detail is averaged to rank patches.
_RINGS_OF_DETAIL = 5

# Rings over which the shares at a limit are averaged: where noise cuts off a half, some neighbourhoods lose little by
# chance.
_RINGS_OF_SHARES = 2

# Noise by level needs this many samples. Neighbourhoods with a larger share of samples at a limit, or without any
# noise, are left out.
_FEWEST_BY_LEVEL, _MOST_CUT_OFF, _PLAIN = 2_000, 0.1, 1e-9

# Noise that neighbours share needs more samples, and coarse scales need tiles: clusters of some four clusters of four,
# which hold so many independent details, and at least a few.
_FEWEST_SHARED, _FEWEST_TILES, _DETAILS, _FEWEST_DETAILS = 6_000, 30, 13, 3

# Samples of a tile and tiles of a block, for noise by place; and passes over neighbours that even out those of tiles.
_TILE, _TILES, _SPREAD = 64, 16, 8

# Of the white noise that shows how strong such is at both scales: any is as good.
_SEED = 22

_NEIGHBOURS = 3  # fewer: a border or a stray edge, whose mean leans to one side


def estimate_sigma(colours: Float32s, edges: Int32s, relative: Float32s | None = None) -> Float64s:
    """Estimate sigma of independent noise, per channel of colours, shape (S, N); 0 with too few samples.

    `relative`: see `Manifold.differing`; sigma is then the root of the mean variance.
    """
    chosen, edges = _some_samples(len(colours), edges)
    variances, colours = _variances(colours, relative)[chosen], colours[chosen]
    inside = _inside(colours, edges)
    if len(colours) < FEWEST_SAMPLES or not inside.any():
        return np.zeros(colours.shape[1])
    size = np.bincount(edges.ravel(), minlength=len(colours)) + 1
    around = np.hstack([colours == 0, colours == 1, colours]).astype(np.float32)
    around = _means_around(around, edges, size, _RINGS_OF_SHARES)
    energy, uneven, _, others = _neighbourhoods(colours, around, variances, edges, inside)
    white = WhiteNoise(_FREEDOM_AROUND, _UNEVEN_AROUND, _SPREAD_AROUND, _AROUND_SHARE, _AROUND_LEAST)
    low, high, mean = others.reshape(3, *energy.shape)
    patches = Patches(energy, uneven, low, high, mean, (energy == 0).astype(np.float64))
    sigma = flat_patch_sigma(patches, white)
    return noise_or_paint(sigma, np.ptp(colours, axis=0))


def _inside(colours: Float32s, edges: Int32s) -> Bools:
    """Return which samples have enough neighbours."""
    return np.bincount(edges.ravel(), minlength=len(colours)) >= _NEIGHBOURS


def _neighbourhoods(
    colours: Float32s, others: Array, relative: Float32s, edges: Int32s, inside: Bools
) -> tuple[Float64s, Float64s, Float64s, Float64s]:
    """Measure samples inside with their neighbours and theirs; each of the results has the shape (channels, M).

    The energy of residuals and the unevenness of coarse means, both by the `relative` variance there; these means, and
    means of other numbers.
    """
    size = np.bincount(edges.ravel(), minlength=len(colours)) + 1
    squares = np.zeros(colours.shape, np.float32)
    for own, residual in zip(squares.T, residuals(colours, edges), strict=True):
        own[inside] = residual**2
    middle = colours.mean(axis=0, dtype=np.float64)
    means = (colours - middle).astype(np.float32)  # small numbers, whose squares lose no digits
    means = _means_around(means, edges, size, 2)
    sums = np.hstack(
        [np.stack([inside, np.ones(len(inside)), relative], axis=1), squares, means**2, means, others]
    )
    sums = _means_around(sums.astype(np.float32), edges, np.ones(len(inside)), 2)
    counted, around, louder = sums[inside, :3].T.astype(np.float64)
    parts = np.split(sums[inside, 3:].T / around, np.arange(1, 4) * colours.shape[1])
    energy, even, level = parts[:3]
    louder = louder / around
    uneven = np.maximum(even - level**2, 0) / louder
    return energy * around / (counted * louder), uneven, level + middle[:, None], parts[3]


def _some_samples(count: int, edges: Int32s) -> tuple[Int64s | slice, Int32s]:
    """Choose blocks of samples, evenly spread, with the edges between them; all samples if there are no more."""
    if count <= _BLOCK * _BLOCKS:
        return slice(None), edges
    first = np.linspace(0, count - _BLOCK, _BLOCKS).astype(np.intp)
    chosen = (first[:, None] + np.arange(_BLOCK)).ravel()
    is_chosen = np.zeros(count, bool)
    is_chosen[chosen] = True
    rank = np.cumsum(is_chosen, dtype=np.int32) - 1
    return chosen, rank[edges[is_chosen[edges[:, 0]] & is_chosen[edges[:, 1]]]]


def _variances(colours: Float32s, relative: Float32s | None) -> Float32s:
    """Return the variances of samples relative to their mean, shape (S,)."""
    return np.ones(len(colours), np.float32) if relative is None else relative[:, 0]


def _and_beside(values: Float64s, edges: Int32s) -> Float64s:
    """Sum over each sample and its neighbours."""
    return np.asarray(values + _beside(values, edges), np.float64)


def _beside(values: Float64s, edges: Int32s) -> Float64s:
    """Sum over the neighbours of each sample."""
    one, other = edges[:, 0], edges[:, 1]
    count = len(values)
    total = np.bincount(one, values[other], count) + np.bincount(other, values[one], count)
    return np.asarray(total, np.float64)


def residuals(values: Float32s, edges: Int32s) -> Iterator[Float64s]:
    """Yield for each channel how samples differ from the mean of their neighbours, in units of their noise."""
    count = len(values)
    degree = np.bincount(edges.ravel(), minlength=count)
    inside = degree >= _NEIGHBOURS
    scale = np.sqrt(degree[inside] / (degree[inside] + 1.0))
    for column in values.T:
        channel = column.astype(np.float64)
        yield (channel[inside] - _beside(channel, edges)[inside] / degree[inside]) * scale


def detail_around(colours: Float32s, edges: Int32s) -> Float64s:
    """Return how uneven colours are around each sample, beyond what noise makes of them."""
    count = len(colours)
    size = np.bincount(edges.ravel(), minlength=count) + 1.0
    steps = np.zeros(len(edges))
    for values in colours.T:
        means = _and_beside(values.astype(np.float64), edges) / size
        steps += np.square(means[edges[:, 0]] - means[edges[:, 1]])
    ends = np.concatenate([edges[:, 0], edges[:, 1]])
    detail = np.asarray(np.bincount(ends, np.concatenate([steps, steps]), count), np.float64)
    for _ in range(_RINGS_OF_DETAIL):
        detail = _and_beside(detail, edges) / size
    return detail


def find_relative(colours: Float32s, edges: Int32s) -> Float32s | None:
    """Find the variance of noise relative to its mean, shape (S, 1); None if it is the same everywhere.

    Samples that follow each other must lie together.
    """
    count = len(colours) // (_TILE * _TILES)
    if not count:
        return None
    colours = colours[:, : 3 if colours.shape[1] >= 3 else 1]
    mixed = np.einsum("ki,si->sk", mixing_for(colours.shape[1]), colours)
    size = np.bincount(edges.ravel(), minlength=len(colours)) + 1
    tile = np.minimum(np.arange(len(colours)) // _TILE, count * _TILES - 1)
    tiles = _energies_by_scale(mixed, edges, size, tile)
    cut = at_limits(colours).mean(axis=1)
    share = _means(cut, tile)
    remaining = variance_of_clipped(np.minimum(share, MOST_CUT_OFF))
    tiles = np.where(share < MOST_CUT_OFF, tiles / remaining, np.float32(np.nan))
    found = louder_blocks(tiles, _means(mixed[:, 0], tile).mean(axis=1))
    if found is None:
        return None
    variances = over_samples(found[0], tiles[0].min(axis=0) / found[1])[tile][:, None]
    variances = _means_around(variances, edges, size, _SPREAD)
    return by_mean(variances, float(variances.mean(dtype=np.float64)))[0]


def _energies_by_scale(mixed: Float64s, edges: Int32s, size: Array, tile: Array) -> Float32s:
    """Return the energies of residuals of samples and of means of neighbours, shape (2, K, blocks, tiles)."""
    white = np.random.default_rng(_SEED).standard_normal(len(mixed), np.float32)
    columns = np.column_stack([mixed, white]).astype(np.float32)
    inside, energies = size > _NEIGHBOURS, []
    for _ in range(2):
        means = _means_around(columns, edges, size)
        # By the mean with the sample itself, residuals are smaller by k / (k + 1), and white noise shows by how much.
        factor = size[inside] / (size[inside] - 1.0)
        squares = np.square(columns[inside] - means[inside]) * factor[:, None]
        energies.append(
            [_means(own, tile[inside], tile[-1] + 1) for own in squares.T / squares[:, -1].mean()]
        )
        columns = means
    return np.array(energies, np.float32)[:, :-1]


def _means_around(columns: Float32s, edges: Int32s, size: Array, times: int = 1) -> Float32s:
    """Return means over each sample and its neighbours, shape (S, K), of means, and so on."""
    from beltrami_cli._native import neighbour_means

    alike, size = np.ones(len(edges), np.float32), size.astype(np.float32)
    for _ in range(times):
        columns = neighbour_means(columns, edges, alike, size)
    return columns


def _means(values: Array, tile: Array, count: int | None = None) -> Float64s:
    """Return means over tiles by their blocks; NaN where a tile holds too few samples."""
    held = np.bincount(tile, minlength=count or 0)
    means = np.bincount(tile, values, len(held)) / np.maximum(held, 1)
    return np.where(held >= _TILE // 2, means, np.nan).reshape(-1, _TILES)


def find_mesh_noise(samples: Graph, colours: Float32s, relative: Float32s | None = None) -> FoundNoise:
    """Find how noise depends on the level, if colours are levels, and what neighbours share."""
    chosen, edges = _some_samples(samples.size, samples.edges)
    part = Graph(samples.positions[chosen], edges, samples.priorities[chosen])
    variances, own = (
        _variances(colours, relative)[chosen],
        colours[chosen, : 3 if colours.shape[1] >= 3 else None],
    )
    inside = _inside(own, edges)
    if np.count_nonzero(inside) < _FEWEST_BY_LEVEL:
        return FoundNoise()
    are_enough = np.count_nonzero(inside) >= _FEWEST_SHARED
    clusters = list(islice(levels_of(part), SCALES + 2)) if are_enough else []
    mixing = _mixing_of(own, clusters)
    mixed = np.einsum("ki,si->sk", mixing, own)
    cut = at_limits(own).mean(axis=1, keepdims=True, dtype=np.float32)
    size = np.bincount(edges.ravel(), minlength=len(own)) + 1
    cut = _means_around(cut, edges, size, _RINGS_OF_SHARES)
    columns = np.column_stack([mixed, cut, variances]).astype(np.float32)
    around = _residuals(columns, mixing, edges, inside)
    found, by_level = FoundNoise(), are_levels(around)
    if are_enough:
        scales: list[Neighbourhoods] = []
        for fine, parents, tiles in zip(clusters, clusters[1:], clusters[2:], strict=False):
            if tiles.graph.size < _FEWEST_TILES:
                break
            measured = _details(columns, mixing, fine, parents, tiles)
            if not scales and measured.plain > MOST_PLAIN:
                break
            scales.append(measured)
        alone = partial(estimate_sigma, colours, samples.edges, relative)
        found = noise_of_scales(scales, mixing, colours.shape[1], alone, by_level=by_level)
        if found.covariances is not None:
            return found
        found = dataclasses.replace(found, most=_SLACK * found.most)
    # Independent noise shows better in what differs from neighbours, where slopes do not.
    fitted = fit_by_level([around], mixing) if by_level else None
    return dataclasses.replace(found, stabiliser=None if fitted is None else stabiliser_of(fitted))


def _mixing_of(colours: Float32s, clusters: list[Level]) -> Float64s:
    """Return the mixing of channels into components, by details of means of some four samples if there are enough."""
    if len(clusters) <= SCALES:
        return mixing_for(colours.shape[1])
    fine, parents = clusters[1:3]
    details = fine.means(colours) - parents.means(colours)[parents.members[fine.centres]]
    return mixing_by((details * np.sqrt(fine.counts)[:, None]).T)


def _residuals(columns: Float32s, mixing: Float64s, edges: Int32s, inside: Bools) -> Neighbourhoods:
    """Measure how samples differ from their neighbours; for columns see `_details`."""
    mixed, cut, variances = columns[:, :-2], columns[:, -2:-1], columns[:, -1]
    energy, uneven, level, cut_around = _neighbourhoods(mixed, cut, variances, edges, inside)
    used = (cut_around[0] < _MOST_CUT_OFF) & (energy.min(axis=0) > _PLAIN)
    levels = by_channel(level[:, used], mixing)
    return Neighbourhoods(energy[:, used], uneven.sum(axis=0)[used], levels, round(_FREEDOM_AROUND))


def _details(
    columns: Float32s, mixing: Float64s, fine: Level, parents: Level, tiles: Level
) -> Neighbourhoods:
    """Measure how means differ from those of their clusters, like Haar details, in clusters of these.

    Columns are components of colours; the last two: the share of channels that were cut off, and the variance of noise.
    """
    (means, around), within = (level.means(columns[:, :-2]) for level in (fine, parents)), tiles.graph.size
    parent, tile = parents.members[fine.centres], tiles.members[fine.centres]
    differences = (means - around[parent]) * np.sqrt(fine.counts)[:, None]
    details = np.hstack([np.square(differences), np.square(by_channel(differences.T, mixing)).T])
    free = np.bincount(tile, 1 - fine.counts / parents.counts[parent], within)
    level, tile_of_parent = tiles.means(columns).astype(np.float64), tiles.members[parents.centres]
    apart = np.square(around - level[tile_of_parent, :-2]).sum(axis=1) * parents.counts
    cut = level[:, -2]
    used = (free >= _FEWEST_DETAILS) & (cut < most_cut_off(cut))
    variances = (level[:, -1] * variance_of_clipped(cut))[used]
    energy = np.stack([np.bincount(tile, own, within)[used] for own in details.T]) / (free[used] * variances)
    uneven = np.bincount(tile_of_parent, apart, within)[used] / (tiles.counts[used] * variances)
    energy, channels = np.split(energy, 2)
    seen = energy.min(axis=0, initial=np.inf) > _PLAIN
    return Neighbourhoods(
        energy[:, seen],
        uneven[seen],
        by_channel(level[used][seen, :-2].T, mixing),
        _DETAILS,
        float(cut.mean()),
        by_channel=channels[:, seen],
        plain=float(np.mean(~seen)) if len(seen) else 0.0,
    )
