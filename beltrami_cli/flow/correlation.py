"""Whether the noise of neighbouring samples is independent, which estimates of errors take for granted."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.noise import estimate_sigma_on_grid

if TYPE_CHECKING:
    from numpy.typing import NDArray

# How much larger noise may come out at half the resolution: on painted, baked and photographed textures at most 1.2
# times for independent noise, and mostly more than 2 for what JPEG leaves, by subsampling chroma or by coarse steps.
_MOST = 1.4

# Of more channels, which are no colours, so many are looked at.
_CHANNELS = 3

# Noise that is smaller is lost in the steps of an 8-bit file.
_LEAST = 0.5 / 255


def is_correlated_on_grid(planes: NDArray[np.float32], filled: NDArray[np.bool_]) -> bool:
    """Tell whether neighbouring cells of a grid have noise in common.

    Means of 2 x 2 cells have half the noise of single cells if that is independent. Differences of channels are looked
    at, for these hold few edges and little texture, and it is there that pictures are compressed most; all of them,
    because edges in some differences look like such noise.

    Parameters
    ----------
    planes : ndarray of float32, shape (N, R, C)
        Colours; of a single channel nothing is told.
    filled : ndarray of bool, shape (R, C)
        Which cells to look at.

    Returns
    -------
    bool
    """
    pairs = list(combinations(planes[:_CHANNELS], 2))
    return bool(pairs) and all(_is_correlated((1 + one - other) / 2, filled) for one, other in pairs)


def _is_correlated(plane: NDArray[np.float32], filled: NDArray[np.bool_]) -> bool:
    rows, columns = (size // 2 * 2 for size in filled.shape)
    shape = (rows // 2, 2, columns // 2, 2)
    blocks = np.asarray(filled[:rows, :columns].reshape(shape).all(axis=(1, 3)))
    means = plane[:rows, :columns].reshape(shape).mean(axis=(1, 3))
    fine = estimate_sigma_on_grid(plane[None], filled)[0]
    coarse = 2 * estimate_sigma_on_grid(means[None], blocks)[0]
    return bool(coarse > max(_MOST * fine, _LEAST))
