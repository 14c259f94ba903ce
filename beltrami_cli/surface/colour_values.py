"""Colours as numbers: the sRGB transfer function, the limits of colours, and values drawn as colours."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Uint8s

_SLOPE = 12.92  # of the straight piece near black
_OFFSET = 0.055
_EXPONENT = 2.4
_KNEE_SRGB = 0.04045  # where the standard lets the straight piece end, on either side
_KNEE_LINEAR = 0.0031308
# Every tenth part of the colour map viridis: its lightness grows evenly, also for the colour-blind and in grey.
# S. van der Walt, N. Smith, "A better default colormap for matplotlib" (2015), in the public domain (CC0).
VIRIDIS = np.array([
    [0.267, 0.005, 0.329], [0.283, 0.141, 0.458], [0.254, 0.265, 0.530], [0.207, 0.372, 0.553],
    [0.164, 0.471, 0.558], [0.128, 0.567, 0.551], [0.135, 0.659, 0.518], [0.267, 0.749, 0.441],
    [0.478, 0.821, 0.318], [0.741, 0.873, 0.150], [0.993, 0.906, 0.144],
])  # fmt: skip
# The greys of a painting where there is no value: neither black nor white.
_GREY_FROM, _GREY_TO = 0.35, 0.9

# Share of samples beyond 0 or full scale up to which these are limits: single spikes and rounding prove nothing.
_FEW_BEYOND = 1e-3

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def srgb_to_linear(values: ArrayLike) -> NDArray[np.floating[Any]]:
    """Turn display values into linear light, in double precision; float32 stays float32."""
    given, size = _magnitude(values)
    curve = ((size + _OFFSET) / (1 + _OFFSET)) ** _EXPONENT
    return _signed(np.where(size <= _KNEE_SRGB, size / _SLOPE, curve), given)


def linear_to_srgb(values: ArrayLike) -> NDArray[np.floating[Any]]:
    """Turn linear light into display values, in double precision; float32 stays float32."""
    given, size = _magnitude(values)
    curve = (1 + _OFFSET) * size ** (1 / _EXPONENT) - _OFFSET
    return _signed(np.where(size <= _KNEE_LINEAR, size * _SLOPE, curve), given)


def _magnitude(values: ArrayLike) -> tuple[Array, Float64s]:
    given = np.asarray(values)
    return given, np.abs(given.astype(np.float64))


def _signed(size: Float64s, given: Array) -> NDArray[np.floating[Any]]:
    values: Float64s = np.copysign(size, given)
    return values.astype(np.float32) if given.dtype == np.float32 else values


def limits_of(colours: Array) -> tuple[float, float]:
    """Return where noise of colours is cut off: at 0 and 1, or at infinity where more than a few lie beyond."""
    few, low, high = _FEW_BEYOND * colours.size, 0.0, 1.0
    if colours.min(initial=0) < 0 and np.count_nonzero(colours < 0) > few:
        low = -np.inf
    if colours.max(initial=1) > 1 and np.count_nonzero(colours > 1) > few:
        high = np.inf
    return low, high


def at_limits(colours: Float32s) -> Bools:
    """Return which colours are 0 or full scale, as those whose noise was cut off; others show theirs."""
    return np.asarray((colours == 0) | (colours == 1))


def colour_by_value(values: Float32s, painting: Float32s, known: Bools) -> Float64s:
    """Colour values in [0, 1], of any shape, by viridis; where none is known, the painting's grey shows."""
    at = np.clip(np.where(known, values, 0), 0, 1)
    steps = np.linspace(0, 1, len(VIRIDIS))
    colours = np.stack([np.interp(at, steps, channel) for channel in VIRIDIS.T], axis=-1)
    grey = _GREY_FROM + (_GREY_TO - _GREY_FROM) * (painting.astype(np.float64) @ _LUMINANCE)
    return np.where(known[..., None], colours, grey[..., None])


def as_bytes(colours: Float64s) -> Uint8s:
    """Round display values in [0, 1] to bytes."""
    return np.rint(255 * colours).astype(np.uint8)
