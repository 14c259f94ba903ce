"""The noise level of colours on a surface, from neighbouring samples.

A sample with k neighbours differs from their mean by noise of variance sigma^2 (1 + 1/k), and by what the image does
there. Noise is estimated from the neighbourhoods in which means of means are even, so that the image does little. On
more than 131,072 samples, evenly spread blocks of consecutive samples are used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.noise.by_level import Neighbourhoods, fit_by_level, mixing_for, stabiliser_of
from beltrami_cli.flow.noise.flat_patch_noise import Patches, WhiteNoise, flat_patch_sigma

if TYPE_CHECKING:
    from collections.abc import Iterator

    from beltrami_cli.arrays import Array, Float32s, Float64s, Int32s
    from beltrami_cli.flow.noise.stabilising import VarianceStabiliser


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

# Noise by level needs this many samples. Neighbourhoods with a larger share of samples at a limit, or without any
# noise, are left out.
_FEWEST_BY_LEVEL, _MOST_CUT_OFF, _PLAIN = 2_000, 0.1, 1e-9

_NEIGHBOURS = 3  # fewer: a border or a stray edge, whose mean leans to one side


def estimate_sigma(colours: Float32s, edges: Int32s) -> Float64s:
    """Estimate sigma of independent noise, per channel of colours, shape (S, N); 0 without neighbours."""
    colours, edges = _some_samples(colours, edges)
    count = len(colours)
    degree = np.bincount(edges.ravel(), minlength=count)
    inside = degree >= _NEIGHBOURS
    if not inside.any():
        return np.zeros(colours.shape[1])
    inner_count = _around(inside.astype(np.float64), edges)[inside]
    size = _around(np.ones(count), edges)[inside]
    found = []
    for values, residual in zip(colours.T.astype(np.float64), residuals(colours, edges), strict=True):
        squares = np.zeros(count)
        squares[inside] = residual**2
        means = values - values.mean()  # small numbers, whose squares lose no digits
        for _ in range(2):
            means = _and_beside(means, edges) / (degree + 1)
        even, level = (_around(part, edges)[inside] / size for part in (means**2, means))
        low, high, mean = (_around(part, edges)[inside] / size for part in (values <= 0, values >= 1, values))
        energy = _around(squares, edges)[inside] / inner_count
        found.append((energy, np.maximum(even - level**2, 0), low, high, mean))
    white = WhiteNoise(_FREEDOM_AROUND, _UNEVEN_AROUND, _SPREAD_AROUND, _AROUND_SHARE, _AROUND_LEAST)
    return flat_patch_sigma(Patches(*np.array(found).swapaxes(0, 1)), white)


def _some_samples(colours: Float32s, edges: Int32s) -> tuple[Float32s, Int32s]:
    """Choose blocks of samples, evenly spread, with the edges between them; all samples if there are no more."""
    if len(colours) <= _BLOCK * _BLOCKS:
        return colours, edges
    first = np.linspace(0, len(colours) - _BLOCK, _BLOCKS).astype(np.intp)
    chosen = (first[:, None] + np.arange(_BLOCK)).ravel()
    is_chosen = np.zeros(len(colours), bool)
    is_chosen[chosen] = True
    rank = np.cumsum(is_chosen, dtype=np.int32) - 1
    return colours[chosen], rank[edges[is_chosen[edges[:, 0]] & is_chosen[edges[:, 1]]]]


def _around(values: Array, edges: Int32s) -> Float64s:
    """Sum over each sample and its neighbours, and over these and their neighbours again."""
    if not values.any():
        return np.zeros(len(values))
    return _and_beside(_and_beside(values.astype(np.float64), edges), edges)


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


def find_stabiliser(colours: Float32s, edges: Int32s) -> VarianceStabiliser | None:
    """Find what makes noise the same at all levels; None if it is, or if numbers below 0 are no levels."""
    colours, edges = _some_samples(colours[:, :3] if colours.shape[1] >= 3 else colours, edges)
    degree = np.bincount(edges.ravel(), minlength=len(colours))
    inside = degree >= _NEIGHBOURS
    if np.count_nonzero(inside) < _FEWEST_BY_LEVEL or colours.min() < 0:
        return None
    mixing = mixing_for(colours.shape[1])
    mixed = np.einsum("ki,si->sk", mixing, colours)
    size = _around(np.ones(len(colours)), edges)[inside]
    residual = np.zeros((len(colours), len(mixing)))
    for squares, own in zip(residual.T, residuals(mixed.astype(np.float32), edges), strict=True):
        squares[inside] = own**2
    count = _around(inside.astype(np.float64), edges)[inside]
    energy = np.stack([_around(squares, edges)[inside] / count for squares in residual.T])
    means = mixed.astype(np.float64)
    for _ in range(2):
        means = np.stack([_and_beside(own, edges) for own in means.T], axis=1) / (degree + 1)[:, None]
    around = [np.stack([_around(own, edges)[inside] / size for own in of.T]) for of in (means**2, means)]
    uneven, level = np.sum(around[0] - around[1] ** 2, axis=0), around[1][0] / np.sqrt(len(mixing))
    cut = _around(((colours <= 0) | (colours >= 1)).mean(axis=1), edges)[inside] / size
    used = (cut < _MOST_CUT_OFF) & (energy.min(axis=0) > _PLAIN)
    even = Neighbourhoods(energy[:, used], uneven[used], level[used], round(_FREEDOM_AROUND))
    found = fit_by_level([even])
    return None if found is None else stabiliser_of(found)
