"""The size of a surface, which must leave room for the squares of its distances in single precision."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Squares of lengths are kept in single precision, which ends at 1.2e-38 and 3.4e38: lengths at 1e-19 and 2e19. Texels
# and the edges of a mesh vary, and kernels reach further; with five decades between there is room for all of them.
_LEAST, _MOST = 1e-14, 1e14
_ENOUGH_FACES = 100_000  # for a median that is off by a per cent or so


def check_scale(positions: NDArray[np.float64], faces: NDArray[np.int32], name: str) -> None:
    """Refuse a surface whose distances are too small or too large to be computed with.

    Parameters
    ----------
    positions : ndarray of float64, shape (V, M)
        Vertex positions; those that are not finite do not count.
    faces : ndarray of int32, shape (F, 3)
        Triangles. Without any, points count as if they were spread evenly.
    name : str
        The file, for the message.

    Raises
    ------
    InputError
        If the median length of the edges is beyond 1e-14 and 1e14 units. Edges without length do not count, nor does
        a surface that has no others.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        steps = _edges(positions, faces) if len(faces) else _spread(positions)
    steps = steps[steps > 0]
    if not len(steps):
        return
    # The upper median: numpy.median imports more of NumPy than a small mesh takes to be smoothed.
    typical = float(np.partition(steps, len(steps) // 2)[len(steps) // 2])
    if _LEAST <= typical <= _MOST:
        return
    told = f"{typical:.0e}" if np.isfinite(typical) else "more than 1e+308"
    what = "edges are" if len(faces) else "points are apart"
    kind = "small" if typical < _LEAST else "large"
    cause = f"its {what} {told} units, which is too {kind} to be squared in single precision"
    raise InputError(name, cause, "scale it, for example to metres")


def _edges(positions: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return the longest coordinate of the edges of some faces: squares could overflow here already."""
    corners = positions[faces[:: 1 + len(faces) // _ENOUGH_FACES]]
    steps: NDArray[np.float64] = np.abs(corners - np.roll(corners, 1, axis=1)).max(axis=2)
    return steps[np.isfinite(corners).all(axis=(1, 2))]


def _spread(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far points are apart if they are spread evenly over a surface as wide as they are."""
    there = positions[np.isfinite(positions).all(axis=1)]
    if not len(there):
        return np.empty(0)
    return np.array([(there.max(axis=0) - there.min(axis=0)).max() / np.sqrt(len(there))])
