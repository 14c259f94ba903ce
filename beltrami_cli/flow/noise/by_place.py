"""Noise that differs from place to place: of photographs that were taken or developed differently.

In each square block of cells, or of samples of a surface that lie together, noise is the least that the mean of
channels and their differences show in the even tiles, since textures hardly reach all three. Where that is much more
than in the quietest blocks, and no more so in details of 2 x 2 means than in those of single cells, unlike texture,
there is more noise. One channel alone must show that it is noise: details of 2 x 2 means have the same energy, and so
have all tiles of a block.
"""

from __future__ import annotations

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s
from beltrami_cli.flow.clipping import variance_of_clipped
from beltrami_cli.flow.noise.by_level import OPPONENTS, mixing_for
from beltrami_cli.flow.noise.grid_scales import corners_of, sums_of_tiles
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.records import at_limits

# Cells a side of a tile, tiles a side of a block, and tiles that a block needs.
_TILE, _BLOCK, _FEWEST_TILES = 8, 4, 6

# The quantile of the energies of tiles that are even; and that of the blocks that are quiet.
_EVEN, _QUIET = 0.3, 0.1

# Noise differs if it is stronger by this factor than in quiet blocks, in at least this share of the blocks, and has
# this standard deviation; of texture, the next scale has even more, by this factor.
_LOUDER, _COUNTED, _LEAST_SIGMA, _MOST_GROWTH = 1.7, 0.1, 2.5 / 255, 1.6

# Of one channel: the energy of details of 2 x 2 means relative to that of single cells, and that of tiles which are not
# even relative to those that are, at most. On 16 photographs with noise in one half, white noise of 5 or 20, and none.
_MOST_GROWTH_ALONE, _MOST_UNEVEN, _UNEVEN = 1.3, 1.75, 0.75

# Blocks of like levels, of which the quiet ones show the noise of these levels.
_ALIKE = 8

# Where groups of blocks of like levels explain the first share of differences, and places less, or the second, noise
# depends on levels.
_GROUPS, _BY_LEVEL, _ALL_BY_LEVEL = 6, 0.5, 0.85

# Textures are uneven within blocks, and differ from block to block; noise is even, or differs from place to place. Of
# 240 pictures with even noise, of cameras or grain, four passed as uneven: these bounds refuse three of them, and none
# of some 40 with more camera noise in one half, or in every second square of a chessboard.
_UNEVEN_TILES, _PLACES = 1.5, 0.8

# Less variance than any stored colour can show.
_NOTHING = 1e-12

# Noise of quiet places that cannot be distinguished from the steps of an 8-bit file, to which nothing can be related.
_ROUNDING = 0.5 / 255

# Noise of a channel in quiet places, relative to the least of the mean of channels and their differences, at most.
_MOST_OF_QUIET = 2.0

# The least relative standard deviation: where it is estimated, and where it is given, so that all can be divided by it.
_LEAST, _LEAST_RELATIVE = 0.2, 0.05

# Share of the samples of a tile at 0 or full scale up to which what was cut off of noise is known.
MOST_CUT_OFF = 0.6


def find_relative_noise(planes: Float32s, filled: Bools) -> tuple[Float32s, float, float] | None:
    """Find the variance of noise relative to its mean, shape (R, C); None if it is the same everywhere.

    Also how much larger sigma is than in quiet places, and what it is there at most.
    """
    if min(filled.shape) < 2 * _TILE * _BLOCK:
        return None
    tiles, levels = _measure_tiles(
        planes[: len(OPPONENTS)] if len(planes) >= len(OPPONENTS) else planes[:1], filled
    )
    found = louder_blocks(_grouped(tiles), levels)
    if found is None:
        return None
    fine, quiet = found
    return *_over_cells(fine, tiles[0].min(axis=0) / quiet, filled), _MOST_OF_QUIET * quiet**0.5


def louder_blocks(tiles: Float32s, levels: Float32s) -> tuple[Float32s, float] | None:
    """Find the variance of noise in blocks relative to quiet ones, NaN: not known, and that in these; or None.

    `tiles`: their energies by scale, component, block and tile, NaN where they are not known; `levels`: of blocks.
    """
    blocks = _quantiles(tiles, _EVEN).min(axis=1)
    known = ~np.isnan(blocks).any(axis=0)
    if np.count_nonzero(known) < 1 / _QUIET:
        return None
    quiet = np.quantile(blocks[:, known], _QUIET, axis=1).astype(np.float32)
    if quiet.min() < _ROUNDING**2:
        return None
    fine, coarse = (own / least for own, least in zip(blocks, quiet, strict=True))
    expected = _quiet_by_level(fine, levels, known)
    louder = known & (fine > np.maximum(_LOUDER**2 * expected, _LEAST_SIGMA**2 / quiet[0]))
    if np.count_nonzero(louder) < max(1, _COUNTED * np.count_nonzero(known)):
        return None
    if np.median(coarse[louder] / fine[louder]) > _MOST_GROWTH:
        return None
    if tiles.shape[1] == 1 and not _is_noise_alone(tiles[:, 0, louder]):
        return None
    logs = np.log(np.maximum(fine, _NOTHING))
    by_level, by_place = _explained_by_level(logs[known], levels[known]), _explained_by_place(logs)
    if by_level > _BY_LEVEL and by_level > min(_ALL_BY_LEVEL, by_place):
        return None
    if by_place < _PLACES and _unevenness(tiles[:, :, louder]) > _UNEVEN_TILES:
        return None
    return np.where(known, fine, np.float32(np.nan)), float(quiet[0])


def over_samples(blocks: Float32s, tiles: Float32s) -> Float32s:
    """Return the variances of tiles in their order, shape (B * T,), within those of the blocks beside theirs."""
    known = np.flatnonzero(~np.isnan(blocks))
    padded = np.pad(np.interp(np.arange(len(blocks)), known, blocks[known]), 1, mode="edge")
    beside = np.stack([padded[:-2], padded[1:-1], padded[2:]])
    values = np.where(np.isnan(tiles), beside[1][:, None], tiles)
    return (
        np.clip(values, beside.min(axis=0)[:, None], beside.max(axis=0)[:, None]).astype(np.float32).ravel()
    )


def relative_to_mean(deviations: Float32s) -> tuple[Float32s, Float64s]:
    """Return variances relative to their mean, shape (S, 1), and sigma by channel, of deviations of shape (S, K)."""
    variances = np.square(deviations, dtype=np.float64)
    sigma = np.sqrt(variances.mean(axis=0))
    mean = np.mean(np.square(sigma))
    if not mean > 0:
        return np.ones((len(deviations), 1), np.float32), sigma
    relative = np.maximum(variances.mean(axis=1, keepdims=True) / mean, _LEAST_RELATIVE**2)
    return relative.astype(np.float32), sigma


def _is_noise_alone(tiles: Float32s) -> bool:
    """Whether one channel shows noise and no texture, by the energies of its tiles by scale and block."""
    even = _quantiles(tiles, _EVEN)
    is_flat = np.median(even[1] / even[0]) < _MOST_GROWTH_ALONE
    return bool(is_flat and _unevenness(tiles[:, None]) < _MOST_UNEVEN)


def _unevenness(tiles: Float32s) -> float:
    """Return how far the energies of single cells differ within blocks, in the most even component."""
    even, uneven = (_quantiles(tiles[0], share) for share in (_EVEN, _UNEVEN))
    return float(np.median((uneven / even).min(axis=0)))


def _quiet_by_level(values: Float32s, levels: Float32s, known: Bools) -> Float64s:
    """Return the values of quiet blocks, at the level of each block; at least 1, as of the quiet ones of all levels."""
    order = np.argsort(levels[known], kind="stable")
    # Of groups of one size at a time: one by one, they would take as long as all else here.
    size, longer = divmod(len(order), max(1, len(order) // _ALIKE))
    first = longer * (size + 1)
    groups = [order[:first].reshape(-1, size + 1), order[first:].reshape(-1, size)]
    quiet = [np.quantile(values[known][group], _QUIET, axis=1) for group in groups if len(group)]
    at = [levels[known][group].mean(axis=1) for group in groups if len(group)]
    found: Float64s = np.interp(levels, np.concatenate(at), np.concatenate(quiet))
    return np.maximum(found, 1)


def _explained_by_level(values: Float32s, levels: Float32s) -> float:
    """Return which share of the variance of values is that between groups of like levels."""
    groups = np.array_split(values[np.argsort(levels, kind="stable")], _GROUPS)
    within = sum(float(np.square(group - group.mean()).sum()) for group in groups)
    return 1 - within / max(float(np.square(values - values.mean()).sum()), _NOTHING)


def _explained_by_place(values: Float32s) -> float:
    """Return which share of the variance of values blocks share with those beside them."""
    steps = np.concatenate([np.diff(values, axis=axis).ravel() for axis in range(values.ndim)])
    # Between independent values, the variance of steps is twice theirs.
    return 1 - float(np.nanmean(np.square(steps))) / max(2 * float(np.nanvar(values)), _NOTHING)


def _measure_tiles(planes: Float32s, filled: Bools) -> tuple[Float32s, Float32s]:
    """Return the energies of tiles by scale and component, shape (2, K, T, U), and of blocks the levels."""
    side = _TILE * _BLOCK
    rows, columns = (-(-size // side) for size in filled.shape)
    energies = np.full((2, len(planes), rows * _BLOCK, columns * _BLOCK), np.nan, np.float32)
    levels = np.zeros((rows, columns), np.float32)
    for band in large_arrays.blocks(filled.shape[0], side):
        whole = np.zeros((len(planes), side, columns * side), np.float32)
        there = np.zeros(whole.shape[1:], bool)
        whole[:, : len(filled[band]), : filled.shape[1]] = planes[:, band]
        there[: len(filled[band]), : filled.shape[1]] = filled[band]
        cut = at_limits(whole).mean(axis=0, dtype=np.float32)
        usable = sums_of_tiles(there, _TILE) == _TILE**2
        share = sums_of_tiles(cut, _TILE) / _TILE**2
        usable &= share < MOST_CUT_OFF
        first = band.start // _TILE
        means = np.einsum("ij,jrc->irc", mixing_for(len(whole)).astype(np.float32), whole)
        levels[band.start // side] = sums_of_tiles(means[0], side) / np.maximum(sums_of_tiles(there, side), 1)
        for scale, own in enumerate(energies[:, :, first : first + _BLOCK]):
            four = corners_of(means)
            means = four.mean(axis=0)
            details = 4**scale * np.square(four - means).sum(axis=0) / 3
            squares = _TILE >> (scale + 1)
            for energy, plane in zip(own, details, strict=True):
                remaining = squares**2 * variance_of_clipped(share[usable])
                energy[usable] = sums_of_tiles(plane, squares)[usable] / remaining
    return energies, levels


def _grouped(tiles: Float32s) -> Float32s:
    """Return tiles of a grid by their blocks."""
    *shape, rows, columns = tiles.shape
    grouped = tiles.reshape(*shape, rows // _BLOCK, _BLOCK, columns // _BLOCK, _BLOCK).swapaxes(-3, -2)
    return grouped.reshape(*shape, rows // _BLOCK, columns // _BLOCK, _BLOCK**2)


def _quantiles(tiles: Float32s, share: float) -> Float32s:
    """Return a quantile of the energies of the tiles of each block; NaN with too few of them."""
    ordered = np.sort(tiles, axis=-1)  # NaN last
    usable = np.count_nonzero(~np.isnan(ordered), axis=-1, keepdims=True)
    at = (share * (usable - 1)).clip(0).astype(np.intp)
    found: Float32s = np.take_along_axis(ordered, at, axis=-1)[..., 0]
    found[usable[..., 0] < _FEWEST_TILES] = np.nan
    return found


def _over_cells(blocks: Float32s, tiles: Float32s, filled: Bools) -> tuple[Float32s, float]:
    """Spread variances over cells: within those of the blocks around, tiles say where they change."""
    from scipy.ndimage import maximum_filter, median_filter, minimum_filter  # which take long to be imported

    blocks = _filled_up(blocks)
    least, most = (
        np.repeat(np.repeat(of(blocks, 3, mode="nearest"), _BLOCK, 0), _BLOCK, 1)
        for of in (minimum_filter, maximum_filter)
    )
    variances = median_filter(np.clip(_filled_up(tiles), least, most), 3, mode="nearest")
    result: Float32s = large_arrays.empty(filled.shape, np.float32)
    total, along = 0.0, np.arange(filled.shape[1]) // _TILE
    for rows in large_arrays.blocks(len(filled), _TILE * _BLOCK):
        down = np.arange(*rows.indices(len(filled))) // _TILE
        result[rows] = variances[down[:, None], along]
        total += float(result[rows].sum(where=filled[rows], dtype=np.float64))
    return by_mean(result, total / np.count_nonzero(filled))


def by_mean(variances: Float32s, mean: float) -> tuple[Float32s, float]:
    """Return variances relative to their mean, in place, and the root of this."""
    variances /= np.float32(mean)
    np.maximum(variances, np.float32(_LEAST**2), out=variances)
    return variances, mean**0.5


def _filled_up(values: Float32s) -> Float32s:
    """Return values, those that are NaN replaced by the nearest."""
    from scipy.ndimage import distance_transform_edt

    nearest = distance_transform_edt(np.isnan(values), return_distances=False, return_indices=True)
    nearby: Float32s = values[tuple(nearest)]
    return nearby
