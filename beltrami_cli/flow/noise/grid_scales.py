"""The noise of colours on a grid, by level and by scale: of cameras, resampled photographs, grain and JPEG.

Details of 2 x 2 cells, of 2 x 2 means of such, and so on, are measured in tiles, see `by_level`. Independent noise is
as strong in all of them; noise that neighbours share is weaker in the finer ones, and is as strong in all from a scale
on, while textures keep growing. In photographs, textures are weakest in the differences of channels: these show
whether noise is shared, and bound what is taken for noise in their mean.

Independent noise alone is estimated from the diagonal Haar coefficients (a - b - c + d) / 2 of all 2 x 2 squares, which
keep the noise and lose constants and slopes [1]_, in the tiles of 8 x 8 squares in which means of squares are even. On
more than 200,000 filled cells, evenly spread bands of rows are used.

References
----------
.. [1] D. Donoho, I. Johnstone, "Ideal spatial adaptation by wavelet shrinkage", Biometrika 81 (1994),
   doi:10.1093/biomet/81.3.425
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.clipping import variance_of_clipped
from beltrami_cli.flow.noise.by_level import (
    OPPONENTS,
    Neighbourhoods,
    fit_by_level,
    mixing_for,
    stabiliser_of,
)
from beltrami_cli.flow.noise.flat_patch_noise import Patches, WhiteNoise, flat_patch_sigma
from beltrami_cli.surface import large_arrays

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.arrays import Bools, Float32s, Float64s
    from beltrami_cli.flow.noise.stabilising import VarianceStabiliser

# Scales that are measured; in the last, and in coarser ones, noise is as strong.
SCALES = 4

# Squares per side of a tile, scale by scale: there are few of the coarse ones.
_TILES = (4, 4, 2, 2)

# Tiles with a larger share of cells at 0 or full scale are left out, and those without any detail; more are taken where
# fewer than this share of the tiles would be left.
_MOST_CUT_OFF, _DARK, _ENOUGH_LIT, _PLAIN = 0.3, 0.6, 0.1, 1e-9

# If this share of the tiles is plain, there is no noise, and the others show paint.
_MOST_PLAIN = 0.5

# With fewer cells, in all or per side, or fewer tiles, coarse scales are no estimate; with fewer cells, no level is.
_MIN_CELLS, _MIN_SIDE, _MIN_TILES, _MIN_BY_LEVEL = 5_000, 64, 81, 10_000

# Rows of a band, a multiple of the cells that the coarsest tiles span; and cells in all bands.
_BAND, MOST_CELLS = 128, 400_000

# Noise is shared if it grows by these factors from single cells to the second and third scale ...
_GROWS, _GROWS_TWICE = 1.35, 1.6
# ... in all components by less than this from there on ...
_EVEN, _LEAST_SIGMA = 1.6, 1.25 / 255
# ... and then by less than this, unlike texture; for one channel alone, where there is more texture, by less than ...
_MOST_GROWTH, _MOST_ALONE = 2.7, 1.6
# ... and if it is larger than what clean photographs hold at these scales.
_LEAST_MIDDLE, _LEAST_COARSE = 3.5 / 255, 4 / 255

# Noise of the finest details, relative to that of the diagonal ones among them at most.
_MOST_OF_DIAGONAL = 3.0

# Growth of the mean of channels from single cells to the second scale, beyond which it is texture.
_PLAIN_GROWTH = 2.0

# Growth to the last scale, below which noise has reached its full size.
_LEVEL, _ALIKE = 1.5, 2.0

# Growth to the last scale, beyond which there is texture.
_TEXTURE = 2.5

# JPEG keeps the finest noise of the mean of channels: that of coarse differences is no larger than this factor of it.
_COLOURLESS = 1.3

# JPEG leaves white noise in the mean of channels. It grows by less than the first of these from single cells to the
# second scale and less than the second to the third, or less than the third from single cells on, as no texture does.
# Differences of channels have less of it, at the second scale by more than the last factor, and least in the finest.
_MOST_FROM_FINEST, _EVEN_MEAN, _AS_FINE, _TAKEN = 2.2, 1.35, 1.25, 1.5

# Noise of the mean of channels and of their differences, relative to the smaller one of these at most.
_MOST_APART = 1.2

# Growth of noise in differences of channels from single cells to the second scale, beyond which JPEG has taken it.
_MOST_AT_SECOND = 2.5

# Noise of the last scale, relative to the one before at most: on small grids there are few tiles without texture.
_MOST_AT_LAST = 1.5

# Steps keep some noise as a few large details, which quiet tiles do not show: at least this share of the next scale.
_LEAST_OF_NEXT = 0.25
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


@dataclass(frozen=True)
class GridNoise:
    """What was found besides independent noise that is the same at all levels."""

    stabiliser: VarianceStabiliser | None
    covariances: Float64s | None  # of stabilised colours, shape (L, N, N), see `haar_noise`
    sigma: Float64s | None = None  # of stabilised colours, by channel, once that is known


def measure_by_scale(
    planes: Float32s, filled: Bools, relative: Float32s | None = None
) -> tuple[list[Neighbourhoods], Float64s]:
    """Measure the tiles of each scale; return them, and the mixing of channels into components, shape (K, K)."""
    colours = planes[:3] if len(planes) >= 3 else planes
    mixing = mixing_for(len(colours))
    rows = _some_rows(*filled.shape)
    colours, filled = colours[:, rows], filled[rows]
    louder = None if relative is None else relative[0, rows]
    cut = ((colours <= 0) | (colours >= 1)).mean(axis=0, dtype=np.float32)
    # Not by BLAS: its threads would spin for as long as an iteration takes.
    means = np.einsum("ij,jrc->irc", mixing.astype(np.float32), colours)
    scales = []
    for scale, side in enumerate(_TILES):
        corners = corners_of(means)
        means = corners.mean(axis=0)
        details = np.square(corners - means).sum(axis=0) / 3
        cut, filled = corners_of(cut[None]).mean(axis=0)[0], _all_filled(filled)
        whole = sums_of_tiles(filled, side) == side**2
        if not whole.any():
            break
        share = np.where(whole, sums_of_tiles(cut, side) / side**2, 1)
        lit = np.count_nonzero(share < _MOST_CUT_OFF) >= _ENOUGH_LIT * np.count_nonzero(share < 1)
        tiles = share < (_MOST_CUT_OFF if lit else _DARK)
        energy, square, level = (
            np.stack([sums_of_tiles(plane, side)[tiles] for plane in of]) / side**2
            for of in (details, np.square(means), means)
        )
        remaining = variance_of_clipped(share[tiles])
        if louder is not None:
            louder = corners_of(louder[None]).mean(axis=0)[0]
            remaining = remaining * sums_of_tiles(louder, side)[tiles] / side**2
        plain = energy.min(axis=0, initial=np.inf) <= _PLAIN
        if scale == 0 and np.count_nonzero(plain) > _MOST_PLAIN * len(plain):
            break
        scales.append(
            Neighbourhoods(
                (4**scale * energy / remaining)[:, ~plain],
                (np.sum(square - level**2, axis=0) / remaining)[~plain],
                (level[0] / np.sqrt(len(mixing)) if len(mixing) == 3 else level.mean(axis=0))[~plain],
                3 * side**2,
            )
        )
    return scales, mixing


def find_grid_noise(
    planes: Float32s, filled: Bools, *, by_level: bool, relative: Float32s | None = None
) -> GridNoise:
    """Find how noise depends on the level, if it may, and what neighbouring cells share; `relative`: see `Manifold`."""
    cells = int(np.count_nonzero(filled))
    if cells < _MIN_CELLS or min(filled.shape) < _MIN_SIDE:
        return GridNoise(None, None)
    scales, mixing = measure_by_scale(planes, filled, relative)
    if not scales or len(scales[0].level) < _MIN_TILES:
        return GridNoise(None, None)
    found = fit_by_level(scales)
    if found is None:
        return GridNoise(None, None)
    by_level &= cells >= _MIN_BY_LEVEL
    bands = large_arrays.blocks(planes.shape[1], _BAND)
    by_level &= all(float(planes[:3, rows].min()) >= 0 for rows in bands)  # other numbers are no levels
    stabiliser = stabiliser_of(found) if by_level else None
    if not is_shared(found.sigma):
        return GridNoise(stabiliser, None)
    diagonal = estimate_sigma_on_grid(planes[: len(mixing)], filled)
    sigma = _bounded(found.sigma, float(np.sqrt(np.mean(diagonal**2))))
    if stabiliser is not None:
        sigma = sigma * stabiliser.scale
    covariances = np.zeros((SCALES, len(planes), len(planes)))
    count = len(mixing)
    covariances[:, :count, :count] = np.einsum("ki,lk,kj->lij", mixing, sigma**2, mixing)
    rest = np.arange(len(planes)) >= count
    if rest.any():  # other channels have noise of their own
        covariances[:, rest, rest] = np.square(estimate_sigma_on_grid(planes[count:], filled))
    return GridNoise(stabiliser, covariances)


def is_shared(sigma: Float64s) -> bool:
    """Whether neighbours share noise, by its standard deviation at each scale, shape (L, K)."""
    if _level_of_mean(sigma) is not None:
        return True
    components = sigma[:, 1:] if sigma.shape[1] == 3 else sigma
    if len(sigma) < 3 or np.isnan(components[:3]).any():
        return False
    fine, middle, coarse = components[:3].min(axis=1)
    coarsest = components[3].min() if len(sigma) > 3 and not np.isnan(components[3]).any() else None
    most = _MOST_GROWTH if sigma.shape[1] == 3 else _MOST_ALONE
    # Texture keeps growing in all components; noise that does not may be small.
    if coarsest is not None and np.all(sigma[2] < _EVEN * sigma[1]) and np.all(sigma[3] < _EVEN * sigma[2]):
        return bool(coarse > _GROWS_TWICE * fine and coarse > _LEAST_SIGMA)
    if coarsest is not None and coarsest > _TEXTURE * coarse:
        return False
    grows = middle > _GROWS * fine and coarse < most * middle and max(middle, coarse / 2) > _LEAST_MIDDLE
    is_plain = sigma[1, 0] < _PLAIN_GROWTH * sigma[0, 0]
    plain = sigma[1, 0] if is_plain else sigma[0, 0]
    lost = coarse > _GROWS_TWICE * fine and coarse > _LEAST_COARSE
    lost &= coarsest is not None and coarsest < most * coarse and coarse < _COLOURLESS * plain
    # Or JPEG has taken the finest noise from the differences of channels, and that of their mean shows no texture.
    taken = sigma.shape[1] == 3 and middle > _MOST_AT_SECOND * fine and middle > _LEAST_MIDDLE
    taken &= bool(is_plain)
    return bool(grows or lost or taken or _levels_off(sigma))


def _level_of_mean(sigma: Float64s) -> float | None:
    """Return the level of white noise in the mean of channels, if differences of channels have less of it."""
    if sigma.shape[1] != len(OPPONENTS) or len(sigma) < 3 or np.isnan(sigma[:3]).any():
        return None
    fine, middle, coarse = sigma[:3, 0]
    differences = sigma[:3, 1:].max(axis=1)
    if middle < max(_LEAST_MIDDLE, _TAKEN * differences[1]) or differences[2] < _GROWS_TWICE * differences[0]:
        return None
    if middle < _MOST_FROM_FINEST * fine and coarse < _EVEN_MEAN * middle:
        return float(max(fine, middle, coarse))
    return float(max(fine, middle)) if middle < _AS_FINE * fine else None


def _levels_off(sigma: Float64s) -> bool:
    """Whether differences of channels, and their mean as well, stop growing at the last scale, as coarse grain does."""
    if sigma.shape != (SCALES, len(OPPONENTS)) or np.isnan(sigma[:, 1:]).any():
        return False
    fine, _, coarse, coarsest = sigma[:, 1:].min(axis=1)
    if sigma[2, 0] > _ALIKE * coarse:
        return False
    return bool(coarse > 2 * _GROWS_TWICE * fine and coarse > _LEAST_COARSE and coarsest < _LEVEL * coarse)


def _bounded(sigma: Float64s, diagonal: float) -> Float64s:
    """Return the standard deviations of noise, shape (SCALES, K), without what is texture; `diagonal`: see `grid`."""
    known = np.full((SCALES, sigma.shape[1]), np.nan)
    known[: len(sigma)] = sigma
    for scale in range(1, SCALES):
        known[scale] = np.where(np.isnan(known[scale]), known[scale - 1], known[scale])
    of_mean = np.maximum.accumulate(known[:, 0])
    if not _levels_off(sigma):
        known[2] = np.minimum(known[2], _MOST_GROWTH * known[1])
    known[-1] = np.minimum(known[-1], _MOST_AT_LAST * known[-2])
    if sigma.shape[1] == 3:
        differences = known[:, 1:].min(axis=1)
        known[:, 1:] = np.minimum(known[:, 1:], _MOST_APART * differences[:, None])
        # JPEG takes the finest noise from the differences, and not from the mean, which shows if it is no texture.
        bounds = differences.copy()
        if differences[1] > _MOST_AT_SECOND * differences[0]:
            bounds[0] = min(differences[:3].max(), _MOST_OF_DIAGONAL * diagonal / _MOST_APART)
            bounds[1] = max(differences[1], min(known[0, 0] / _MOST_APART, bounds[0]) * _GROWS)
            for scale in (0, 1):
                if known[scale + 1, 0] < _GROWS * known[scale, 0]:
                    bounds[scale:] = np.maximum(bounds[scale:], known[scale, 0] / _MOST_APART)
        known[:, 0] = np.minimum(known[:, 0], _MOST_APART * bounds)
        level = _level_of_mean(sigma)
        if level is not None:
            known = np.minimum(known, level)
            known[:, 0] = np.minimum(of_mean, level)
    for scale in reversed(range(SCALES - 1)):
        known[scale] = np.maximum(known[scale], _LEAST_OF_NEXT * known[scale + 1])
    return known


def corners_of(planes: Float32s) -> Float32s:
    """Return the four corners of squares of 2 x 2 cells, side by side, shape (4, N, R // 2, C // 2)."""
    rows, columns = (size // 2 * 2 for size in planes.shape[1:])
    return np.stack([planes[:, i:rows:2, j:columns:2] for i in (0, 1) for j in (0, 1)])


def _all_filled(filled: Bools) -> Bools:
    """Return which squares of 2 x 2 cells are filled."""
    rows, columns = (size // 2 * 2 for size in filled.shape)
    above, below = filled[:rows:2, :columns], filled[1:rows:2, :columns]
    both = above & below
    return np.asarray(both[:, ::2] & both[:, 1::2])


def sums_of_tiles(values: Float32s | Bools, side: int) -> Float64s:
    """Sum over tiles; incomplete tiles at the borders are left out."""
    rows, columns = (size // side for size in values.shape)
    whole = values[: rows * side, : columns * side].reshape(rows, side, columns, side)
    return np.asarray(whole.sum(axis=(1, 3), dtype=np.float64))


def _some_rows(count: int, columns: int) -> slice | NDArray[np.intp]:
    """Choose evenly spread bands of rows with about `MOST_CELLS` cells; all rows if there are no more."""
    bands = max(2, MOST_CELLS // (_BAND * max(1, columns)))
    if count <= _BAND * bands:
        return slice(None)
    first = ((np.arange(bands) + 0.5) * count / bands - _BAND / 2).astype(int)
    return (first[:, None] + np.arange(_BAND)).reshape(-1)


def estimate_sigma_on_grid(planes: Float32s, filled: Bools) -> Float64s:
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
