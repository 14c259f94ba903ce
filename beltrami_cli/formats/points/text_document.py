"""Text files of points whose colours can be replaced, every other byte staying as it is.

Points are lines of numbers. What the columns are is said by their names, or else by how many there are: 6 are x y z r g
b, 4 are x y z intensity and 7 are x y z intensity r g b. 9 and 10 have normals as well, before or behind the colours,
which are recognised by their length.
"""

from __future__ import annotations

import dataclasses
import re
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Array, Float32s, Float64s, Int64s
from beltrami_cli.errors import InputError, UnpaintedError
from beltrami_cli.formats.colours import display_colours, intensity_scale, point_colour_scale, quantised
from beltrami_cli.formats.document import Changes, Document, Fingerprint, Naming, Written, not_converted
from beltrami_cli.formats.tokens import (
    Lines,
    new_colours,
    number_lines,
    read_numbers,
    renumbered,
    without_comments,
    without_tokens,
)
from beltrami_cli.surface.geometry import shortest_type
from beltrami_cli.surface.records import MeshContents, require_finite

_SEPARATORS = bytes.maketrans(b",;", b"  ")
_COMMENT = re.compile(rb"(?:#|//)([^\r\n]*)")
_HEAD = 4096  # bytes in which a comment may name the columns
_MOST_SHOWN = 40  # characters of a token in a message
_COLOURS = (
    ("r", "g", "b"),
    ("red", "green", "blue"),
    ("rf", "gf", "bf"),
    ("diffuse_red", "diffuse_green", "diffuse_blue"),
)
_NORMALS = (("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z"))
_INTENSITIES = ("intensity", "i", "scalar_intensity", "reflectance", "grey", "gray")
_RGB, _NORMAL = ("red", "green", "blue"), ("nx", "ny", "nz")
_KNOWN = {
    4: (("intensity",),),
    6: (_RGB,),
    7: (("intensity", *_RGB),),
    9: ((*_RGB, *_NORMAL), (*_NORMAL, *_RGB)),
    10: (("intensity", *_RGB, *_NORMAL),),
}
"""What follows x, y and z, by the number of all columns; the first that can be is taken."""
_UNIT = 0.01  # how far the length of a normal may be from 1, for as few decimals as two
_REMEDY = "name them in a first line, such as: # x y z r g b"


@dataclass(frozen=True)
class _Table:
    """The points of a text."""

    names: tuple[str, ...]  # of the columns, in lower case, from a line above the points; or empty
    counts: tuple[int, ...]  # of the points that follow lines of a single number
    values: Float64s  # shape (P, K), maybe infinite or NaN
    starts: Int64s  # where they are in the file, shape (P, K)
    ends: Int64s


class _Reader(Lines):
    """Lines of numbers between blanks, tabs, commas or semicolons."""

    def __init__(self, data: bytes, name: str) -> None:
        if b"\0" in data[:_HEAD]:
            raise InputError(name, "it is no plain text", "export its points as lines of numbers, or as PLY")
        head = data[:_HEAD].translate(_SEPARATORS)
        self._comments = [found.split() for found in _COMMENT.findall(head)]
        super().__init__(data, without_comments(data.translate(_SEPARATORS), b"#", b"//"), name)

    def read(self) -> _Table:
        names = self._take_names()
        sizes = self.stops - self.heads
        # Where every line has one number, that is what the points have.
        announcing = (sizes == 1) & bool((sizes > 1).any() or len(sizes) == 1)
        points = np.flatnonzero(~announcing)
        width = int(sizes[points[0]]) if len(points) else 0
        if (uneven := sizes[points] != width).any():
            row = points[int(np.argmax(uneven))]
            raise self._error(row, f"{sizes[row]} numbers, but the first point has {width}")
        tokens = self.heads[points][:, None] + np.arange(width)
        counts = self._counts(np.flatnonzero(announcing), len(points))
        values = self.numbers(tokens.ravel()).reshape(tokens.shape)
        if not names:
            fits = [words for words in self._comments if len(words) == width and width > 0]
            names = _column_names(fits[0]) if fits else ()
        elif width not in (0, len(names)):
            raise InputError(self.name, f"the first line names {len(names)} columns, but there are {width}")
        return _Table(names, counts, values, self.starts[tokens], self.ends[tokens])

    def _take_names(self) -> tuple[str, ...]:
        # The first line with more than a count, if it has words in place of numbers.
        for row in range(min(2, len(self.heads))):
            words = [self.word(token) for token in range(self.heads[row], self.stops[row])]
            if not any(len(read_numbers(word)) for word in words):
                self.heads, self.stops = np.delete(self.heads, row), np.delete(self.stops, row)
                return _column_names(words)
        return ()

    def _counts(self, rows: NDArray[np.intp], points: int) -> tuple[int, ...]:
        if not len(rows):
            return ()
        if rows[0] != 0:
            raise self._error(rows[0], "one number only, and it is not at the head of the points")
        values = self.numbers(self.heads[rows])
        # Between two announcements there are as many points as rows, less one.
        there = np.diff(np.append(rows, points + len(rows))) - 1
        if (wrong := values != there).any():
            row = int(np.argmax(wrong))
            cause = f"{values[row]:g} points are announced, but {there[row]} follow; the file is cut off or damaged"
            raise self._error(rows[row], cause)
        return tuple(there.tolist())

    def _error(self, row: int | np.intp, cause: str) -> InputError:
        return InputError(self.name, f"line {self.line(self.heads[row])}: {cause}")


def _column_names(words: list[bytes]) -> tuple[str, ...]:
    shown = (word[:_MOST_SHOWN].decode("ascii", "replace").lower() for word in words)
    return tuple("".join(c if c.isprintable() else "?" for c in word) for word in shown)


@dataclass(frozen=True)
class _Columns:
    """Which columns are what: three of the position, three colours or one intensity, three of the normal or none."""

    position: tuple[int, ...]
    colours: tuple[int, ...]
    normal: tuple[int, ...]
    others: dict[str, int]  # the rest that has a name
    names: tuple[str, ...]  # of all columns, or what they were taken for
    notice: str


def _find_columns(table: _Table, name: str) -> _Columns:
    if table.names:
        return _by_name(table.names, name, "")
    width = table.values.shape[1]
    if width == 3:
        cause = "its points have 3 numbers each, so there are no colours"
        raise UnpaintedError(name, cause, "add r g b to each line")
    if width not in _KNOWN:
        cause = f"its points have {width} numbers each, and it is not clear which are colours"
        raise InputError(name, cause, _REMEDY)
    layouts = [layout for layout in _KNOWN[width] if _fits(layout, table.values)]
    if not layouts:
        unclear = "the normals cannot be distinguished from colours"
        cause = "columns 4 to 6 are normals, and no colours" if width == 6 else unclear
        raise InputError(name, cause, _REMEDY)
    names = ("x", "y", "z", *layouts[0])
    notice = "" if width == 6 else f"Its {width} columns are taken for {' '.join(names)}."
    return _by_name(names, name, notice)


def _by_name(names: tuple[str, ...], name: str, notice: str) -> _Columns:
    position = _together(names, (("x", "y", "z"),))
    if not position:
        raise InputError(name, f"the columns {' '.join(names)[:200]} have no x, y and z", _REMEDY)
    intensity = next(((names.index(known),) for known in _INTENSITIES if known in names), ())
    colours = _together(names, _COLOURS) or intensity
    if not colours:
        raise UnpaintedError(name, f"the columns {' '.join(names)[:200]} have no colours", _REMEDY)
    normal = _together(names, _NORMALS)
    used = {*position, *colours, *normal}
    others = {known: column for column, known in enumerate(names) if column not in used}
    return _Columns(position, colours, normal, others, names, notice)


def _together(names: tuple[str, ...], triples: tuple[tuple[str, ...], ...]) -> tuple[int, ...]:
    found = next((triple for triple in triples if {*triple} <= {*names}), ())
    return tuple(names.index(known) for known in found)


def _fits(layout: tuple[str, ...], values: Float64s) -> bool:
    """Whether the numbers can be normals where a layout has these, and colours where it has them."""
    for first, known in enumerate(layout):
        triple = values[:, 3 + first : 6 + first]
        triple = triple[np.isfinite(triple).all(axis=1)]
        if known == "nx" and not _are_unit(triple):
            return False
        # Pure red, green and blue have length 1 as well.
        if known == "red" and _are_unit(triple) and ((triple < 0) | (triple % 1 != 0)).any():
            return False
    return True


def _are_unit(values: Float64s) -> bool:
    """Whether all vectors have length 1, or 0 where none is known."""
    lengths = np.linalg.norm(values, axis=1)
    return bool(((np.abs(lengths - 1) < _UNIT) | (lengths == 0)).all())


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
        return _RGB if len(self._columns.colours) == 3 else ("intensity",)

    def attributes(self) -> tuple[str, ...]:
        return (*(("normal",) if self._columns.normal else ()), *self._columns.others)

    def _attribute(self, name: str) -> Float64s:
        if name == "normal" and self._columns.normal:
            return self._picked(self._columns.normal)
        return self._picked((self._columns.others[name],))

    def _patched(self, new: Changes, naming: Naming) -> Written:
        if new.colours is None:
            return Written([self.data])
        colours = new_colours(self.data, *self._places(), self._colours, new.colours, self._scale)
        return Written(renumbered(self.data, [colours]))

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
        return {
            "format": self.format,
            "points": len(self._table.values),
            "columns": list(self._table.names or self._columns.names),
            "announced": list(self._table.counts),
        }

    @cached_property
    def _table(self) -> _Table:
        table = _Reader(self.data, self.name).read()
        if not len(table.values):
            raise InputError(self.name, "there are no points", "nothing in it can be smoothed")
        return table

    @cached_property
    def _columns(self) -> _Columns:
        columns = _find_columns(self._table, self.name)
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
        tokens = np.ix_(self._measured, np.array(self._columns.colours))
        return self._table.starts[tokens], self._table.ends[tokens]

    def _picked(self, columns: tuple[int, ...]) -> Float64s:
        return np.ascontiguousarray(self._table.values[np.ix_(self._measured, np.array(columns))])


def write_xyz(contents: MeshContents, stem: str) -> Written:
    """Write points as lines of x y z r g b, then normals; colours are whole numbers from 8 bit, else of 0 to 1."""
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
