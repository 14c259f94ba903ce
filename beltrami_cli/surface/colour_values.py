"""Numeric colours: sRGB transfer function, colour spaces, limits, and storage as integers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beltrami_cli._native import store_colours
from beltrami_cli.arrays import Array, Float32s, Float64s, Indices
from beltrami_cli.errors import UsageError
from beltrami_cli.surface.precision import require_finite
from beltrami_cli.surface.records import Encoding

_SLOPE = 12.92  # of the linear segment near black
_OFFSET = 0.055
_EXPONENT = 2.4
_KNEE_SRGB = 0.04045  # end of the linear segment in the standard, on either side
_KNEE_LINEAR = 0.0031308

# Maximum share of samples beyond 0 or full scale for these to be limits, in view of spikes and rounding.
_MAX_SHARE_BEYOND = 1e-3

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def srgb_to_linear(values: ArrayLike) -> NDArray[np.floating[Any]]:
    """Convert display values to linear light in double precision; float32 stays float32."""
    size = np.abs(np.asarray(values, np.float64))
    curve = ((size + _OFFSET) / (1 + _OFFSET)) ** _EXPONENT
    return _signed(np.where(size <= _KNEE_SRGB, size / _SLOPE, curve), values)


def linear_to_srgb(values: ArrayLike) -> NDArray[np.floating[Any]]:
    """Convert linear light to display values in double precision; float32 stays float32."""
    size = np.abs(np.asarray(values, np.float64))
    curve = (1 + _OFFSET) * size ** (1 / _EXPONENT) - _OFFSET
    return _signed(np.where(size <= _KNEE_LINEAR, size * _SLOPE, curve), values)


def _signed(size: Float64s, given: ArrayLike) -> NDArray[np.floating[Any]]:
    values: Float64s = np.copysign(size, given)
    return values.astype(np.float32) if np.asarray(given).dtype == np.float32 else values


def limits_of(colours: Array) -> tuple[float, float]:
    """Return the limits at which noise is clipped: 0 and 1, or infinity if more than a few samples are beyond."""
    few, low, high = _MAX_SHARE_BEYOND * colours.size, 0.0, 1.0
    if colours.min(initial=0) < 0 and np.count_nonzero(colours < 0) > few:
        low = -np.inf
    if colours.max(initial=1) > 1 and np.count_nonzero(colours > 1) > few:
        high = np.inf
    return low, high


# B. Ottosson, "A perceptual color space for image processing" (2020): linear sRGB -> cone response -> Lab.
_CONES = np.array(
    [
        [0.4122214708, 0.5363325363, 0.0514459929],
        [0.2119034982, 0.6806995451, 0.1073969566],
        [0.0883024619, 0.2817188376, 0.6299787005],
    ]
)
_LAB = np.array(
    [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ]
)


def to_space(colours: Float32s, encoding: Encoding, space: str, unit: float = 1.0) -> Float32s:
    """Convert stored colours, shape (S, C), to the working space, divided by `unit`; "data" is not converted."""
    if unit != 1:
        colours = colours / np.float32(unit)
    if space in ("data", encoding):
        return colours
    if space == "oklab":
        _require_three(colours)
        linear = _light_of(colours) if encoding == "srgb" else colours
        return np.asarray(np.cbrt(linear @ _CONES.T) @ _LAB.T, np.float32)
    return np.asarray(_light_of(colours) if space == "linear" else linear_to_srgb(colours), np.float32)


def _light_of(colours: Float32s) -> Float32s:
    """Return sRGB colours as linear light; InputError if the power of 2.4 overflows single precision."""
    with np.errstate(over="ignore"):
        linear = np.asarray(srgb_to_linear(colours), np.float32)
    require_finite(
        np.where(np.isfinite(colours), linear, 0), "the colours", "in linear light, that of sample"
    )
    return linear


def from_space(colours: Float32s, encoding: Encoding, space: str, unit: float = 1.0) -> Float32s:
    """Convert working colours, shape (S, C), to stored ones; the inverse of `to_space`."""
    if unit != 1:
        return from_space(colours, encoding, space) * np.float32(unit)
    if space in ("data", encoding):
        return colours
    if space == "oklab":
        _require_three(colours)
        linear = (colours @ np.linalg.inv(_LAB).T) ** 3 @ np.linalg.inv(_CONES).T
        converted = linear_to_srgb(linear) if encoding == "srgb" else linear
    else:
        converted = linear_to_srgb(colours) if encoding == "srgb" else srgb_to_linear(colours)
    return np.asarray(converted, np.float32)


def unit_in_space(unit: float, encoding: Encoding, space: str) -> float:
    """Return the divisor of working colours that corresponds to a divisor of stored colours.

    In sRGB this holds above the linear segment of the curve, which ends at 0.04.
    """
    if space in ("data", encoding):
        return unit
    light = unit if encoding == "linear" else unit**_EXPONENT
    return float(light ** {"linear": 1, "srgb": 1 / _EXPONENT, "oklab": 1 / 3}[space])


def _require_three(colours: Float32s) -> None:
    if colours.shape[1] != 3:
        raise UsageError(
            f"the space oklab needs red, green and blue, but there are {colours.shape[1]} channels; "
            "choose --space srgb, linear or data"
        )


def store_integers(
    table: Array, pixels: Indices, values: Float32s, channels: Sequence[int], threads: int
) -> tuple[float, float, float]:
    """Write values to integer pixels, in place; return sum, sum of squares and maximum of the changes."""
    # Values beyond full scale are clipped, and NaN becomes 0.
    rows, columns = np.ascontiguousarray(values), np.array(channels, np.int32)
    total, squares, largest = store_colours(table, pixels, rows, columns, threads)
    one = float(np.iinfo(table.dtype).max)
    return total / one, squares / one**2, largest / one
