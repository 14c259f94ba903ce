"""Whether the noise of neighbouring samples is independent, which estimates of errors take for granted."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.noise import estimate_sigma_on_grid

if TYPE_CHECKING:
    from numpy.typing import NDArray

# How much larger noise may come out at half the resolution: on painted, baked and photographed textures at most 1.6
# times for independent noise of 2 to 40 of 255; more than 2.5 times for what JPEG leaves, by subsampling chroma or by
# steps that are coarser than the noise. Of steps that are finer nothing is found.
_MOST = 2.0

# Less is enough where differences of channels have less noise, by the second factor, than there is between channels of
# independent noise: of that they have at most 1.2 times less (1.4 times, but not much more at half the resolution).
_SUSPICIOUS, _MISSING = 1.4, 1.25

# Of more channels, which are no colours, so many are looked at.
_CHANNELS = 3

# Share of the cells that tell enough alone, away from 0 and full scale.
_ENOUGH_INSIDE = 0.2

# Noise that is smaller is lost in the steps of an 8-bit file.
_LEAST = 0.5 / 255


def is_correlated_on_grid(planes: NDArray[np.float32], filled: NDArray[np.bool_]) -> bool:
    """Tell whether neighbouring cells of a grid have noise in common.

    Means of 2 x 2 cells have half the noise of single cells if that is independent. Differences of channels are looked
    at, for these hold few edges and little texture, and it is there that pictures are compressed most; all of them,
    because edges in some differences look like such noise. Rich texture does in all of them, but it does not make the
    finest differences of channels smaller than the channels' own noise.

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
    planes = planes[:_CHANNELS]
    # Where noise was cut off there is less of it, in differences and in means of some cells each in its own way.
    inside = filled & ((planes > 0) & (planes < 1)).all(axis=0)
    if np.count_nonzero(inside) > _ENOUGH_INSIDE * np.count_nonzero(filled):
        filled = inside
    sigma = estimate_sigma_on_grid(planes, filled)
    pairs = list(combinations(range(len(sigma)), 2))
    return bool(pairs) and all(
        _is_correlated(
            (1 + planes[one] - planes[other]) / 2, filled, float(np.hypot(*sigma[[one, other]])) / 2
        )
        for one, other in pairs
    )


def _is_correlated(plane: NDArray[np.float32], filled: NDArray[np.bool_], independent: float) -> bool:
    """Tell so for half the difference of two channels, and the noise that it has if theirs is independent."""
    rows, columns = (size // 2 * 2 for size in filled.shape)
    shape = (rows // 2, 2, columns // 2, 2)
    blocks = np.asarray(filled[:rows, :columns].reshape(shape).all(axis=(1, 3)))
    means = plane[:rows, :columns].reshape(shape).mean(axis=(1, 3))
    fine = estimate_sigma_on_grid(plane[None], filled)[0]
    coarse = 2 * estimate_sigma_on_grid(means[None], blocks)[0]
    most = _SUSPICIOUS if independent > _MISSING * fine else _MOST
    return bool(coarse > max(most * fine, _LEAST))
