"""What every painted mesh must fulfil before anything is computed on it, and its arrays from input of any type."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import InputError, UsageError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from beltrami_cli.arrays import Array, Float32s, Float64s, Int32s
    from beltrami_cli.surface.records import PaintedVertices


def check_mesh(painted: PaintedVertices, name: str) -> None:
    """Check shapes, indices, finiteness, and that distances are not too small or large; InputError if not."""
    positions, faces, colours = painted.positions, painted.faces, painted.colours
    if positions.ndim != 2 or positions.shape[1] == 0:
        raise InputError(name, f"positions must be of shape (V, M), not {positions.shape}")
    if len(positions) != len(colours):
        raise InputError(name, f"there are {len(positions)} positions but {len(colours)} colours")
    if faces.size and (faces.min() < 0 or faces.max() >= len(positions)):
        raise InputError(name, f"a face names a vertex outside 0 to {len(positions) - 1}")
    _check_finite(positions, "position", name)
    _check_finite(colours, "colour", name)
    check_scale(positions, faces, name)


def position_table(positions: ArrayLike) -> Float64s:
    """Take positions of any numeric type, shape (V, M); an empty list has M = 3."""
    table = array_of(positions, "positions")
    if table.shape == (0,):
        table = table.reshape(0, 3)
    if table.ndim != 2 or table.shape[1] == 0 or table.dtype.kind not in "uif":
        raise UsageError(f"positions must be numbers of shape (V, M), not {_described(table)}")
    with np.errstate(over="ignore"):  # what is too large becomes infinite, and `check_mesh` names it
        return np.ascontiguousarray(table, np.float64)


def face_table(faces: ArrayLike, count: int) -> Int32s:
    """Take triangles of any integer type, shape (F, 3), indices in [0, count); nothing wraps or is cut off."""
    table = array_of(faces, "faces")
    if table.shape in ((0,), (0, 3)):
        return np.empty((0, 3), np.int32)
    if table.ndim != 2 or table.shape[1] != 3:
        raise UsageError(f"faces must be triangles, of shape (F, 3), not {_described(table)}")
    if table.dtype.kind not in "ui":
        raise UsageError(f"faces must be whole numbers, not {_described(table)}")
    wrong = ((table < 0) | (table >= count)).any(axis=1)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise UsageError(f"face {row} is {table[row].tolist()}, but there are {count} vertices, from 0 on")
    return np.ascontiguousarray(table, np.int32)


def colour_table(colours: ArrayLike) -> Float32s:
    """Take colours, shape (V, C) or (V,): floats as they are, unsigned integers by their full scale."""
    table = array_of(colours, "colours")
    if table.ndim == 1:
        table = table[:, None] if len(table) else table.reshape(0, 3)
    if table.ndim != 2 or table.shape[1] == 0 or table.dtype.kind not in "uif":
        raise UsageError(f"colours must be numbers of shape (V, C), not {_described(table)}")
    if table.dtype.kind == "f":
        with np.errstate(over="ignore"):
            return np.ascontiguousarray(table, np.float32)
    # Of other integers nobody knows the full scale: a list of 0 to 255 becomes int64.
    if table.dtype not in (np.uint8, np.uint16, np.uint32):
        raise UsageError(
            f"colours of type {table.dtype} have no full scale; give uint8, as 0 to 255, or floats, as 0 to 1"
        )
    return np.ascontiguousarray(table / np.iinfo(table.dtype).max, np.float32)


def guide_table(values: ArrayLike, shape: tuple[int, ...], name: str = "guide") -> Float64s:
    """Take a guide: any finite numbers of `shape`, or with channels behind it; a row a vertex or pixel."""
    table = array_of(values, name)
    if table.shape[: len(shape)] != shape or table.ndim > len(shape) + 1 or table.dtype.kind not in "buif":
        wanted = ", ".join(map(str, shape))
        raise UsageError(f"the {name} must be numbers of shape ({wanted}, G), not {_described(table)}")
    rows = table.reshape(int(np.prod(shape)), -1).astype(np.float64)
    if not np.isfinite(rows).all():
        raise UsageError(f"row {int(np.argmin(np.isfinite(rows).all(axis=1)))} of the {name} is not finite")
    return rows


def array_of(values: ArrayLike, name: str) -> Array:
    """Make an array of anything like one; UsageError, with the name, if its rows are of several lengths."""
    try:
        return np.asarray(values)
    except (TypeError, ValueError, OverflowError) as error:
        raise UsageError(f"{name} must be a table whose rows have the same length") from error


def _described(table: Array) -> str:
    return f"{table.dtype} of shape {table.shape}"


def _check_finite(table: NDArray[np.floating], what: str, name: str) -> None:
    finite = np.isfinite(table).all(axis=1)
    if not finite.all():
        raise InputError(
            name, f"the {what} of vertex {int(np.argmin(finite))} is not finite", "repair the file"
        )


# Squares of lengths are kept in single precision, which ends at 1.2e-38 and 3.4e38: lengths at 1e-19 and
# 2e19. Texels and the edges of a mesh vary, and kernels reach further; five decades of margin are enough for
# all of them.
_LEAST, _MOST = 1e-14, 1e14
_ENOUGH_FACES = 100_000  # for a median that is off by a per cent or so


def check_scale(positions: Float64s, faces: Int32s, name: str) -> None:
    """Refuse a surface whose median edge is too small or too large to be squared in single precision."""
    # Without faces, points count as if they were spread evenly.
    with np.errstate(over="ignore", invalid="ignore"):
        steps = _edges(positions, faces) if len(faces) else _spread(positions)
    steps = steps[steps > 0]
    if not len(steps):
        return
    # The upper median: numpy.median imports more of NumPy than a small mesh takes to be smoothed.
    typical = float(np.partition(steps, len(steps) // 2)[len(steps) // 2])
    if _LEAST <= typical <= _MOST:
        return
    shown = f"{typical:.0e}" if np.isfinite(typical) else "more than 1e+308"
    what = "edges are" if len(faces) else "points are apart"
    kind = "small" if typical < _LEAST else "large"
    cause = f"its {what} {shown} units, which is too {kind} to be squared in single precision"
    raise InputError(name, cause, "scale it, for example to metres")


def _edges(positions: Float64s, faces: Int32s) -> Float64s:
    """Return the longest coordinate of the edges of some faces: squares could overflow here already."""
    corners = positions[faces[:: 1 + len(faces) // _ENOUGH_FACES]]
    steps: Float64s = np.abs(corners - np.roll(corners, 1, axis=1)).max(axis=2)
    return steps[np.isfinite(corners).all(axis=(1, 2))]


def _spread(positions: Float64s) -> Float64s:
    """Return how far points are apart if they are spread evenly over a surface as wide as they are."""
    there = positions[np.isfinite(positions).all(axis=1)]
    if not len(there):
        return np.empty(0)
    return np.array([(there.max(axis=0) - there.min(axis=0)).max() / np.sqrt(len(there))])
