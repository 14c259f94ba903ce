"""The noise of colours on a grid: independent noise, and noise that neighbouring cells share, as after JPEG or scaling.

Independent noise is estimated from the diagonal Haar coefficients (a - b - c + d) / 2 of all 2 x 2 squares, which keep
the noise and lose constants and slopes [1]_, in the tiles of 8 x 8 squares in which means of squares are even. On more
than 200,000 filled cells, evenly spread bands of rows are used.

JPEG transforms colours into their mean and differences of channels, and stores these in coarser steps, often for 2 x 2
pixels together. Noise vanishes in the steps, the more the finer its detail is. So the remaining noise is estimated from
the differences of channels at lower and lower resolution, where it is unchanged.

Low quantiles of even tiles underestimate noise where details are few and large; means of these tiles overestimate it
where there is texture. So the means are used within bounds for noise: its level in the coarsest scale of differences,
which lost least and holds the least texture, and not much more in the mean of channels.

References
----------
.. [1] D. Donoho, I. Johnstone, "Ideal spatial adaptation by wavelet shrinkage", Biometrika 81 (1994),
   doi:10.1093/biomet/81.3.425
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.noise.flat_patch_noise import Patches, WhiteNoise, flat_patch_sigma
from beltrami_cli.flow.noise.haar_noise import sigma_of_covariances

if TYPE_CHECKING:
    from numpy.typing import NDArray

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


def estimate_sigma_on_grid(planes: NDArray[np.float32], filled: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Estimate sigma of independent noise of the filled cells, per channel; 0 where no square is filled."""
    from beltrami_cli._native import HAAR_TILE_SIDE, measure_haar_tiles

    step = max(1, int(np.count_nonzero(filled)) // _ENOUGH_SQUARES)
    first_rows = np.arange(0, len(filled) - 1, HAAR_TILE_SIDE * step)
    count, measures = measure_haar_tiles(planes, filled, first_rows)
    enough = count >= min(_FULL_TILE * HAAR_TILE_SIDE**2, float(count.max(initial=1)))
    if not enough.any():
        return np.zeros(len(planes))
    freedom = float(count[enough].mean()) / _HAAR_OVERLAP
    white = WhiteNoise(freedom, _UNEVEN_TILES, _SPREAD_OF_TILES, _TILES_SHARE, _TILES_LEAST)
    return flat_patch_sigma(Patches(*measures[:, :, enough]), white)


# The mean of three channels and two differences, orthonormal.
_OPPONENTS = np.array([[1, 1, 1], [1, 0, -1], [1, -2, 1]]) / np.sqrt([[3], [2], [6]])

# Factor and offset that bring them into [0, 1], so that the limits of the channels are not taken for theirs.
_SCALE, _MIDDLE = 1 / np.sqrt(3), np.array([0, 0.5, 0.5])

# Scales that are estimated; in the last, and in coarser ones, noise is unchanged.
_SCALES = 4

# Bound on the growth of noise of differences at half the resolution: on painted, baked and photographed textures at
# most 1.6 times for independent noise of 2 to 40 of 255; more than twice after JPEG. Below the least sigma it may be
# texture, and above that in the mean of channels, whose steps are finer.
_MOST_AT_HALF, _LEAST_SIGMA = 1.7, 1.25 / 255

# Noise of differences at a quarter of the resolution equals that of the mean at half; the excess is texture. In
# pictures that were enlarged, noise grows in both, but less and less; texture does not.
_TEXTURE, _SCALED = 1.5, 2.0

# The same as `_MOST_AT_HALF` at a quarter, for pictures whose colour is stored for 2 x 2 pixels: these have less than
# half of the noise of the mean there, and textures have more.
_MOST_AT_QUARTER, _COLOURLESS = 3.0, 2.0

# Factor by which noise of mean and differences may exceed that of the channels, which it equals if it is independent:
# on the same textures at most 1.2.
_MISSING = 1.25

# Bound on the growth of noise of differences from one scale to the next; more is texture.
_MOST_PER_SCALE = 3.0

# Steps keep some noise as a few large details, which a low quantile does not see: at least half of the next scale.
_LEAST_OF_NEXT = 0.5

# The mean is stored in the finest steps, which add to its noise up to this factor.
_ADDED = 1.25

# Share of the cells away from 0 and full scale that suffices for an estimate.
_ENOUGH_INSIDE = 0.2

# Rows of a band, a multiple of the cells that the coarsest details span; and cells in all bands.
_BAND, MOST_CELLS = 128, 200_000

# With fewer cells, in all or per side, coarse scales are no estimate: texture may look like noise.
_MIN_CELLS, _MIN_SIDE = 40_000, 64

# So they are with fewer squares at the coarsest scale, as where cells that were cut off are left out.
_MIN_SQUARES = 100

# Squares per side of a tile; share and least number of the tiles that are taken for pure noise.
_TILE, _TILE_SHARE, _MIN_TILES = 4, 0.1, 20

# A tile with less variance in any of them was plain, or has lost all its noise.
_PLAIN = 1e-9


def estimate_noise_on_grid(
    planes: NDArray[np.float32], filled: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Estimate sigma of noise, shape (N,), and its covariances if neighbouring cells share it, else None."""
    sigma = estimate_sigma_on_grid(planes, filled)
    covariances = correlated_covariances(planes, filled, sigma)
    return (sigma if covariances is None else sigma_of_covariances(covariances)), covariances


def correlated_covariances(
    planes: NDArray[np.float32], filled: NDArray[np.bool_], sigma: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """Return the covariances, shape (L, N, N), of noise shared by neighbours; None if it is independent."""
    if (
        len(planes) < len(_OPPONENTS)
        or np.count_nonzero(filled) < _MIN_CELLS
        or min(filled.shape) < _MIN_SIDE
    ):
        return None
    rows = _some_rows(*filled.shape)
    colours, filled = planes[: len(_OPPONENTS), rows], filled[rows]
    # Clipped noise is reduced in differences and in means of cells by different factors.
    inside = filled & ((colours > 0) & (colours < 1)).all(axis=0)
    if np.count_nonzero(inside) > _ENOUGH_INSIDE * np.count_nonzero(filled):
        filled = inside
    # Not by BLAS: its threads would spin for as long as an iteration takes.
    opponents = np.einsum("ij,jrc->irc", (_SCALE * _OPPONENTS).astype(np.float32), colours)
    opponents += _MIDDLE.astype(np.float32)[:, None, None]
    scales = [(opponents, filled)]
    while len(scales) < _SCALES:
        scales.append(_halved(*scales[-1]))
    if np.count_nonzero(_all_filled(scales[-1][1])) < _MIN_SQUARES:
        return None
    sigmas = [2**level * estimate_sigma_on_grid(*scale) for level, scale in enumerate(scales)]
    by_quantile = np.array(sigmas) / _SCALE
    if not _is_correlated(by_quantile, sigma[: len(_OPPONENTS)]):
        return None
    sigmas = [2**level * _mean_sigma(*scale) for level, scale in enumerate(scales[:-1])]
    return _covariances(*_levels(by_quantile, np.array(sigmas) / _SCALE), sigma)


def _is_correlated(by_quantile: NDArray[np.float64], sigma: NDArray[np.float64]) -> bool:
    """Decide from the finest scales of the mean and the differences, and from the channels."""
    fine, half, quarter = by_quantile[:3, 1:]
    brightness = by_quantile[1, 0]
    middle, coarse = _root_mean_square(half), _root_mean_square(quarter)
    grows = np.all(half > _MOST_AT_HALF * fine) and middle > _LEAST_SIGMA
    grows &= coarse < _SCALED * middle or (middle < brightness and coarse < _TEXTURE * brightness)
    colourless = (
        np.all(quarter > _MOST_AT_QUARTER * fine) and _LEAST_SIGMA < coarse < brightness / _COLOURLESS
    )
    missing = _root_mean_square(by_quantile[0]) > _MISSING * max(_root_mean_square(sigma), _LEAST_SIGMA)
    return bool(grows or colourless or missing)


def _levels(
    by_quantile: NDArray[np.float64], by_mean: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Combine the estimates, scale by scale: noise of the mean of channels, and of their differences."""
    brightness, difference = by_quantile[:, 0], np.sqrt(np.mean(np.square(by_quantile[:, 1:]), axis=1))
    difference_by_mean = np.sqrt(np.mean(np.square(by_mean[:, 1:]), axis=1))
    before, last = difference[-2:]
    bound = min(max(before, min(last, _MOST_PER_SCALE * before)), _ADDED * max(brightness[1], before))
    differences = np.append(np.minimum(np.maximum(difference[:-1], difference_by_mean), bound), bound)
    finest = min(max(brightness[0], by_mean[0, 0]), _ADDED * max(brightness[0], bound))
    coarsest = max(finest, _ADDED * bound)
    others = np.minimum(np.maximum(brightness[1:-1], by_mean[1:, 0]), coarsest)
    levels = np.stack([[finest, *others, coarsest], differences])
    for level in reversed(range(_SCALES - 1)):
        levels[:, level] = np.maximum(levels[:, level], _LEAST_OF_NEXT * levels[:, level + 1])
    return levels[0], levels[1]


def _covariances(
    brightness: NDArray[np.float64], differences: NDArray[np.float64], sigma: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the covariances of all channels; channels that are not colours have independent noise."""
    count = len(_OPPONENTS)
    covariances = np.tile(np.diag(np.square(sigma)), (_SCALES, 1, 1))
    along = np.full((count, count), 1 / count)
    across = np.eye(count) - along
    covariances[:, :count, :count] = np.multiply.outer(brightness**2, along)
    covariances[:, :count, :count] += np.multiply.outer(differences**2, across)
    return covariances


def _mean_sigma(opponents: NDArray[np.float32], filled: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Estimate noise from the mean of all details in the tiles with the most even means; infinite without tiles."""
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
    chosen = max(_MIN_TILES, int(_TILE_SHARE * len(noisy)))
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
    """Return which squares of 2 x 2 cells are filled."""
    rows, columns = (size // 2 * 2 for size in filled.shape)
    above, below = filled[:rows:2, :columns], filled[1:rows:2, :columns]
    both = above & below
    return np.asarray(both[:, ::2] & both[:, 1::2])


def _sums(values: NDArray[np.float32] | NDArray[np.bool_]) -> NDArray[np.float64]:
    """Sum over tiles; incomplete tiles at the borders are left out."""
    rows, columns = (size // _TILE for size in values.shape)
    whole = values[: rows * _TILE, : columns * _TILE].reshape(rows, _TILE, columns, _TILE)
    return np.asarray(whole.sum(axis=(1, 3), dtype=np.float64))


def _root_mean_square(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _some_rows(count: int, columns: int) -> slice | NDArray[np.intp]:
    """Choose evenly spread bands of rows with about `MOST_CELLS` cells; all rows if there are no more."""
    bands = max(2, MOST_CELLS // (_BAND * max(1, columns)))
    if count <= _BAND * bands:
        return slice(None)
    first = ((np.arange(bands) + 0.5) * count / bands - _BAND / 2).astype(int)
    return (first[:, None] + np.arange(_BAND)).reshape(-1)
