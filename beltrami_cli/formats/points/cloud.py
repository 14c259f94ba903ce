"""Common parts of all point clouds: only the colours can be replaced."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Array, Float32s, Float64s, Int32s, Int64s
from beltrami_cli.errors import InputError, MemoryLimitError
from beltrami_cli.formats.colours import quantised
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.full_scale import integer_scale, intensity_scale, opacity, point_colour_scale
from beltrami_cli.surface.precision import require_single
from beltrami_cli.surface.records import MeshContents

# Bytes of each number at a time, three times as a double: as stored, in double precision, and in working units.
_NUMBER_BYTES = 3 * 8

_IGNORED = "{} of {} points have no finite position and are ignored."

Key = TypeVar("Key")  # by which a document finds a table of its points: a name, or numbers of columns


@dataclass(frozen=True)
class Layout(Generic[Key]):
    """The tables of a point cloud by their meaning, and the shape of its points."""

    positions: Key
    colours: Key
    normals: Key | None
    others: Mapping[str, Key]  # by name, with a row for each point
    shape: tuple[int, ...]  # of the cloud, with or without a position
    channels: int  # of the colours, without opacity
    has_alpha: bool = False
    is_intensity: bool = False
    faces: Key | None = None  # if it is a mesh

    @property
    def count(self) -> int:
        return math.prod(self.shape)


class PointsDocument(Document, Generic[Key]):
    """Points with colours or intensities; subclasses find the tables and read them."""

    @property
    @abstractmethod
    def _layout(self) -> Layout[Key]: ...

    @abstractmethod
    def _rows(self, table: Key) -> Array:
        """Return a table of all points, shape (points, columns)."""

    @abstractmethod
    def _dropped(self) -> list[str]:
        """Return the names of tables that are lost on conversion."""

    @cached_property
    def _mesh(self) -> MeshContents:
        positions, faces = self._positions[self._measured], self._faces
        corners, offsets = faces.ravel(), 3 * np.arange(len(faces) + 1)
        ignored = self._layout.count - len(positions)
        notices = (_IGNORED.format(ignored, self._layout.count) if ignored else "", self._full_scale[1])
        return MeshContents(
            positions,
            corners,
            offsets,
            self._colours,
            "srgb",
            self._type,
            notices=tuple(filter(None, notices)),
        )

    @property
    def _type(self) -> str:
        return str(self._stored_colours.dtype)

    @property
    def _channels(self) -> tuple[str, ...]:
        if self._layout.channels == 3:
            return super()._channels
        return ("intensity",) if self._layout.is_intensity else ("grey",)

    def grid(self) -> Int64s | None:
        layout = self._layout
        if len(layout.shape) != 2 or min(layout.shape) < 2 or layout.faces:
            return None
        places = np.full(layout.count, -1, np.int64)
        places[self._measured] = np.arange(len(self._measured))
        return places.reshape(layout.shape)

    def attributes(self) -> tuple[str, ...]:
        return (*(["normal"] if self._layout.normals else []), *self._layout.others)

    def _attribute(self, name: str) -> Float64s:
        normals = self._layout.normals if name == "normal" else None
        table = self._layout.others[name] if normals is None else normals
        return np.ascontiguousarray(self._rows(table)[self._measured], np.float64)

    def contents(self) -> MeshContents:
        layout, dropped = self._layout, self._dropped()
        if len(self._measured) < layout.count:
            dropped.append("points without a finite position")
        alpha = opacity(self._stored_colours[self._measured, -1], self._scale) if layout.has_alpha else None
        normals = None
        if layout.normals:
            stored = self.attribute("normal")
            require_single(stored, self.name, "the normal of point", self._measured, holes=True)
            normals = stored.astype(np.float32)
        return replace(self._mesh, alpha=alpha, normals=normals, left_out=tuple(dropped))

    def _stored_without_colours(self) -> Array:
        """Return the table of colours with zeros where colours can be replaced, for fingerprints."""
        stored = self._stored_colours.copy()
        stored[self._measured, : self._layout.channels] = 0
        return stored

    def _require_points(self, layout: Layout[Key], numbers: int) -> None:
        """Raise InputError if there are no points, or if so many numbers of them do not fit into memory."""
        if not layout.count:
            raise InputError(self.name, "there are no points", "nothing in it can be smoothed")
        if self.access.memory is not None and numbers * _NUMBER_BYTES > self.access.memory:
            raise MemoryLimitError(self.name, "its points do not fit into memory", "raise --max-memory")

    def _recoloured(self, colours: Float32s | None) -> Array | None:
        """Return the table of colours with new ones, rows as in `patch`; None if all are the present ones."""
        if colours is None or not (changed := colours != self._colours).any():
            return None
        rows, channels = np.nonzero(changed)
        stored = self._stored_colours.copy()
        stored[self._measured[rows], channels] = quantised(colours[changed], stored.dtype, self._scale)
        return stored

    @cached_property
    def _positions(self) -> Float64s:
        return np.ascontiguousarray(self._rows(self._layout.positions), np.float64)

    @cached_property
    def _measured(self) -> NDArray[np.intp]:
        """Rows of the points with a finite position; scanners write NaN where nothing was measured."""
        finite = np.asarray(np.isfinite(self._positions).all(axis=1))
        count = int(np.count_nonzero(~finite))
        if count and (not finite.any() or self._layout.faces):
            cause = f"{count} of {len(finite)} positions are not finite"
            raise InputError(self.name, cause, "replace or remove them")
        return np.flatnonzero(finite)

    @property
    def _faces(self) -> Int32s:
        return np.empty((0, 3), np.int32)

    @cached_property
    def _stored_colours(self) -> Array:
        """Colours as stored, with opacity, shape (points, C) or (points, C + 1)."""
        return self._rows(self._layout.colours)

    @cached_property
    def _colour_numbers(self) -> Float64s:
        numbers = self._stored_colours[self._measured, : self._layout.channels].astype(np.float64)
        require_single(numbers, self.name, "the colour of point", self._measured)
        return numbers

    @property
    def _scale(self) -> float:
        return self._full_scale[0]

    @cached_property
    def _full_scale(self) -> tuple[float, str]:
        """The number that is full scale, and a notice if it is a guess, or ""."""
        numbers, kind = self._colour_numbers, self._stored_colours.dtype
        if self._layout.is_intensity:
            return intensity_scale(numbers)
        if kind in (np.uint8, np.uint16):
            return integer_scale(int(self._stored_colours.max()), kind)  # of opacity, too
        return point_colour_scale(numbers, self.name)

    @cached_property
    def _colours(self) -> Float32s:
        return (self._colour_numbers / self._scale).astype(np.float32)
