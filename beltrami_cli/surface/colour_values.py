"""Stored colours as numbers: the sRGB transfer function, and rounding to integers.

Full scale is 1. Negative values are treated odd-symmetrically, and values above 1 by the same formula, so that nothing
is clipped.

References
----------
.. [1] IEC 61966-2-1:1999, "Colour measurement and management - Default RGB colour space - sRGB".
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from beltrami_cli.arrays import Array, Float32s, Float64s
    from beltrami_cli.surface.atlas import Indices


_SLOPE = 12.92  # of the straight piece near black
_OFFSET = 0.055
_EXPONENT = 2.4
_KNEE_SRGB = 0.04045  # where the standard lets the straight piece end, on either side
_KNEE_LINEAR = 0.0031308


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


def store_integers(
    table: Array, pixels: Indices, values: Float32s, channels: Sequence[int], threads: int
) -> tuple[float, float, float]:
    """Put values into pixels of integers, in place; return sum, sum of squares and maximum of the changes."""
    # What is beyond full scale is clipped; what is no number becomes 0.
    from beltrami_cli._native import store_colours

    rows, columns = np.ascontiguousarray(values), np.array(channels, np.int32)
    total, squares, largest = store_colours(table, pixels, rows, columns, threads)
    one = float(np.iinfo(table.dtype).max)
    return total / one, squares / one**2, largest / one
