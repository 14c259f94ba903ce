"""How different two colours look (CIEDE2000), and how similar two images are (SSIM).

References
----------
.. [1] G. Sharma, W. Wu, E. Dalal, "The CIEDE2000 color-difference formula: implementation notes, supplementary test
   data, and mathematical observations", Color Research and Application 30 (2005), doi:10.1002/col.20070; the numbers
   of equations are of this paper, except for SSIM.
.. [2] IEC 61966-2-1:1999, sRGB: the primaries and the white point D65.
.. [3] CIE 15:2004, "Colorimetry": L*a*b*.
.. [4] Z. Wang, A. Bovik, H. Sheikh, E. Simoncelli, "Image quality assessment: from error visibility to structural
   similarity", IEEE Transactions on Image Processing 13 (2004), doi:10.1109/TIP.2003.819861: SSIM.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Bools, Float32s, Float64s
from beltrami_cli.flow.parameters import Space
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.colour_values import srgb_to_linear
from beltrami_cli.surface.gutters import within

# Linear sRGB -> XYZ [2]; rows add up to the white point.
_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
_CUBE_ROOT_FROM = (6 / 29) ** 3
_25_TO_7 = 25.0**7
# Half a turn in degrees, and what rounding adds to the difference of hues that are exactly opposite.
_HALF_TURN = 180 + 1e-9
# Section III-C of [4]: a Gaussian window of 11 x 11 with a deviation of 1.5, K1 and K2; full scale is 1.
_RADIUS, _DEVIATION = 5, 1.5
_C1, _C2 = 0.01**2, 0.03**2
# The side of a square of windows that are worked on at a time, for the same reasons as `_BLOCK` in `measured.py`.
_SQUARE = 88


def cie_lab(linear: NDArray[np.floating]) -> Float64s:
    """Convert linear sRGB to CIE L*a*b* under D65."""
    xyz = np.maximum(linear, 0).astype(np.float64) @ (_XYZ / _XYZ.sum(axis=1, keepdims=True)).T
    f = np.where(xyz > _CUBE_ROOT_FROM, np.cbrt(xyz), xyz * (29 / 6) ** 2 / 3 + 4 / 29)
    x, y, z = f.T
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=1)


def delta_e_2000(one: Float64s, other: Float64s) -> Float64s:
    """Compute the CIEDE2000 difference of pairs of colours [1]_, with k_L = k_C = k_H = 1."""
    (l1, c1, h1), (l2, c2, h2) = _with_hue(one, other)
    dl, dc, is_grey = l2 - l1, c2 - c1, c1 * c2 == 0  # eqs. (8), (9)
    turn = h2 - h1
    turn = np.where(np.abs(turn) <= _HALF_TURN, turn, turn - 360 * np.sign(turn))
    turn = np.where(is_grey, 0.0, turn)  # eq. (10)
    dh = 2 * np.sqrt(c1 * c2) * np.sin(np.radians(turn) / 2)  # eq. (11)
    lightness, chroma = (l1 + l2) / 2, (c1 + c2) / 2  # eqs. (12), (13)
    hue = np.where(is_grey, h1 + h2, (h1 + turn / 2) % 360)  # eq. (14)
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
    r_t = -np.sin(np.radians(rotation)) * 2 * _near_grey(chroma)  # eqs. (17), (21)
    parts = dl / s_l, dc / s_c, dh / s_h
    squares = parts[0] ** 2 + parts[1] ** 2 + parts[2] ** 2 + r_t * parts[1] * parts[2]
    return np.asarray(np.sqrt(np.maximum(squares, 0)), np.float64)  # eq. (22)


def _with_hue(*colours: Float64s) -> list[tuple[Float64s, ...]]:
    """Return lightness, chroma and hue in degrees of both colours, with a* stretched where chroma is small."""
    mean = np.mean([_length(lab[:, 1], lab[:, 2]) for lab in colours], axis=0)  # eqs. (2), (3)
    stretch = 1 + 0.5 * (1 - _near_grey(mean))  # eqs. (4), (5)
    found: list[tuple[Float64s, ...]] = []
    # Side by side: how NumPy 2.0 rounds arctan2 of other arrays depends on where in memory they lie.
    for lightness, a, b in (np.ascontiguousarray(lab.T) for lab in colours):
        stretched = stretch * a
        angle = np.degrees(np.arctan2(b, stretched))  # eqs. (6), (7)
        found.append((lightness, _length(stretched, b), np.where(angle < 0, angle + 360, angle)))
    return found


def _length(a: Float64s, b: Float64s) -> Float64s:
    return np.asarray(np.sqrt(a * a + b * b))  # nothing overflows, and hypot takes five times as long


def _near_grey(chroma: Float64s) -> Float64s:
    """Return sqrt(C^7 / (C^7 + 25^7))."""
    square = chroma * chroma
    seventh = square * square * square * chroma
    return np.asarray(np.sqrt(seventh / (seventh + _25_TO_7)))


def colour_differences(reference: Float32s, test: Float32s, space: Space) -> Float64s:
    """Compute how different colours look, shape (S,); NaN if they are not colours."""
    if space not in ("srgb", "linear") or reference.shape[1] not in (1, 3):
        return np.full(len(reference), np.nan)
    light = (srgb_to_linear(each) if space == "srgb" else each for each in (reference, test))
    return delta_e_2000(*(cie_lab(np.broadcast_to(each, (len(each), 3))) for each in light))


def structural_similarity(
    read: Callable[[slice], tuple[Float32s, Float32s]],
    counts: Bools,
    tick: Callable[[float], None] = lambda share: None,
) -> float | None:
    """Compute the mean SSIM, eqs. (13) and (17) of [4], over all windows that hold only pixels that count.

    `read` gives rows of both images, shape (R, W, N).
    """
    inside = slice(_RADIUS, -_RADIUS)
    whole = ~within(~counts, _RADIUS)[inside, inside]
    total, windows = 0.0, 0
    for rows in large_arrays.blocks(len(whole), _SQUARE):
        tick(rows.start / len(whole))
        columns = [
            block for block in large_arrays.blocks(whole.shape[1], _SQUARE) if whole[rows, block].any()
        ]
        if not columns:
            continue
        pair = [
            np.moveaxis(image, 2, 0).astype(np.float64)
            for image in read(slice(rows.start, rows.stop + 2 * _RADIUS))
        ]
        for block in columns:
            around = slice(block.start, block.stop + 2 * _RADIUS)
            similarity = _similarity(*(image[:, :, around] for image in pair))[:, whole[rows, block]]
            total, windows = total + float(similarity.sum()), windows + similarity.size
    return total / windows if windows else None


def _similarity(x: Float64s, y: Float64s) -> Float64s:
    mean_x, mean_y = _windowed(x), _windowed(y)
    squares, product = mean_x * mean_x + mean_y * mean_y, 2 * mean_x * mean_y
    variances, covariance = _windowed(x * x + y * y) - squares, 2 * _windowed(x * y) - product
    return (product + _C1) * (covariance + _C2) / ((squares + _C1) * (variances + _C2))


def _windowed(values: Float64s) -> Float64s:
    """Return the weighted means over the windows that lie within images, shape (N, R, W)."""
    from scipy.ndimage import gaussian_filter

    means = gaussian_filter(values, _DEVIATION, radius=_RADIUS, axes=(1, 2))
    return means[:, _RADIUS:-_RADIUS, _RADIUS:-_RADIUS]
