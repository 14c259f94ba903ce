"""Text files of points whose colours can be replaced, every other byte staying as it is."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Array, Float32s, Float64s, Int64s
from beltrami_cli.errors import InputError
from beltrami_cli.formats.colours import display_colours, intensity_scale, point_colour_scale, quantised
from beltrami_cli.formats.document import Changes, Document, Fingerprint, Naming, Written, not_converted
from beltrami_cli.formats.points.table import Columns, PointTable, find_columns, read_table
from beltrami_cli.formats.tokens import colour_decimals, exchange_tokens, number_lines, without_tokens
from beltrami_cli.surface.geometry import shortest_type
from beltrami_cli.surface.records import MeshContents, require_finite

_WHOLE, _WITH_EXPONENT = b"%.0f", b"%.9g"


class TextPointsDocument(Document):
    """Lines of coordinates and colours, or intensities: .pts or .xyz, which differ in what is usual only."""

    @property
    def format(self) -> str:  # type: ignore[override]
        return "pts" if self.name.lower().endswith(".pts") else "xyz"

    @cached_property
    def _mesh(self) -> MeshContents:
        positions = self._picked(self._columns.position)
        no_corners, offsets = np.empty(0, np.int32), np.zeros(1, np.int64)
        return MeshContents(positions, no_corners, offsets, self._colours, "srgb", "text")

    @property
    def _channels(self) -> tuple[str, ...]:
        return self._columns.channels

    def attributes(self) -> tuple[str, ...]:
        return (*(("normal",) if self._columns.normal else ()), *self._columns.others)

    def _attribute(self, name: str) -> Float64s:
        if name == "normal" and self._columns.normal:
            return self._picked(self._columns.normal)
        return self._picked((self._columns.others[name],))

    def _patched(self, new: Changes, naming: Naming) -> Written:
        if new.colours is None:
            return Written([self.data])
        return Written(_with_colours(self.data, *self._places(), self._colours, new.colours, self._scale))

    def contents(self) -> MeshContents:
        columns = self._columns
        dropped = [f"columns {', '.join(columns.others)}"] if columns.others else []
        if len(self._measured) < len(self._table.values):
            dropped.append("points without a place")
        normals = self._picked(columns.normal).astype(np.float32) if columns.normal else None
        return dataclasses.replace(self._mesh, normals=normals, left_out=tuple(dropped))

    def fingerprint(self) -> Fingerprint:
        if not self.has_vertex_colours():
            return Fingerprint({"lines": self.data})
        starts, ends = (np.sort(places.ravel()) for places in self._places())
        lines = without_tokens(self.data, starts, ends)
        return Fingerprint({"lines": lines}, {"point colours": self._colours})

    def facts(self) -> dict[str, object]:
        names = self._table.names or self._columns.names(self._table.values.shape[1])
        return {
            "format": self.format,
            "points": len(self._table.values),
            "columns": list(names),
            "announced": list(self._table.counts),
        }

    @cached_property
    def _table(self) -> PointTable:
        table = read_table(self.data, self.name)
        if not len(table.values):
            raise InputError(self.name, "there are no points", "nothing in it can be smoothed")
        return table

    @cached_property
    def _columns(self) -> Columns:
        columns = find_columns(self._table, self.name)
        self.notices += [columns.notice] if columns.notice else []
        return columns

    @cached_property
    def _measured(self) -> NDArray[np.intp]:
        """Rows of the points that have a place; scanners write NaN where nothing was measured."""
        finite = np.asarray(np.isfinite(self._table.values[:, self._columns.position]).all(axis=1))
        if not finite.all():
            count = int(np.count_nonzero(~finite))
            self.notices.append(f"{count} of {len(finite)} points have no place, and take no part.")
        return np.flatnonzero(finite)

    @cached_property
    def _stored(self) -> Float64s:
        colours = self._picked(self._columns.colours)
        if not len(colours):
            raise InputError(self.name, "none of its points has a place", "nothing in it can be smoothed")
        require_finite(colours, self.name, "the colour of point", self._measured)
        return colours

    @cached_property
    def _scale(self) -> float:
        grey = len(self._columns.colours) == 1
        scale, notice = intensity_scale(self._stored) if grey else point_colour_scale(self._stored, self.name)
        self.notices += [notice] if notice else []
        return scale

    @cached_property
    def _colours(self) -> Float32s:
        return (self._stored / self._scale).astype(np.float32)

    def _places(self) -> tuple[Int64s, Int64s]:
        """Return where the colours of measured points start and end in the file."""
        tokens = np.ix_(self._measured, np.array(self._columns.colours))
        return self._table.starts[tokens], self._table.ends[tokens]

    def _picked(self, columns: tuple[int, ...]) -> Float64s:
        return np.ascontiguousarray(self._table.values[np.ix_(self._measured, np.array(columns))])


def _with_colours(
    data: bytes, starts: Int64s, ends: Int64s, before: Float32s, after: Float32s, scale: float
) -> Sequence[bytes | memoryview]:
    """Exchange the colours, each of shape (P, C), that changed, and keep every other byte.

    Where all old numbers are integers the new ones are; else they have as many decimals as the old ones have at most,
    within what single precision can resolve.
    """
    style = _number_format(data, starts.ravel(), ends.ravel(), scale) if after.size else b""
    values = after.astype(np.float64) * scale
    changed = after != before
    if style == _WHOLE:
        values = np.rint(values) + 0.0  # no -0
        changed &= values != np.rint(before.astype(np.float64) * scale)
    if not changed.any():
        return [data]
    order = np.argsort(starts[changed])  # blue may stand before red
    numbers, places = values[changed][order], (starts[changed][order], ends[changed][order])
    return exchange_tokens(data, *places, lambda block: [style % value for value in numbers[block].tolist()])


def _number_format(data: bytes, starts: Int64s, ends: Int64s, scale: float) -> bytes:
    exponents = np.append(np.flatnonzero((np.frombuffer(data, np.uint8) | 0x20) == ord("e")), len(data))
    if (exponents[np.searchsorted(exponents, starts)] < ends).any():
        return _WITH_EXPONENT
    decimals = colour_decimals(data, starts, ends, scale)
    return _WHOLE if decimals < 0 else b"%%.%df" % decimals


def write_xyz(contents: MeshContents, stem: str) -> Written:
    """Write points as lines of x y z r g b, then normals.

    Positions have as many digits as they need to be read back the same. Colours of 8 bit are integers of 0 to 255, all
    others have six decimals, of 0 to 1.
    """
    return _lines(contents, [])


def write_pts(contents: MeshContents, stem: str) -> Written:
    """Write points as `write_xyz` does, below a line with their number."""
    return _lines(contents, [f"{len(contents.positions)}\n".encode()])


def _lines(contents: MeshContents, pieces: list[bytes]) -> Written:
    colours, notices = display_colours(contents)
    if contents.alpha is not None:
        notices.append("Opacity is dropped: a line has red, green and blue only.")
    if len(contents.offsets) > 1:
        notices.append("Faces are dropped: the file has points only.")
    whole = contents.stored == "uint8" and contents.encoding == "srgb"
    shades = quantised(colours, np.uint8 if whole else np.float32)
    tables: list[Array] = [shortest_type(contents.positions), shades]
    style = "%s %s %s " + " ".join(["%d" if whole else "%.6f"] * 3)
    if contents.normals is not None:
        tables, style = [*tables, contents.normals], style + " %s %s %s"
    pieces += number_lines(style + "\n", *tables)
    return Written(pieces, notices=(*notices, *not_converted(contents)))
