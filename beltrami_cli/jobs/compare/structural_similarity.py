"""How alike two images are in structure: SSIM, over the part of them that counts.

References
----------
.. [1] Z. Wang, A. Bovik, H. Sheikh, E. Simoncelli, "Image quality assessment: from error visibility to structural
   similarity", IEEE Transactions on Image Processing 13 (2004), doi:10.1109/TIP.2003.819861
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Section III-C of [1]: a Gaussian window of 11 x 11 with a deviation of 1.5, K1 and K2; full scale is 1.
_RADIUS, _DEVIATION = 5, 1.5
_C1, _C2 = 0.01**2, 0.03**2


def structural_similarity(
    reference: NDArray[np.float32], test: NDArray[np.float32], counts: NDArray[np.bool_]
) -> float | None:
    """Compute the mean SSIM, eqs. (13) and (17) of [1]_, over all windows that hold only pixels that count.

    Parameters
    ----------
    reference, test : ndarray of float32, shape (H, W, N)
        Full scale 1. The mean is taken over the channels too.
    counts : ndarray of bool, shape (H, W)
        Which pixels count.

    Returns
    -------
    float or None
        1 if they are equal; None if no window holds only pixels that count.
    """
    from scipy.ndimage import minimum_filter

    whole = minimum_filter(counts, 2 * _RADIUS + 1, mode="constant", cval=False)
    if not whole.any():
        return None
    channels = zip(np.moveaxis(reference, 2, 0), np.moveaxis(test, 2, 0), strict=True)
    return float(np.mean([_of_channel(one, other)[whole].mean() for one, other in channels]))


def _of_channel(one: NDArray[np.float32], other: NDArray[np.float32]) -> NDArray[np.float64]:
    x, y = one.astype(np.float64), other.astype(np.float64)
    mean_x, mean_y = _windowed(x), _windowed(y)
    variances = _windowed(x * x) - mean_x**2 + _windowed(y * y) - mean_y**2
    covariance = _windowed(x * y) - mean_x * mean_y
    alike = (2 * mean_x * mean_y + _C1) * (2 * covariance + _C2)
    return np.asarray(alike / ((mean_x**2 + mean_y**2 + _C1) * (variances + _C2)), np.float64)


def _windowed(values: NDArray[np.float64]) -> NDArray[np.float64]:
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(values, _DEVIATION, radius=_RADIUS), np.float64)
