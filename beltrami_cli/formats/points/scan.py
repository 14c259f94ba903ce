"""The interface of the readers of scanners' point clouds, and what they share."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from beltrami_cli.arrays import Array

Arrays = dict[str, Array]


class Scan(Protocol):
    """The points of a file."""

    def __init__(self, data: bytes) -> None: ...

    def arrays(self) -> Arrays:
        """Return the arrays of an NPZ archive of points, and all else that the file holds."""

    def written(self, new: Array | None, form: str) -> bytes:
        """Return the file, in one of its forms, with new colours or intensities (None: the same)."""


def with_colours(columns: Arrays, rgb: tuple[str, ...]) -> Arrays:
    """Return columns with the colours as one array; there are none where all are black, as LAS files may have it."""
    if not columns.keys() >= {*rgb} or not any(columns[name].any() for name in rgb):
        return columns
    colours = np.column_stack([columns[name] for name in rgb])
    return {"colours": colours} | {name: each for name, each in columns.items() if name not in rgb}


def replaced(new: Array, rgb: tuple[str, ...]) -> Arrays:
    """Return the columns of new colours, shape (points, 3), or of intensities, by name."""
    return dict(zip(rgb if new.shape[1] > 1 else ("intensity",), new.T, strict=True))


def require_room(count: int, size: int, room: int) -> None:
    """Raise ValueError if points, by number and size in bytes, exceed what a file can hold or unpack to."""
    if count * size > room:
        raise ValueError(f"there is no room for the {count} points that it announces")
