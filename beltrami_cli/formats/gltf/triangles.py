"""Triangles of a primitive, whatever its drawing mode."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

TRIANGLES, STRIP, FAN = 4, 5, 6
"""Drawing modes with faces; 0 to 3 are points and lines."""


def triangles(mode: int, corners: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the triangles that a sequence of corners draws.

    Parameters
    ----------
    mode : int
        glTF's drawing mode, 0 to 6.
    corners : ndarray of int64, shape (n,)
        Vertex indices in drawing order.

    Returns
    -------
    ndarray of int64, shape (F, 3)
        With the winding that glTF defines; none for points and lines. Triangles of strips that repeat a
        corner only join parts of the strip and are left out.
    """
    if mode == TRIANGLES:
        return corners[: len(corners) // 3 * 3].reshape(-1, 3)
    if mode not in (STRIP, FAN) or len(corners) < 3:
        return np.empty((0, 3), np.int64)
    first = np.arange(len(corners) - 2)
    if mode == FAN:
        return corners[np.stack([first + 1, first + 2, np.zeros_like(first)], axis=1)]
    odd = first % 2
    faces = corners[np.stack([first, first + 1 + odd, first + 2 - odd], axis=1)]
    a, b, c = faces.T
    whole: NDArray[np.int64] = faces[(a != b) & (b != c) & (c != a)]
    return whole
