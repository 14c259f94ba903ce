"""The arrays of a cloud of points in a NumPy archive, by their names; the first name that is there is taken.

======================================  ==============================================================================
``positions``, ``points``, ``xyz``      (..., 3) numbers, the other axes as the cloud is organised; what is not finite
                                        is no point
``colours``, ``colors``, ``rgb``,       (..., C) of the same points: red, green and blue, or grey alone, then opacity
``rgba``, ``point_colours``,            if there is one more; uint8, uint16, or numbers of 0 to 1, 0 to 255 or 0 to
``point_colors``                        65535
``intensity``, ``intensities``          (...) numbers of any range, taken if there are no colours
``normals``, ``normal``                 (..., 3)
``faces``, ``triangles``                (F, 3) indices of points: then it is a mesh, and no cloud
======================================  ==============================================================================

Positions of shape (H, W, 3) are a range image: points side by side there are so on the surface. Other arrays stay as
they are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import InputError, UnpaintedError
from beltrami_cli.formats.npz import POSITION_KEYS

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from beltrami_cli.formats.access import Access
    from beltrami_cli.formats.npz import NpzArchive

COLOUR_KEYS = ("colours", "colors", "rgb", "rgba", "point_colours", "point_colors")
INTENSITY_KEYS = ("intensity", "intensities")
_NORMAL_KEYS = ("normals", "normal")
_FACE_KEYS = ("faces", "triangles")

_CHANNELS = 4
_COPIES = 3  # what is held at a time of each array: as stored, as doubles, and as it is worked with
_NAMES = "save them as positions and colours"


@dataclass(frozen=True)
class CloudArrays:
    """What an archive has of a cloud, without the numbers.

    Attributes
    ----------
    positions, colours : str
        The names of the arrays.
    normals, faces : str or None
        Likewise.
    shape : tuple of int
        How the points are organised.
    channels : int
        Of the colours, without opacity.
    has_alpha : bool
        Whether there is one channel more.
    rest : tuple of str
        The other arrays that have something for each point.
    """

    positions: str
    colours: str
    normals: str | None
    faces: str | None
    shape: tuple[int, ...]
    channels: int
    has_alpha: bool
    rest: tuple[str, ...]

    @property
    def is_intensity(self) -> bool:
        """Whether the colours are intensities, of which any number may be full scale."""
        return self.colours in INTENSITY_KEYS

    @property
    def count(self) -> int:
        """Points, with or without a place."""
        return math.prod(self.shape)


def find_arrays(archive: NpzArchive, name: str) -> CloudArrays:
    """Tell which arrays are what, by their names and shapes.

    Parameters
    ----------
    archive : NpzArchive
        The archive.
    name : str
        The file's name for messages.

    Raises
    ------
    InputError
        If there are no positions or no colours, or they do not go together.
    """
    positions = _required(archive, POSITION_KEYS, "positions", name)
    colours = _required(archive, (*COLOUR_KEYS, *INTENSITY_KEYS), "colours", name)
    shape = archive.header(positions).shape
    _require(
        len(shape) >= 2 and shape[-1] == 3, name, f"the array {positions} is of shape {shape}, not (..., 3)"
    )
    points, found = shape[:-1], archive.header(colours).shape
    wide = found[len(points) :]
    fits = found[: len(points)] == points and len(wide) <= 1 and 1 <= math.prod(wide) <= _CHANNELS
    _require(fits, name, f"the array {colours} is of shape {found}, and the positions of {shape}")
    _require(archive.header(colours).dtype.kind != "b", name, f"the array {colours} is of booleans")
    normals, faces = archive.first(_NORMAL_KEYS), archive.first(_FACE_KEYS)
    if normals is not None and archive.header(normals).shape != shape:
        normals = None
    used = {positions, colours, normals, faces}
    rest = [key for key in archive.names if key not in used and _goes_along(archive, key, points)]
    channels = math.prod(wide)
    has_alpha = channels in (2, 4)
    return CloudArrays(
        positions, colours, normals, faces, points, channels - has_alpha, has_alpha, tuple(rest)
    )


def require_room(archive: NpzArchive, keys: Iterable[str], access: Access, name: str) -> None:
    """Refuse arrays that do not fit into memory before they are unpacked.

    Raises
    ------
    InputError
        If the least that is needed is more than allowed.
    """
    if access.memory is None:
        return
    headers = [archive.header(key) for key in keys]
    needed = sum(_COPIES * math.prod(header.shape) * 8 for header in headers)
    if needed > access.memory:
        raise InputError(name, "its arrays do not fit into memory", "raise --max-memory")


def read_faces(archive: NpzArchive, key: str, count: int, name: str) -> NDArray[np.int32]:
    """Read triangles of points.

    Raises
    ------
    InputError
        If they are not of shape (F, 3), or name points that are not there.
    """
    shape = archive.header(key).shape
    _require(len(shape) == 2 and shape[1] == 3, name, f"the array {key} is of shape {shape}, not (F, 3)")
    faces = read_all(archive, key)
    _require(faces.dtype.kind in "ui", name, f"the array {key} is not of whole numbers")
    inside = not faces.size or (faces.min() >= 0 and int(faces.max()) < count)
    _require(bool(inside), name, f"the array {key} names points outside 0 to {count - 1}")
    return np.ascontiguousarray(faces, np.int32)


def read_all(archive: NpzArchive, key: str) -> NDArray[Any]:
    """Read a whole array, however large."""
    return archive.read(key, math.prod(archive.header(key).shape))


def _required(archive: NpzArchive, keys: tuple[str, ...], what: str, name: str) -> str:
    key = archive.first(keys)
    if key is None:
        there = ", ".join(archive.names)[:200] or "no arrays"
        raise UnpaintedError(name, f"it has no array of {what} ({', '.join(keys)}), but {there}", _NAMES)
    return key


def _goes_along(archive: NpzArchive, key: str, points: tuple[int, ...]) -> bool:
    try:
        shape = archive.header(key).shape
    except InputError:
        return False  # what is no array of numbers stays as it is
    return shape[: len(points)] == points and len(shape) <= len(points) + 1


def _require(holds: bool, name: str, cause: str) -> None:
    if not holds:
        raise InputError(name, cause, _NAMES)
