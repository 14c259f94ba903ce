"""Text files of points whose colours can be replaced, every other byte staying as it is.

Points are lines of numbers between blanks, tabs, commas or semicolons; `columns` says which columns are the colours.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Array, Float32s, Float64s, Int64s
from beltrami_cli.errors import InputError, UnpaintedError
from beltrami_cli.formats.access import Access
from beltrami_cli.formats.colours import display_colours, intensity_scale, point_colour_scale, quantised
from beltrami_cli.formats.document import Changes, Document, Fingerprint, Naming, Written, not_converted
from beltrami_cli.formats.points.columns import NORMAL, RGB, Columns, example_of, find_columns, is_header
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
_NO_TABLE = "is no number, so this is no table of points"


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
        self._comments = _COMMENT.findall(data[:_HEAD])
        super().__init__(data, without_comments(data.translate(_SEPARATORS), b"#", b"//"), name)

    def read(self, given: Sequence[str]) -> _Table:
        """Read the points; the names of columns that are given count in the place of those in the file."""
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
            said = map(_column_names, self._comments)
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
                return _column_names(line)
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


def _column_names(line: bytes) -> tuple[str, ...]:
    """Return the names in a line, which may have blanks and quotes where something else separates them."""
    separator = next((each for each in (b";", b",", b"\t") if each in line), None)
    words = (word.strip(b" \t\"'")[:_MOST_SHOWN] for word in line.strip().split(separator))
    shown = (word.decode("ascii", "replace").lower() for word in words)
    return tuple("".join(c if c.isprintable() else "?" for c in word) for word in shown)


class TextPointsDocument(Document):
    """Lines of coordinates and colours, or intensities, under any of their suffixes."""

    @property
    def format(self) -> str:  # type: ignore[override]
        suffix = Path(self.name).suffix.lower()
        return suffix[1:] if suffix in (".pts", ".csv") else "xyz"

    @cached_property
    def _mesh(self) -> MeshContents:
        positions = self._picked(self._columns.position)
        no_corners, offsets = np.empty(0, np.int32), np.zeros(1, np.int64)
        return MeshContents(positions, no_corners, offsets, self._colours, "srgb", "text")

    @property
    def _channels(self) -> tuple[str, ...]:
        return RGB if len(self._columns.colours) == 3 else ("intensity",)

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
        if not self._has_colours():
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

    def access_to_copies(self) -> Access:
        # What other colours look like must not decide which columns they are in.
        known = self._columns.names if self._has_colours() else self.access.columns
        return dataclasses.replace(self.access, columns=known)

    def _has_colours(self) -> bool:
        """Whether there are colours that can be used; InputError if it is not clear which these are."""
        try:
            return bool(self._columns.colours) and self.has_vertex_colours()
        except UnpaintedError:
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


def write_csv(contents: MeshContents, stem: str) -> Written:
    """Write points as `write_xyz` does, with commas between the numbers, below a line with the names of columns."""
    names = ("x", "y", "z", *RGB, *(() if contents.normals is None else NORMAL))
    return _lines(contents, [f"{','.join(names)}\n".encode()], ",")


def _lines(contents: MeshContents, pieces: list[bytes], separator: str = " ") -> Written:
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
    pieces += number_lines(style.replace(" ", separator) + "\n", *tables)
    return Written(pieces, notices=(*notices, *not_converted(contents)))
