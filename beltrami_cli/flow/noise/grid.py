"""The noise level of colours on a grid, from tiles of neighbouring cells."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.noise.flat_patch_noise import Groups, Kind, weakest_levels

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
