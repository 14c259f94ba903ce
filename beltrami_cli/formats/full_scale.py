"""Which stored number is full scale, where a file does not say: 1, or the largest number of a bit depth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import DTypeLike

from beltrami_cli.arrays import Array, Float32s, Float64s
from beltrami_cli.errors import InputError
from beltrami_cli.surface.colour_values import limits_of

BYTE = 255.0
_MAX_FLOAT_COLOUR = 16.0  # four stops above white: float colours beyond are taken to be of 0..255

# Full scales of 8, 10, 12 and 16 bit, and for intensities of 14 bit. Colours up to 16383 may be a dark 16-bit image,
# which 14 bit would make four times too bright in another format; in 16 bit, colours up to 4095 would be nearly black.
_COLOUR_SCALES = (BYTE, 1023.0, 4095.0, 65535.0)
INTEGER_SCALES = (BYTE, 1023.0, 4095.0, 16383.0, 65535.0)

# Quantile of the non-zero colours that determines the range of float colours: larger values may be fireflies.
_RANGE_QUANTILE = 0.99
# Largest rounding error, in 8-bit levels, of numbers in 0..1 with five decimals.
_LEVEL_TOLERANCE = 0.5e-5 * BYTE


def full_scale(colours: Float64s, name: str) -> tuple[float, str]:
    """Return the full scale of finite stored colours, shape (V, C), and a notice; "" where it is certain."""
    # 255 if all numbers are integers and some exceed 1, or if the robust maximum exceeds 16, as colours of high dynamic
    # range hardly do. Otherwise 1.
    robust = _robust_maximum(colours)
    if robust > BYTE:
        reach = f"from {colours.min():g} to {colours.max():g}"
        cause = f"vertex colours go {reach}, so that full scale is neither 1 nor 255"
        raise InputError(name, cause, "scale them to 0..1")
    largest = float(colours.max())
    if largest <= 1:
        return 1.0, ""
    if robust > _MAX_FLOAT_COLOUR or (largest <= BYTE and bool((colours % 1 == 0).all())):
        return BYTE, f"Vertex colours go up to {largest:g} and are taken for numbers of 0..255."
    notice = f"Vertex colours go up to {largest:g} and are taken for numbers of 0..1 that leave this range."
    return 1.0, notice


def _robust_maximum(values: Array) -> float:
    """Return the magnitude that only 1 % of the non-zero numbers exceed."""
    seen = np.abs(values[values != 0])
    return float(np.quantile(seen, _RANGE_QUANTILE, method="higher")) if seen.size else 0.0


def integer_scale(largest: int, kind: DTypeLike, *, is_intensity: bool = False) -> tuple[float, str]:
    """Return the full scale of integers from their type and largest magnitude, and a notice or ""."""
    stored = np.dtype(kind)
    full = float(np.iinfo(stored).max)
    scales = INTEGER_SCALES if is_intensity else _COLOUR_SCALES
    scale = next((each for each in scales if largest <= each), full)
    if scale >= full:
        return full, ""
    what = "Intensities" if is_intensity else "Colours"
    notice = f"{what} are stored as {stored}, go up to {largest}, and are taken for numbers of 0..{scale:g}."
    return scale, notice


def point_colour_scale(colours: Float64s, name: str) -> tuple[float, str]:
    """Return the same as `full_scale`, but up to 65535 for integers, as scanners write them."""
    scale = _smallest_integer_scale(colours, _COLOUR_SCALES)
    if scale is None:
        return full_scale(colours, name)
    notice = f"Colours go up to {colours.max():g} and are taken for numbers of 0..{scale:g}."
    return scale, notice if scale > BYTE else ""


def intensity_scale(values: Float64s) -> tuple[float, str]:
    """Return the full scale of finite intensities, shape (P, 1), and a notice or ""."""
    # 1, or the full scale of a bit depth, else the largest magnitude: it only affects reported noise and changes.
    low, high = float(values.min()), float(values.max())
    largest = max(-low, high)
    if largest <= 1:
        return 1.0, ""
    scale = _smallest_integer_scale(values, INTEGER_SCALES)
    if scale is not None:
        return scale, ""
    return largest, f"Values go from {low:g} to {high:g}; {largest:g} is taken as full scale."


def _smallest_integer_scale(values: Float64s, scales: Sequence[float]) -> float | None:
    """Return the smallest scale that holds the integers; None if they are not, some are negative, or none exceeds 1."""
    largest = float(np.abs(values).max())
    if largest <= 1 or (values % 1 != 0).any() or limits_of(values)[0] < 0:
        return None
    return next((scale for scale in scales if largest <= scale), None)


def holds_bytes(values: Float32s) -> bool:
    """Whether values of full scale 1 are 8-bit levels."""
    levels = values * np.float32(BYTE)  # to 2e-5
    return bool((np.abs(levels - np.rint(levels).clip(0, BYTE)) <= _LEVEL_TOLERANCE).all())


def opacity(alpha: Array, scale: float) -> Float32s:
    """Return opacity in [0, 1]; files whose colours are of 0..255 may store it in 0..1."""
    values: Float64s = np.nan_to_num(alpha.astype(np.float64))
    values /= scale if _robust_maximum(values) > 1 else 1
    return np.clip(values, 0, 1).astype(np.float32)
