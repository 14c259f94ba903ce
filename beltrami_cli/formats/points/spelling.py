"""New colours in a text, spelled as the old ones are."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.tokens import exchange_tokens

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.document import Bytes

_DIGITS = 6  # of full scale at least: as fine as 20 bits
_WHOLE = b"%.0f"
_MOST = 9  # of full scale: all that single precision has


def respelled(
    data: bytes,
    starts: NDArray[np.int64],
    ends: NDArray[np.int64],
    before: NDArray[np.float32],
    after: NDArray[np.float32],
    scale: float,
) -> list[Bytes]:
    """Exchange the numbers that changed, and keep every other byte.

    Parameters
    ----------
    data : bytes
        The file.
    starts, ends : ndarray of int64, shape (P, C)
        Where the colours stand.
    before, after : ndarray of float32, shape (P, C)
        Old and new colours, full scale 1.
    scale : float
        The stored number that is full scale.

    Returns
    -------
    list of bytes-like
        The new file, in pieces. Where all old numbers are whole the new ones are; else they have as many decimals as
        the old ones have at most, within what single precision can tell.
    """
    style = _style(data, starts.ravel(), ends.ravel(), scale) if after.size else b""
    values = after.astype(np.float64) * scale
    changed = after != before
    if style == _WHOLE:
        values = np.rint(values) + 0.0  # no -0
        changed &= values != np.rint(before.astype(np.float64) * scale)
    if not changed.any():
        return [data]
    order = np.argsort(starts[changed])  # blue may stand before red
    numbers = values[changed][order]

    def spell(block: slice) -> list[bytes]:
        return [style % value for value in numbers[block].tolist()]

    return [*exchange_tokens(data, starts[changed][order], ends[changed][order], spell)]


def _style(data: bytes, starts: NDArray[np.int64], ends: NDArray[np.int64], scale: float) -> bytes:
    characters = np.frombuffer(data, np.uint8)
    points = np.append(np.flatnonzero(characters == ord(".")), len(data))
    decimals = int((ends - points[np.searchsorted(points, starts)] - 1).max())
    exponents = np.append(np.flatnonzero((characters | 0x20) == ord("e")), len(data))
    if (exponents[np.searchsorted(exponents, starts)] < ends).any():
        return b"%%.%dg" % _MOST
    if decimals < 0 and scale > 1:
        return _WHOLE
    left = int(np.floor(np.log10(scale)))  # digits before the point, but for one
    return b"%%.%df" % min(max(decimals, _DIGITS - left, 0), max(_MOST - left, 0))
