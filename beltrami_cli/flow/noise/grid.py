"""The level of independent noise of the colours on a grid.

It is estimated from the diagonal Haar coefficients (a - b - c + d) / 2 of all 2 x 2 squares, which keep the noise and
lose constants and slopes [1]_, in the tiles of 8 x 8 squares in which means of squares are even. On more than 200,000
filled cells, evenly spread bands of rows are used.

References
----------
.. [1] D. Donoho, I. Johnstone, "Ideal spatial adaptation by wavelet shrinkage", Biometrika 81 (1994),
   doi:10.1093/biomet/81.3.425
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.noise.flat_patch_noise import Patches, WhiteNoise, flat_patch_sigma

if TYPE_CHECKING:
    from beltrami_cli.arrays import Bools, Float32s, Float64s

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
