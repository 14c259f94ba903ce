"""Text files of points whose colours can be replaced, every other byte staying as it is.

Points are lines of numbers between blanks, tabs, commas or semicolons.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Array, Float64s, Int64s
from beltrami_cli.errors import InputError, NoColoursError
from beltrami_cli.formats.access import Access
from beltrami_cli.formats.changes import Changes, Naming, Written
from beltrami_cli.formats.colours import display_colours, quantised
from beltrami_cli.formats.comparison import Fingerprint
from beltrami_cli.formats.edits import new_colours, renumbered, without_tokens
from beltrami_cli.formats.mesh_contents import not_converted
from beltrami_cli.formats.points.cloud import PointsDocument, Tables
from beltrami_cli.formats.points.columns import (
    NORMAL,
    RGB,
    Columns,
    column_names,
    example_of,
    find_columns,
    is_header,
)
from beltrami_cli.formats.tokens import Lines, number_lines, read_numbers, without_comments
from beltrami_cli.surface.precision import shortest_type
from beltrami_cli.surface.records import MeshContents

_SEPARATORS = bytes.maketrans(b",;", b"  ")
_COMMENT = re.compile(rb"(?:#|//)([^\r\n]*)")
_HEAD = 4096  # bytes in which a comment may name the columns
_MAX_COLUMNS = 4096  # as for properties of PLY; real files have a hundred at most
# Names of tables that no column has, since those are printable.
_POSITIONS, _COLOURS, _NORMALS = "positions\n", "colours\n", "normals\n"
_NO_TABLE = "is not a number, so this is not a table of points"


@dataclass(frozen=True)
class _Table:
    names: tuple[str, ...]  # of the columns, in lower case, from a line above the points; or empty
    counts: tuple[int, ...]  # of the points that follow lines of a single number
    values: Float64s  # shape (P, K), maybe infinite or NaN
    starts: Int64s  # where they are in the file, shape (P, K)
    ends: Int64s


class _Reader(Lines):
    """Lines of numbers between blanks, tabs, commas or semicolons."""

    def __init__(self, data: bytes, name: str) -> None:
        if b"\0" in data[:_HEAD]:
            raise InputError(name, "it is not plain text", "export its points as lines of numbers, or as PLY")
        self._comments = _COMMENT.findall(data[:_HEAD])
        super().__init__(data, without_comments(data.translate(_SEPARATORS), b"#", b"//"), name)

    def read(self, given: Sequence[str]) -> _Table:
        """Read the points; the names of columns that are given count in the place of those in the file."""
        if (wide := self.stops - self.heads > _MAX_COLUMNS).any():
            raise self._error(np.argmax(wide), f"there are more than {_MAX_COLUMNS} columns")
        names = self._take_names()
        sizes = self.stops - self.heads
        # Where every line has one number, that is what the points have.
        announcing = (sizes == 1) & bool((sizes > 1).any() or len(sizes) == 1)
        points = np.flatnonzero(~announcing)
        width = int(sizes[points[0]]) if len(points) else 0
        if width:
            self._require_numbers(int(points[0]))
        if (uneven := sizes[points] != width).any():
            row = points[int(np.argmax(uneven))]
            raise self._error(row, f"{sizes[row]} numbers, but the first point has {width}")
        tokens = self.heads[points][:, None] + np.arange(width)
        counts = self._counts(np.flatnonzero(announcing), len(points))
        values = self.numbers(tokens.ravel()).reshape(tokens.shape)
        if given and width:
            if len(given) != width:
                cause = f"its points have {width} numbers each, but --columns has {len(given)} names"
                raise InputError(self.name, cause, example_of(width))
            names = tuple(known.lower() for known in given)
        elif not names:
            said = map(column_names, self._comments)
            names = next((words for words in said if len(words) == width and is_header(words)), ())
        elif width not in (0, len(names)):
            raise InputError(self.name, f"the first line names {len(names)} columns, but there are {width}")
        return _Table(names, counts, values, self.starts[tokens], self.ends[tokens])

    def _take_names(self) -> tuple[str, ...]:
        # The first line with more than a count, if it has words in place of numbers.
        for row in range(min(2, len(self.heads))):
            words = [self.word(token) for token in range(self.heads[row], self.stops[row])]
            if not any(len(read_numbers(word)) for word in words):
                line = self.data[self.starts[self.heads[row]] : self.ends[self.stops[row] - 1]]
                self.heads, self.stops = np.delete(self.heads, row), np.delete(self.stops, row)
                return column_names(line)
        return ()

    def _require_numbers(self, row: int) -> None:
        """Raise InputError if a line is none of a table: it has words, or commas within its numbers."""
        tokens = range(self.heads[row], self.stops[row])
        for token in tokens:
            if not len(read_numbers(self.word(token))):
                raise self.error(token, _NO_TABLE)
        gaps = [self.data[self.ends[token] : self.starts[token + 1]] for token in tokens[:-1]]
        if b"," in gaps and not all(b"," in gap for gap in gaps):
            cause = f"line {self.line(tokens[0])}: commas stand in some places and other separators in others"
            raise InputError(self.name, cause, "write decimals with a point, and use one separator")

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


class TextPointsDocument(PointsDocument):
    """Lines of coordinates and colours, or intensities, under any of their suffixes."""

    @property
    def format(self) -> str:  # type: ignore[override]
        suffix = Path(self.name).suffix.lower()
        return suffix[1:] if suffix in (".pts", ".csv") else "xyz"

    @property
    def _type(self) -> str:
        return "text"

    def _patched(self, new: Changes, naming: Naming) -> Written:
        if new.colours is None:
            return Written([self.data])
        colours = new_colours(self.data, *self._colour_tokens(), self._colours, new.colours, self._scale)
        return Written(renumbered(self.data, [colours]))

    def _dropped(self) -> list[str]:
        others = self._columns.others
        return [f"columns {', '.join(others)}"] if others else []

    def fingerprint(self) -> Fingerprint:
        if not self._has_colours():
            return Fingerprint({"lines": self.data})
        starts, ends = (np.sort(places.ravel()) for places in self._colour_tokens())
        lines = without_tokens(self.data, starts, ends)
        return Fingerprint({"lines": lines}, {"point colours": self._colours})

    def facts(self) -> dict[str, object]:
        return {
            "format": self.format,
            "points": len(self._table.values),
            "columns": list(self._table.names or self._columns.names),
            "announced": list(self._table.counts),
        }

    def access_to_copies(self) -> Access:
        # The values of the new colours must not influence the choice of columns.
        known = self._columns.names if self._has_colours() else self.access.columns
        return dataclasses.replace(self.access, columns=known)

    def _has_colours(self) -> bool:
        """Whether there are colours that can be used; InputError if it is not clear which these are."""
        try:
            return bool(self._columns.colours) and self.has_vertex_colours()
        except NoColoursError:
            return False

    @cached_property
    def _table(self) -> _Table:
        table = _Reader(self.data, self.name).read(self.access.columns)
        if not len(table.values):
            raise InputError(self.name, "there are no points", "nothing in it can be smoothed")
        return table

    @cached_property
    def _columns(self) -> Columns:
        table = self._table
        columns = find_columns(table.names, table.values, self.name, is_pts=bool(table.counts))
        self.notices += [columns.notice] if columns.notice else []
        return columns

    @cached_property
    def _tables(self) -> Tables:
        known, count = self._columns, len(self._table.values)
        normals, channels = _NORMALS if known.normal else None, len(known.colours)
        return Tables(
            _POSITIONS, _COLOURS, normals, tuple(known.others), (count,), channels, is_intensity=channels == 1
        )

    def _rows(self, table: str) -> Array:
        known = self._columns
        groups = {_POSITIONS: known.position, _COLOURS: known.colours, _NORMALS: known.normal}
        return self._table.values[:, groups.get(table) or (known.others[table],)]

    def _colour_tokens(self) -> tuple[Int64s, Int64s]:
        tokens = np.ix_(self._measured, np.array(self._columns.colours))
        return self._table.starts[tokens], self._table.ends[tokens]


def _written(mesh: MeshContents, stem: str, *, separator: str = " ", head: str = "") -> Written:
    """Write points as lines of x y z r g b, then normals; colours are whole numbers from 8 bit, else of 0 to 1."""
    colours, notices = display_colours(mesh)
    if mesh.alpha is not None:
        notices.append("Opacity is dropped: a line has red, green and blue only.")
    if len(mesh.sizes):
        notices.append("Faces are dropped: the file has points only.")
    whole = mesh.stored == "uint8" and mesh.encoding == "srgb"
    shades = quantised(colours, np.uint8 if whole else np.float32)
    tables: list[Array] = [shortest_type(mesh.positions), shades]
    names, style = ["x", "y", "z", *RGB], ["%s", "%s", "%s", *["%d" if whole else "%.6f"] * 3]
    if mesh.normals is not None:
        tables, names, style = [*tables, mesh.normals], [*names, *NORMAL], [*style, "%s", "%s", "%s"]
    first = head.format(count=len(mesh.positions), names=separator.join(names)).encode()
    pieces = [first, *number_lines(separator.join(style) + "\n", *tables)]
    return Written(pieces, notices=(*notices, *not_converted(mesh)))


write_xyz, write_pts = _written, partial(_written, head="{count}\n")
write_csv = partial(_written, separator=",", head="{names}\n")
