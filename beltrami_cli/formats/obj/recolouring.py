"""New colours on the `v` lines of an OBJ file."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.tokens import exchange_tokens

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.document import Bytes

_DECIMALS = {1.0: (6, 9), 255.0: (4, 7)}  # by full scale, the least that lose nothing and the most of float32


def recoloured(
    data: bytes,
    starts: NDArray[np.int64],
    ends: NDArray[np.int64],
    colours: NDArray[np.float32],
    changed: NDArray[np.bool_],
    scale: float,
) -> list[Bytes]:
    """Exchange the tokens of the colours that changed, and keep every other byte.

    Parameters
    ----------
    data : bytes
        The file.
    starts, ends : ndarray of int64, shape (V, 3)
        Where the colours stand.
    colours : ndarray of float32, shape (V, 3)
        New colours, full scale 1.
    changed : ndarray of bool, shape (V, 3)
        Which of them differ from the old ones.
    scale : float
        The stored number that is full scale, 1 or 255.

    Returns
    -------
    list of bytes-like
        The new file, in pieces.
    """
    if not changed.any():
        return [data]
    decimals = _decimals(data, starts.ravel(), ends.ravel(), scale)
    values = colours[changed].astype(np.float64) * scale
    if decimals == 0:
        values = np.clip(np.rint(values), 0, scale)
    style = b"%%.%df" % decimals

    def spell(block: slice) -> list[bytes]:
        return [style % value for value in values[block].tolist()]

    return [*exchange_tokens(data, starts[changed], ends[changed], spell)]


def _decimals(data: bytes, starts: NDArray[np.int64], ends: NDArray[np.int64], scale: float) -> int:
    """Return how many decimals new colours get: as many as the old ones, within what is sensible."""
    points = np.append(np.flatnonzero(np.frombuffer(data, np.uint8) == ord(".")), len(data))
    found = int((ends - points[np.searchsorted(points, starts)] - 1).max())
    if found < 0 and scale != 1:
        return 0
    least, most = _DECIMALS[scale]
    return min(max(found, least), most)
