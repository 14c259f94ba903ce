"""NumPy archives of points, whose colours can be replaced.

The arrays of an archive, by their names; the first name that is there is taken:

======================================  ==============================================================================
``positions``, ``points``, ``xyz``      (..., 3) numbers, the other axes as the cloud is organised; points that are not
                                        finite are left out
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

import io
import math
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array, Int32s
from beltrami_cli.errors import InputError, NoColoursError
from beltrami_cli.formats.changes import Changes, Naming, Written
from beltrami_cli.formats.colours import display_colours, quantised
from beltrami_cli.formats.files.numpy_files import POSITION_KEYS, NpzArchive
from beltrami_cli.formats.fingerprint import Fingerprint
from beltrami_cli.formats.meshes.writing import not_converted
from beltrami_cli.formats.points.cloud import Layout, PointsDocument
from beltrami_cli.surface.polygons import triangulate
from beltrami_cli.surface.precision import shortest_type
from beltrami_cli.surface.records import MeshContents

_COLOUR_KEYS = ("colours", "colors", "rgb", "rgba", "point_colours", "point_colors")
_INTENSITY_KEYS = ("intensity", "intensities")
_NORMAL_KEYS = ("normals", "normal")
_FACE_KEYS = ("faces", "triangles")

_MAX_CHANNELS = 4
_NAMES = "save them as positions and colours"


class NpzPointsDocument(PointsDocument[str]):
    """An archive of positions and colours; InputError if it is not an archive of arrays."""

    format = "npz"

    def _open(self, folder: Path | None) -> None:
        self._archive = NpzArchive(self.data, self.name)

    def _patched(self, new: Changes, naming: Naming) -> Written:
        stored, key = self._recoloured(new.colours), self._layout.colours
        if stored is None:
            return Written([self.data])
        return Written([self._archive.with_array(key, stored.reshape(self._archive.header(key).shape))])

    def fingerprint(self) -> Fingerprint:
        parts = {f"member {name}": content for name, content in self._archive.contents().items()}
        if not self.has_vertex_colours():
            return Fingerprint(parts)
        numbers, key = self._stored_without_colours(), self._layout.colours
        header = self._archive.header(key)
        parts[f"member {key}.npy"] = header.with_numbers(
            parts[f"member {key}.npy"], numbers.reshape(header.shape)
        )
        return Fingerprint(parts, {"point colours": self._colours})

    def facts(self) -> dict[str, object]:
        return {
            "format": self.format,
            "points": self._layout.count,
            "organised": list(self._layout.shape),
            "arrays": list(self._archive.names),
        }

    @cached_property
    def _layout(self) -> Layout[str]:
        layout = _find_layout(self._archive)
        keys = (layout.positions, layout.colours, *([layout.faces] if layout.faces else []))
        self._require_points(layout, sum(self._archive.header(key).count for key in keys))
        self._archive.require_ratio(layout.positions)
        return layout

    def _rows(self, table: str) -> Array:
        return self._archive.array(table).reshape(self._layout.count, -1)

    def _dropped(self) -> list[str]:
        layout = self._layout
        used = {layout.positions, layout.colours, layout.normals, layout.faces}
        return [f"the array {name}" for name in self._archive.names if name not in used]

    @cached_property
    def _faces(self) -> Int32s:
        key, count = self._layout.faces, self._layout.count
        if key is None:
            return super()._faces
        shape = self._archive.header(key).shape
        cause = f"the array {key} is of shape {shape}, not (F, 3)"
        _require(len(shape) == 2 and shape[1] == 3, self._archive, cause)
        faces = self._archive.array(key)
        _require(faces.dtype.kind in "ui", self._archive, f"the array {key} is not of whole numbers")
        inside = not faces.size or (faces.min() >= 0 and int(faces.max()) < count)
        _require(bool(inside), self._archive, f"the array {key} names points outside 0 to {count - 1}")
        return np.ascontiguousarray(faces, np.int32)


def _find_layout(archive: NpzArchive) -> Layout[str]:
    """Find the meaning of arrays by names and shapes; InputError if they do not fit together."""
    positions = _required(archive, POSITION_KEYS, "positions")
    colours = _required(archive, (*_COLOUR_KEYS, *_INTENSITY_KEYS), "colours")
    shape = archive.header(positions).shape
    cause = f"the array {positions} is of shape {shape}, not (..., 3)"
    _require(len(shape) >= 2 and shape[-1] == 3, archive, cause)
    points, channels = shape[:-1], _channels_of(archive, colours, shape)
    normals, faces = archive.first(_NORMAL_KEYS), archive.first(_FACE_KEYS)
    if normals is not None and archive.header(normals).shape != shape:
        normals = None
    used = {positions, colours, normals, faces}
    along = {key: key for key in archive.names if key not in used and _goes_along(archive, key, points)}
    has_alpha = channels in (2, 4)
    return Layout(
        positions=positions,
        colours=colours,
        normals=normals,
        others=along,
        shape=points,
        channels=channels - has_alpha,
        has_alpha=has_alpha,
        is_intensity=colours in _INTENSITY_KEYS,
        faces=faces,
    )


def _required(archive: NpzArchive, keys: tuple[str, ...], what: str) -> str:
    key = archive.first(keys)
    if key is None:
        there = ", ".join(archive.names)[:200] or "no arrays"
        cause = f"it has no array of {what} ({', '.join(keys)}), but {there}"
        raise NoColoursError(archive.name, cause, _NAMES)
    return key


def _channels_of(archive: NpzArchive, colours: str, positions: tuple[int, ...]) -> int:
    """Return the channels of an array of colours, opacity included, for positions of some shape."""
    header, points = archive.header(colours), positions[:-1]
    further = header.shape[len(points) :]
    fits = header.shape[: len(points)] == points and len(further) <= 1
    channels = math.prod(further)
    cause = f"the array {colours} is of shape {header.shape}, and the positions of {positions}"
    _require(fits and 1 <= channels <= _MAX_CHANNELS, archive, cause)
    _require(header.dtype.kind != "b", archive, f"the array {colours} is of booleans")
    return channels


def _goes_along(archive: NpzArchive, key: str, points: tuple[int, ...]) -> bool:
    try:
        shape = archive.header(key).shape
    except InputError:
        return False  # objects other than arrays of numbers stay unchanged
    return shape[: len(points)] == points and len(shape) <= len(points) + 1


def _require(holds: bool, archive: NpzArchive, cause: str) -> None:
    if not holds:
        raise InputError(archive.name, cause, _NAMES)


def write_npz(contents: MeshContents, stem: str) -> Written:
    """Write points as arrays; colours keep 8 or 16 bit and become floats from any other type, opacity behind them."""
    colours, notices = display_colours(contents)
    if contents.alpha is not None:
        colours = np.column_stack([colours, contents.alpha])
    keeps = contents.stored in ("uint8", "uint16") and contents.encoding == "srgb"
    stored = quantised(colours, contents.stored if keeps else np.float32)
    arrays: dict[str, Any] = {"positions": shortest_type(contents.positions), "colours": stored}
    if contents.normals is not None:
        arrays["normals"] = contents.normals
    if len(contents.offsets) > 1:
        arrays["faces"] = triangulate(contents.positions, contents.corners, contents.offsets)
        if np.any(np.diff(contents.offsets) > 3):
            notices.append("Quads and polygons are cut into triangles.")
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return Written([buffer.getvalue()], notices=(*notices, *not_converted(contents)))
