"""How different colours and images look: CIEDE2000 and structural similarity.

References
----------
.. [1] G. Sharma, W. Wu, E. Dalal, "The CIEDE2000 color-difference formula: implementation notes, supplementary test
   data, and mathematical observations", Color Research and Application 30 (2005), doi:10.1002/col.20070; the numbers
   of equations are of this paper, except for those of SSIM.
.. [2] IEC 61966-2-1:1999, sRGB: the primaries and the white point D65.
.. [3] CIE 15:2004, "Colorimetry": L*a*b*.
.. [4] Z. Wang, A. Bovik, H. Sheikh, E. Simoncelli, "Image quality assessment: from error visibility to structural
   similarity", IEEE Transactions on Image Processing 13 (2004), doi:10.1109/TIP.2003.819861: SSIM.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.arrays import Bools, Float32s, Float64s

# Linear sRGB -> XYZ [2]; rows add up to the white point.
_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
_CUBE_ROOT_FROM = (6 / 29) ** 3
_25_TO_7 = 25.0**7
# Half a turn in degrees, and what rounding adds to the difference of hues that are exactly opposite.
_OPPOSITE = 180 + 1e-9
# Section III-C of [4]: a Gaussian window of 11 x 11 with a deviation of 1.5, K1 and K2; full scale is 1.
_RADIUS, _DEVIATION = 5, 1.5
_C1, _C2 = 0.01**2, 0.03**2


def cie_lab(linear: NDArray[np.floating]) -> Float64s:
    """Convert linear sRGB to CIE L*a*b* under D65."""
    xyz = np.maximum(linear, 0).astype(np.float64) @ (_XYZ / _XYZ.sum(axis=1, keepdims=True)).T
    f = np.where(xyz > _CUBE_ROOT_FROM, np.cbrt(xyz), xyz * (29 / 6) ** 2 / 3 + 4 / 29)
    x, y, z = f.T
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=1)


def delta_e_2000(one: Float64s, other: Float64s) -> Float64s:
    """Compute the CIEDE2000 difference of pairs of colours [1]_, with k_L = k_C = k_H = 1."""
    (l1, c1, h1), (l2, c2, h2) = _with_hue(one, other)
    dl, dc = l2 - l1, c2 - c1  # eqs. (8), (9)
    turn = np.where(np.abs(h2 - h1) <= _OPPOSITE, h2 - h1, h2 - h1 - 360 * np.sign(h2 - h1))
    turn = np.where(c1 * c2 == 0, 0.0, turn)  # eq. (10)
    dh = 2 * np.sqrt(c1 * c2) * np.sin(np.radians(turn) / 2)  # eq. (11)
    lightness, chroma = (l1 + l2) / 2, (c1 + c2) / 2  # eqs. (12), (13)
    hue = np.where(c1 * c2 == 0, h1 + h2, _mean_hue(h1, h2))
    t = (
        1
        - 0.17 * np.cos(np.radians(hue - 30))
        + 0.24 * np.cos(np.radians(2 * hue))
        + 0.32 * np.cos(np.radians(3 * hue + 6))
        - 0.20 * np.cos(np.radians(4 * hue - 63))
    )  # eq. (15)
    off = (lightness - 50) ** 2
    s_l = 1 + 0.015 * off / np.sqrt(20 + off)  # eqs. (18) to (20)
    s_c, s_h = 1 + 0.045 * chroma, 1 + 0.015 * chroma * t
    rotation = 60 * np.exp(-(((hue - 275) / 25) ** 2))  # twice eq. (16)
    r_t = -np.sin(np.radians(rotation)) * 2 * np.sqrt(chroma**7 / (chroma**7 + _25_TO_7))  # eqs. (17), (21)
    parts = dl / s_l, dc / s_c, dh / s_h
    squares = parts[0] ** 2 + parts[1] ** 2 + parts[2] ** 2 + r_t * parts[1] * parts[2]
    return np.asarray(np.sqrt(np.maximum(squares, 0)), np.float64)  # eq. (22)


def _with_hue(*colours: Float64s) -> list[tuple[Float64s, ...]]:
    """Return lightness, chroma and hue in degrees of both colours, with a* stretched where chroma is small."""
    mean = sum(np.hypot(lab[:, 1], lab[:, 2]) for lab in colours) / 2  # eqs. (2), (3)
    stretch = 1 + 0.5 * (1 - np.sqrt(mean**7 / (mean**7 + _25_TO_7)))  # eqs. (4), (5)
    found: list[tuple[Float64s, ...]] = []
    # Side by side: how NumPy 2.0 rounds arctan2 of other arrays depends on where in memory they lie.
    for lightness, a, b in (np.ascontiguousarray(lab.T) for lab in colours):
        stretched = stretch * a
        hue = np.degrees(np.arctan2(b, stretched)) % 360  # eqs. (6), (7)
        found.append((lightness, np.hypot(stretched, b), hue))
    return found


def _mean_hue(h1: Float64s, h2: Float64s) -> Float64s:
    """Return the mean of two hues on the shorter way around, eq. (14)."""
    total = h1 + h2
    around = np.where(total < 360, total + 360, total - 360)
    return np.asarray(np.where(np.abs(h1 - h2) <= _OPPOSITE, total, around) / 2, np.float64)


def structural_similarity(reference: Float32s, test: Float32s, counts: Bools) -> float | None:
    """Compute the mean SSIM, eqs. (13) and (17) of [4], over all windows that hold only pixels that count."""
    from scipy.ndimage import minimum_filter

    whole = minimum_filter(counts, 2 * _RADIUS + 1, mode="constant", cval=False)
    if not whole.any():
        return None
    channels = zip(np.moveaxis(reference, 2, 0), np.moveaxis(test, 2, 0), strict=True)
    return float(np.mean([_of_channel(one, other)[whole].mean() for one, other in channels]))


def _of_channel(one: Float32s, other: Float32s) -> Float64s:
    x, y = one.astype(np.float64), other.astype(np.float64)
    mean_x, mean_y = _windowed(x), _windowed(y)
    variances = _windowed(x * x) - mean_x**2 + _windowed(y * y) - mean_y**2
    covariance = _windowed(x * y) - mean_x * mean_y
    alike = (2 * mean_x * mean_y + _C1) * (2 * covariance + _C2)
    return np.asarray(alike / ((mean_x**2 + mean_y**2 + _C1) * (variances + _C2)), np.float64)


def _windowed(values: Float64s) -> Float64s:
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(values, _DEVIATION, radius=_RADIUS), np.float64)
