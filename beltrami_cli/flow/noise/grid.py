"""The noise of colours on a grid: independent noise, and noise that neighbours and channels share.

JPEG converts colours to their mean and differences of channels, and stores these in coarser steps, often for 2 x 2
pixels together. The finer the detail of noise, the more of it is lost in the steps. So the noise that is left is found
from the differences of channels at lower and lower resolution, where it is what it was.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.noise.flat_patch_noise import Groups, Kind, weakest_levels
from beltrami_cli.flow.noise.haar_noise import sigma_of_octaves

if TYPE_CHECKING:
    from numpy.typing import NDArray

# So many squares make three thousand tiles, the tenth least of which is steady.
_ENOUGH_SQUARES = 200_000

# Share of its squares that a tile must hold, or as many as the fullest tile.
_FULL_TILE = 0.5

# Coefficients of overlapping squares are correlated, by -1/2 beside and 1/4 across: the sum of the squared correlations
# is how many of them count as one degree of freedom. The means of the squares are as uneven as that on white noise.
_HAAR_OVERLAP = 2.25
_UNEVEN_TILES, _SPREAD_OF_TILES = 0.237, 0.253

# Share of the tiles that are taken to be free of edges and texture, and how many at least. On painted, baked and
# photographed textures with noise of 5 to 40 of 255, estimates hardly differ between shares of 0.05 and 0.2.
_TILES_SHARE, _TILES_LEAST = 0.1, 20


def estimate_sigma_on_grid(planes: NDArray[np.float32], filled: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Estimate the standard deviation of independent noise on a grid, per channel.

    The diagonal Haar coefficients (a - b - c + d) / 2 of all 2 x 2 squares keep the noise and lose constants and
    slopes [1]_; `weakest_levels` takes them from the tiles of 8 x 8 squares where means of squares are even. Of more
    than 200,000 filled cells, bands of rows are looked at.

    Parameters
    ----------
    planes : ndarray of float32, shape (N, R, C)
        Colours.
    filled : ndarray of bool, shape (R, C)
        Which cells to look at.

    Returns
    -------
    ndarray of float64, shape (N,)
        In units of `planes`; 0 where no square is filled.

    References
    ----------
    .. [1] D. Donoho, I. Johnstone, "Ideal spatial adaptation by wavelet shrinkage", Biometrika 81 (1994),
       doi:10.1093/biomet/81.3.425
    """
    from beltrami_cli._native import HAAR_TILE_SIDE, measure_haar_tiles

    step = max(1, int(np.count_nonzero(filled)) // _ENOUGH_SQUARES)
    first_rows = np.arange(0, len(filled) - 1, HAAR_TILE_SIDE * step)
    count, measures = measure_haar_tiles(planes, filled, first_rows)
    enough = count >= min(_FULL_TILE * HAAR_TILE_SIDE**2, float(count.max(initial=1)))
    if not enough.any():
        return np.zeros(len(planes))
    freedom = float(count[enough].mean()) / _HAAR_OVERLAP
    kind = Kind(freedom, _UNEVEN_TILES, _SPREAD_OF_TILES, _TILES_SHARE, _TILES_LEAST)
    return weakest_levels(Groups(*measures[:, :, enough]), kind)


# The mean of three channels and two differences, of unit length and square to each other.
_OPPONENTS = np.array([[1, 1, 1], [1, 0, -1], [1, -2, 1]]) / np.sqrt([[3], [2], [6]])

# What brings them into [0, 1], so that limits of the channels are not taken for theirs.
_SCALE, _MIDDLE = 1 / np.sqrt(3), np.array([0, 0.5, 0.5])

# Octaves that are told apart; in the last, and what is coarser, noise is what it was.
_OCTAVES = 4

# How much larger noise of differences may come out at half the resolution: on painted, baked and photographed textures
# at most 1.6 times for independent noise of 2 to 40 of 255; more than twice for what JPEG leaves. Less there may be
# texture, and more than in the mean of channels, whose steps are finer.
_MOST, _LEAST = 1.7, 1.25 / 255

# Noise of differences at a quarter of the resolution is what that of the mean is at half; what is more is texture. Of
# pictures that were enlarged, noise grows in both, but less and less; texture does not.
_TEXTURE, _SCALED = 1.5, 2.0

# The same as `_MOST` at a quarter, for pictures whose colour is stored for 2 x 2 pixels: these have less than half of
# the noise of the mean there, and textures have more.
_MOST_QUARTER, _COLOURLESS = 3.0, 2.0

# How much more noise the mean and the differences may have than the channels, whose noise is theirs if it is
# independent: on the same textures at most 1.2 times.
_MISSING = 1.25

# In differences, noise is believed to be so many times larger from one octave to the next; more is texture.
_TRUSTED = 3.0

# Steps keep some noise as a few large details, that a low quantile does not see: half of the next octave at least.
_KEPT = 0.5

# The mean is stored in the finest steps; these add to its noise up to so many times what was there before.
_ADDED = 1.25

# Share of the cells that tell enough alone, away from 0 and full scale.
_ENOUGH_INSIDE = 0.2

# Rows of a band, a multiple of the cells that the coarsest details span; and cells that are looked at in all.
_BAND, MOST_CELLS = 128, 200_000

# Of fewer cells, and of fewer a side, coarse octaves tell nothing: texture may look like noise.
_ENOUGH, _SMALLEST = 40_000, 64

# Squares a side of a tile; of the tiles this share, but no fewer than so many, are taken to hold nothing but noise.
_TILE, _SHARE, _FEWEST = 4, 0.1, 20

# A tile with less variance in any of them was plain, or has lost all its noise.
_PLAIN = 1e-9


def estimate_noise_on_grid(
    planes: NDArray[np.float32], filled: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Estimate the standard deviation of noise on a grid, per channel, whether it is independent or not.

    Parameters
    ----------
    planes : ndarray of float32, shape (N, R, C)
        Colours.
    filled : ndarray of bool, shape (R, C)
        Which cells to look at.

    Returns
    -------
    sigma : ndarray of float64, shape (N,)
        In units of `planes`; 0 where nothing tells.
    octaves : ndarray of float64, shape (L, N, N), or None
        As of `noise_in_common`.
    """
    sigma = estimate_sigma_on_grid(planes, filled)
    octaves = noise_in_common(planes, filled, sigma)
    return (sigma if octaves is None else sigma_of_octaves(octaves)), octaves


def noise_in_common(
    planes: NDArray[np.float32], filled: NDArray[np.bool_], sigma: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """Tell the noise that neighbouring cells of a grid have in common.

    Parameters
    ----------
    planes : ndarray of float32, shape (N, R, C)
        Colours, the first three channels of which are colours in [0, 1].
    filled : ndarray of bool, shape (R, C)
        Which cells to look at.
    sigma : ndarray of float64, shape (N,)
        Noise of the channels, as `estimate_sigma_on_grid` tells it.

    Returns
    -------
    ndarray of float64, shape (L, N, N), or None
        Covariances, octave by octave, see `octaves.draw_octaves`; None if the noise is independent, or where fewer than
        three channels or few cells tell nothing of that.
    """
    if len(planes) < len(_OPPONENTS) or np.count_nonzero(filled) < _ENOUGH or min(filled.shape) < _SMALLEST:
        return None
    rows = _some_rows(*filled.shape)
    colours, filled = planes[: len(_OPPONENTS), rows], filled[rows]
    # Where noise was cut off there is less of it, in differences and in means of some cells each in its own way.
    inside = filled & ((colours > 0) & (colours < 1)).all(axis=0)
    if np.count_nonzero(inside) > _ENOUGH_INSIDE * np.count_nonzero(filled):
        filled = inside
    # By BLAS it would start threads, which spin for as long as an iteration takes.
    opponents = np.einsum("ij,jrc->irc", (_SCALE * _OPPONENTS).astype(np.float32), colours)
    opponents += _MIDDLE.astype(np.float32)[:, None, None]
    octaves = [(opponents, filled)]
    while len(octaves) < _OCTAVES:
        octaves.append(_halved(*octaves[-1]))
    least = (
        np.array([2**level * estimate_sigma_on_grid(*octave) for level, octave in enumerate(octaves)])
        / _SCALE
    )
    if not _is_in_common(least, sigma[: len(_OPPONENTS)]):
        return None
    mean = np.array([2**level * _mean_sigma(*octave) for level, octave in enumerate(octaves[:-1])]) / _SCALE
    return _covariances(*_levels(least, mean), sigma)


def _is_in_common(least: NDArray[np.float64], sigma: NDArray[np.float64]) -> bool:
    """Tell so from the finest octaves of the mean and the differences, and from the channels."""
    fine, half, quarter = least[:3, 1:]
    brightness = least[1, 0]
    middle, coarse = _root_mean_square(half), _root_mean_square(quarter)
    grows = np.all(half > _MOST * fine) and middle > _LEAST
    grows &= coarse < _SCALED * middle or (middle < brightness and coarse < _TEXTURE * brightness)
    colourless = np.all(quarter > _MOST_QUARTER * fine) and _LEAST < coarse < brightness / _COLOURLESS
    missing = _root_mean_square(least[0]) > _MISSING * max(_root_mean_square(sigma), _LEAST)
    return bool(grows or colourless or missing)


def _levels(
    least: NDArray[np.float64], mean: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Put together what is told of the noise, octave by octave: of the mean of channels, and of their differences.

    Low quantiles of even tiles tell too little where details are few and large; means of these tell too much where
    there is texture. So the means are believed as far as noise can go: what it is in the coarsest octave of
    differences, which lost least and holds the least texture, and in the mean of channels not much more.
    """
    brightness, difference = least[:, 0], np.sqrt(np.mean(np.square(least[:, 1:]), axis=1))
    own = np.sqrt(np.mean(np.square(mean[:, 1:]), axis=1))
    before, last = difference[-2:]
    most = min(max(before, min(last, _TRUSTED * before)), _ADDED * max(brightness[1], before))
    differences = np.append(np.minimum(np.maximum(difference[:-1], own), most), most)
    finest = min(max(brightness[0], mean[0, 0]), _ADDED * max(brightness[0], most))
    limit = max(finest, _ADDED * most)
    others = np.minimum(np.maximum(brightness[1:-1], mean[1:, 0]), limit)
    levels = np.stack([[finest, *others, limit], differences])
    for level in reversed(range(_OCTAVES - 1)):
        levels[:, level] = np.maximum(levels[:, level], _KEPT * levels[:, level + 1])
    return levels[0], levels[1]


def _covariances(
    brightness: NDArray[np.float64], differences: NDArray[np.float64], sigma: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the covariances of all channels; those that are no colours have independent noise."""
    count = len(_OPPONENTS)
    octaves = np.tile(np.diag(np.square(sigma)), (_OCTAVES, 1, 1))
    along = np.full((count, count), 1 / count)
    across = np.eye(count) - along
    octaves[:, :count, :count] = np.multiply.outer(brightness**2, along)
    octaves[:, :count, :count] += np.multiply.outer(differences**2, across)
    return octaves


def _mean_sigma(opponents: NDArray[np.float32], filled: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Tell the noise by the mean of all details in the tiles where means are most even; infinite without tiles."""
    corners = _corners(opponents)
    whole = _all_filled(filled)
    mean = corners.mean(axis=0)
    details = (np.square(corners - mean).sum(axis=0) / 3).astype(np.float32)
    count = _sums(whole)
    enough = count == _TILE**2
    energy, square, level = (
        np.stack([_sums(np.where(whole, plane, 0))[enough] / count[enough] for plane in of])
        for of in (details, mean**2, mean)
    )
    uneven = (square - level**2).sum(axis=0)
    noisy = np.flatnonzero(energy.min(axis=0, initial=np.inf) > _PLAIN)
    if not len(noisy):
        return np.full(len(opponents), np.inf)
    chosen = max(_FEWEST, int(_SHARE * len(noisy)))
    even = noisy[np.argsort(uneven[noisy], kind="stable")[:chosen]]
    return np.asarray(np.sqrt(energy[:, even].mean(axis=1)), np.float64)


def _corners(planes: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the four corners of squares of 2 x 2 cells, side by side, shape (4, N, R // 2, C // 2)."""
    rows, columns = (size // 2 * 2 for size in planes.shape[1:])
    return np.stack([planes[:, i:rows:2, j:columns:2] for i in (0, 1) for j in (0, 1)])


def _halved(
    planes: NDArray[np.float32], filled: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return the means of squares of 2 x 2 cells, and which of them are filled."""
    return _corners(planes).mean(axis=0), _all_filled(filled)


def _all_filled(filled: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Tell which squares of 2 x 2 cells are filled."""
    rows, columns = (size // 2 * 2 for size in filled.shape)
    above, below = filled[:rows:2, :columns], filled[1:rows:2, :columns]
    both = above & below
    return np.asarray(both[:, ::2] & both[:, 1::2])


def _sums(values: NDArray[np.float32] | NDArray[np.bool_]) -> NDArray[np.float64]:
    """Sum over tiles; what is left over at the borders is left out."""
    rows, columns = (size // _TILE for size in values.shape)
    whole = values[: rows * _TILE, : columns * _TILE].reshape(rows, _TILE, columns, _TILE)
    return np.asarray(whole.sum(axis=(1, 3), dtype=np.float64))


def _root_mean_square(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _some_rows(count: int, columns: int) -> slice | NDArray[np.intp]:
    """Choose bands of rows, evenly spread, with about so many cells; all rows if there are no more."""
    bands = max(2, MOST_CELLS // (_BAND * max(1, columns)))
    if count <= _BAND * bands:
        return slice(None)
    first = ((np.arange(bands) + 0.5) * count / bands - _BAND / 2).astype(int)
    return (first[:, None] + np.arange(_BAND)).reshape(-1)
