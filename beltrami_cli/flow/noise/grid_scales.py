"""The noise of colours on a grid, by level and by scale.

Details of 2 x 2 cells, of 2 x 2 means of such, and so on, are measured in tiles, see `by_level` and `by_scale`. Squares
begin at even texels of a chart or an image, as those in which JPEG stores hues do.

Independent noise alone is estimated from the diagonal Haar coefficients (a - b - c + d) / 2 of all 2 x 2 squares, which
keep the noise and lose constants and slopes [1]_, in the tiles of 8 x 8 squares in which means of squares are even. On
more than 200,000 filled cells, evenly spread bands of rows are used.

References
----------
.. [1] D. Donoho, I. Johnstone, "Ideal spatial adaptation by wavelet shrinkage", Biometrika 81 (1994),
   doi:10.1093/biomet/81.3.425
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Bools, Float32s, Float64s
from beltrami_cli.flow.clipping import variance_of_clipped
from beltrami_cli.flow.noise.by_level import (
    MOST_PLAIN,
    Neighbourhoods,
    are_levels,
    by_channel,
    mixing_by,
    most_cut_off,
)
from beltrami_cli.flow.noise.by_scale import SCALE_OF_CHANNELS, FoundNoise, noise_of_scales
from beltrami_cli.flow.noise.flat_patch_noise import (
    FEWEST_SAMPLES,
    MOST_EQUAL,
    Patches,
    WhiteNoise,
    flat_patch_sigma,
    noise_or_paint,
)
from beltrami_cli.flow.noise.upper_bound import most_noise
from beltrami_cli.surface.records import at_limits

# Squares per side of a tile, scale by scale: there are few of the coarse ones.
_TILES = (4, 4, 2, 2)

# Tiles without any detail are left out.
_PLAIN = 1e-9

# Where fewer than this share of the coarsest tiles are left, as around what lies on white, nearly all of them hold
# edges.
_ENOUGH_LEFT = 1 / 3

# With fewer cells, in all or per side, or fewer tiles, coarse scales are no estimate; with fewer cells, no level is.
_MIN_CELLS, _MIN_SIDE, _MIN_TILES, _MIN_BY_LEVEL = 5_000, 64, 81, 10_000

# Rows of a band, a multiple of the cells that the coarsest tiles span; and cells in all bands.
_BAND, MOST_CELLS = 128, 400_000

# These squares make three thousand tiles, of which the lowest tenth is a stable estimate.
_ENOUGH_SQUARES = 200_000

# Share of its squares that a tile must hold, or as many as the fullest tile.
_FULL_TILE = 0.5

# Coefficients of overlapping squares are correlated, by -1/2 beside and 1/4 across: the sum of the squared correlations
# is the number of coefficients per degree of freedom. Then the unevenness of the means of the squares on white noise.
_HAAR_OVERLAP = 2.25
_UNEVEN_TILES, _SPREAD_OF_TILES = 0.237, 0.253

# Share of the tiles that are taken to be free of edges and texture, and how many at least. On painted, baked and
# photographed textures with noise of 5 to 40 of 255, estimates hardly differ between shares of 0.05 and 0.2.
_TILES_SHARE, _TILES_LEAST = 0.1, 20


def measure_by_scale(
    planes: Float32s, filled: Bools, relative: Float32s | None = None
) -> tuple[list[Neighbourhoods] | None, Float64s]:
    """Measure the tiles of each scale; return them, and the mixing of channels into components, shape (K, K).

    None instead of them if most tiles are plain.
    """
    colours = planes[:3] if len(planes) >= 3 else planes
    rows = _some_rows(*filled.shape)
    colours, filled = colours[:, rows], filled[rows]
    mixing = _mixing_of(colours, filled)
    louder = None if relative is None else relative[0, rows]
    cut = at_limits(colours).mean(axis=0, dtype=np.float32)
    # Not by BLAS: its threads would spin for as long as an iteration takes.
    means = np.einsum("ij,jrc->irc", mixing.astype(np.float32), colours)
    scales = []
    for scale, side in enumerate(_TILES):
        corners = corners_of(means)
        means = corners.mean(axis=0)
        differences = corners - means
        details = np.square(differences).sum(axis=0) / 3
        cut, filled = corners_of(cut[None]).mean(axis=0)[0], all_filled(filled)
        whole = sums_of_tiles(filled, side) == side**2
        if not whole.any():
            break
        if louder is not None:
            louder = corners_of(louder[None]).mean(axis=0)[0]
        loud = 1 if louder is None else louder
        most = most_noise(4**scale * details / loud, _uncut(filled, cut, side))
        share = np.where(whole, sums_of_tiles(cut, side) / side**2, 1)
        tiles = share < most_cut_off(share)
        if scale == len(_TILES) - 1 and np.count_nonzero(tiles) < _ENOUGH_LEFT * np.count_nonzero(whole):
            break
        energy, square, level = (
            np.stack([sums_of_tiles(plane, side)[tiles] for plane in of]) / side**2
            for of in (details, np.square(means), means)
        )
        remaining = variance_of_clipped(share[tiles])
        if louder is not None:
            remaining = remaining * sums_of_tiles(louder, side)[tiles] / side**2
        plain = energy.min(axis=0, initial=np.inf) <= _PLAIN
        if scale == 0 and (np.count_nonzero(plain) > MOST_PLAIN * len(plain) or _is_paint(details, tiles)):
            return None, mixing
        of_channels = None
        if scale == SCALE_OF_CHANNELS:
            squares = np.square(by_channel(differences.swapaxes(0, 1), mixing)).sum(axis=1) / 3
            of_channels = np.stack([sums_of_tiles(plane, side)[tiles] for plane in squares])[:, ~plain]
        scales.append(
            Neighbourhoods(
                (4**scale * energy / remaining)[:, ~plain],
                (np.sum(square - level**2, axis=0) / remaining)[~plain],
                by_channel(level[:, ~plain], mixing),
                3 * side**2,
                float(share[whole].mean()),
                most,
                of_channels,
            )
        )
    return scales, mixing


def _is_paint(details: Float32s, tiles: Bools) -> bool:
    """Whether many squares are plain in the tiles that are not, as noise leaves hardly any."""
    equal = sums_of_tiles(details.max(axis=0) <= _PLAIN, _TILES[0])[tiles] / _TILES[0] ** 2
    varied = equal[equal < 1]
    return bool(varied.sum() > MOST_EQUAL * len(varied))


def _mixing_of(colours: Float32s, filled: Bools) -> Float64s:
    """Return the mixing of channels into components by details of means of 2 x 2 cells."""
    fine = corners_of(colours).mean(axis=0)
    corners, whole = corners_of(fine), all_filled(all_filled(filled))
    details = (corners - corners.mean(axis=0))[:, :, whole]
    return mixing_by(details.swapaxes(0, 1).reshape(len(colours), -1))


def find_grid_noise(
    planes: Float32s, filled: Bools, *, by_level: bool, relative: Float32s | None = None
) -> FoundNoise:
    """Find how noise depends on the level, if it may, and what neighbouring cells share; `relative`: see `Manifold`."""
    cells = int(np.count_nonzero(filled))
    if cells < _MIN_CELLS or min(filled.shape) < _MIN_SIDE:
        return FoundNoise()
    scales, mixing = measure_by_scale(planes, filled, relative)
    if scales is None:
        return FoundNoise(doubt=np.inf)
    if not scales or scales[0].levels.shape[1] < _MIN_TILES:
        return FoundNoise()
    by_level &= cells >= _MIN_BY_LEVEL and are_levels(scales[0])
    alone = partial(estimate_sigma_on_grid, planes, filled)
    return noise_of_scales(scales, mixing, len(planes), alone, by_level=by_level)


def corners_of(planes: Float32s) -> Float32s:
    """Return the four corners of squares of 2 x 2 cells, side by side, shape (4, N, R // 2, C // 2)."""
    rows, columns = (size // 2 * 2 for size in planes.shape[1:])
    return np.stack([planes[:, i:rows:2, j:columns:2] for i in (0, 1) for j in (0, 1)])


def all_filled(filled: Bools) -> Bools:
    """Return which squares of 2 x 2 cells are filled."""
    rows, columns = (size // 2 * 2 for size in filled.shape)
    above, below = filled[:rows:2, :columns], filled[1:rows:2, :columns]
    both = above & below
    return np.asarray(both[:, ::2] & both[:, 1::2])


def _uncut(filled: Bools, cut: Float32s, side: int) -> Bools:
    """Return which squares are filled, and have no colour at a limit within their tiles; none beyond whole tiles."""
    dark = (sums_of_tiles(cut, side) == 0).repeat(side, axis=0).repeat(side, axis=1)
    uncut = np.zeros_like(filled)
    uncut[: len(dark), : dark.shape[1]] = dark
    return filled & uncut


def sums_of_tiles(values: Float32s | Bools, side: int) -> Float64s:
    """Sum over tiles; incomplete tiles at the borders are left out."""
    rows, columns = (size // side for size in values.shape)
    whole = values[: rows * side, : columns * side].reshape(rows, side, columns, side)
    # Along both axes at once, the sum takes four times as long.
    return np.asarray(np.einsum("rck->rc", whole.sum(axis=1, dtype=np.float64)), np.float64)


def _some_rows(count: int, columns: int) -> slice | NDArray[np.intp]:
    """Choose evenly spread bands of rows with about `MOST_CELLS` cells; all rows if there are no more."""
    bands = max(2, MOST_CELLS // (_BAND * max(1, columns)))
    if count <= _BAND * bands:
        return slice(None)
    first = ((np.arange(bands) + 0.5) * count / bands - _BAND / 2).astype(int) // 2 * 2
    return (first[:, None] + np.arange(_BAND)).reshape(-1)


def estimate_sigma_on_grid(planes: Float32s, filled: Bools) -> Float64s:
    """Estimate sigma of independent noise of the filled cells, per channel; 0 where there are too few."""
    from beltrami_cli._native import HAAR_TILE_SIDE, measure_haar_tiles

    step = max(1, int(np.count_nonzero(filled)) // _ENOUGH_SQUARES)
    first_rows = np.arange(0, len(filled) - 1, HAAR_TILE_SIDE * step)
    count, measures = measure_haar_tiles(planes, filled, first_rows)
    enough = count >= min(_FULL_TILE * HAAR_TILE_SIDE**2, float(count.max(initial=1)))
    if not enough.any() or np.count_nonzero(filled) < FEWEST_SAMPLES:
        return np.zeros(len(planes))
    freedom = float(count[enough].mean()) / _HAAR_OVERLAP
    white = WhiteNoise(freedom, _UNEVEN_TILES, _SPREAD_OF_TILES, _TILES_SHARE, _TILES_LEAST)
    sigma = flat_patch_sigma(Patches(*measures[:, :, enough]), white)
    ranges = [
        np.max(own, where=filled, initial=-np.inf) - np.min(own, where=filled, initial=np.inf)
        for own in planes
    ]
    return np.minimum(noise_or_paint(sigma, np.array(ranges)), _most_of_cells(planes, filled))


def _most_of_cells(planes: Float32s, filled: Bools) -> Float64s:
    """Return sigma of noise of cells at most, by channel."""
    rows, most = _some_rows(*filled.shape), np.zeros(len(planes))
    squares = all_filled(filled[rows])
    for channel in range(len(planes)):
        plane = planes[channel : channel + 1, rows]
        at_limit = at_limits(plane).astype(np.float32)
        corners, cut = corners_of(plane), corners_of(at_limit).max(axis=0)[0]
        details = np.square(corners - corners.mean(axis=0)).sum(axis=0) / 3
        most[channel] = most_noise(details, _uncut(squares, cut, _TILES[0]))[0]
    return most
