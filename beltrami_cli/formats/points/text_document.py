"""Text files of points whose colours can be replaced, every other byte staying as it is.

Points are lines of numbers between blanks, tabs, commas or semicolons. The names of columns, in a line above the points
or as given, say which are what. Without names the first three are x, y and z, and three neighbouring columns are red,
green and blue if they can be colours and no other three can:

- integers of 0 to 255; without any, numbers of 0 to 1; without any, integers of 0 to 65535;
- not all constant, and no normals, which are recognised by their length;
- columns that all have many different values go before columns with few, such as a classification.

With four columns, the fourth is an intensity. Everything else is refused with the option that decides.
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

from beltrami_cli.arrays import Array, Bools, Float64s, Int64s
from beltrami_cli.errors import InputError, NoColoursError
from beltrami_cli.formats.access import Access
from beltrami_cli.formats.changes import Changes, Naming, Written
from beltrami_cli.formats.colours import display_colours, quantised
from beltrami_cli.formats.comparison import Fingerprint
from beltrami_cli.formats.conversion import not_converted
from beltrami_cli.formats.points.archive import PointsDocument, Tables
from beltrami_cli.formats.tokens import (
    Lines,
    new_colours,
    number_lines,
    read_numbers,
    renumbered,
    without_comments,
    without_tokens,
)
from beltrami_cli.surface.precision import shortest_type
from beltrami_cli.surface.records import MeshContents

RGB, NORMAL = ("red", "green", "blue"), ("nx", "ny", "nz")
_POSITION = ("x", "y", "z")
_COLOUR_NAMES = (("r", "g", "b"), RGB, ("rf", "gf", "bf"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
_NORMAL_NAMES = (NORMAL, ("normal_x", "normal_y", "normal_z"))
_INTENSITIES = ("intensity", "i", "scalar_intensity", "reflectance", "grey", "gray")
_UNIT = 0.01  # how far the length of a normal may be from 1, for as few decimals as two
# Different values: the classes of LAS have 5 bits (ASPRS, LAS 1.4, table 8), and its other codes fewer.
_CODES = 32
_SAMPLE = 1 << 12  # values that are counted first, since sorting all takes a second per ten million
_REMEDY = "give --columns with all of their names, such as {}, or the names in a first line"

_SEPARATORS = bytes.maketrans(b",;", b"  ")
_COMMENT = re.compile(rb"(?:#|//)([^\r\n]*)")
_HEAD = 4096  # bytes in which a comment may name the columns
_MAX_COLUMNS = 4096  # as for properties of PLY; real files have a hundred at most
_MAX_SHOWN = 40  # characters of a token in a message
# Names of tables that no column has, since those are printable.
_POSITIONS, _COLOURS, _NORMALS = "positions\n", "colours\n", "normals\n"
_NO_TABLE = "is not a number, so this is not a table of points"


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
                raise InputError(self.name, cause, _example_of(width))
            names = tuple(known.lower() for known in given)
        elif not names:
            said = map(_column_names, self._comments)
            names = next((words for words in said if len(words) == width and _is_header(words)), ())
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
    """Return the names in a line; they may contain blanks and quotes if the separator is another character."""
    separator = next((each for each in (b";", b",", b"\t") if each in line), None)
    words = (word.strip(b" \t\"'")[:_MAX_SHOWN] for word in line.strip().split(separator))
    shown = (word.decode("ascii", "replace").lower() for word in words)
    return tuple("".join(c if c.isprintable() else "?" for c in word) for word in shown)


@dataclass(frozen=True)
class _Columns:
    """The meaning of columns: three positions, three colours or one intensity, three normals or none."""

    position: tuple[int, ...]
    colours: tuple[int, ...]
    normal: tuple[int, ...]
    others: dict[str, int]  # the rest that has a name
    names: tuple[str, ...]  # of all columns, or what they were taken for
    notice: str


def _is_header(words: tuple[str, ...]) -> bool:
    """Whether words are names of columns instead of a sentence."""
    return {*_POSITION} <= {*words}


def _find_columns(names: tuple[str, ...], values: Float64s, name: str, *, is_pts: bool) -> _Columns:
    """Find the columns of values, shape (P, K), by their names or, without any, by the values.

    `is_pts`: a line above the points says how many they are; in PTS files seven columns are x y z intensity r g b.
    """
    if names:
        return _by_name(names, name, "")
    width = values.shape[1]
    if width == 3:
        cause = "its points have 3 numbers each, so there are no colours"
        raise NoColoursError(name, cause, "add r g b to each line")
    names = (*_POSITION, *(("intensity",) if width == 4 else _further_names(values, name, is_pts)))
    notice = "" if width == 6 else f"Its {width} columns are taken for {' '.join(names)}."
    return _by_name(names, name, notice)


def _further_names(values: Float64s, name: str, is_pts: bool) -> tuple[str, ...]:
    """Name the columns behind x, y and z by their values; InputError if two readings are possible, or none."""
    measured, width = np.isfinite(values[:, :3]).all(axis=1), values.shape[1]
    points = values if measured.all() else values[measured]
    normals = [start for start in range(3, width - 2) if _are_normals(points[:, start : start + 3])]
    starts = _colour_starts(points, normals)
    if len(starts) > 1:
        explained = [start for start in starts if _apart_from(start, normals)]
        starts = explained if len(explained) == 1 else starts
    if is_pts and width == 7 and 4 in starts:
        starts = [4]
    if len(starts) != 1:
        shown = " or ".join(f"{start + 1} to {start + 3}" for start in starts)
        unclear = f"its points have {width} numbers each, and it is not clear which are colours"
        known = "columns 4 to 6 are normals, and no colours"
        cause = f"the colours can be columns {shown}" if starts else known if normals else unclear
        raise InputError(name, cause, _example_of(width))
    found = {starts[0] + channel: RGB[channel] for channel in range(3)}
    for normal in _apart_from(starts[0], normals)[:1]:
        found |= {normal + axis: NORMAL[axis] for axis in range(3)}
    if starts[0] == 4:
        found[3] = "intensity"
    return tuple(found.get(column, f"column_{column + 1}") for column in range(3, width))


def _example_of(width: int) -> str:
    """Return the remedy for ambiguous columns, with an example of that many names."""
    names = ("x", "y", "z", "r", "g", "b", "scalar")[:width]
    return _REMEDY.format(",".join((*names, *(f"scalar{number}" for number in range(2, width - 5)))))


def _colour_starts(points: Float64s, normals: list[int]) -> list[int]:
    """Return the first columns of candidates for the colours; `normals`: first columns of unit vectors."""
    if points.shape[1] < 6:
        return []
    low, high, is_whole, count = np.array([_range_of(column) for column in points[:, 3:].T]).T
    triples = np.arange(points.shape[1] - 5)[:, None] + np.arange(3)
    is_whole, positive = is_whole > 0, (low >= 0) & np.isfinite(high)
    # Where there are no more points than codes, few values say nothing.
    is_few = (count <= _CODES) & (len(points) > _CODES)
    is_code = (is_whole & is_few & positive & (high > 1) & (high < _CODES))[triples]
    # Three columns are codes, or two integers of 16 bits with one: intensity, return, class.
    are_codes = is_code.all(axis=1) | (is_code.any(axis=1) & (high[triples] > 255).any(axis=1))
    # Pure red, green and blue have length 1 as well.
    is_signed = ((low < 0) | ~is_whole)[triples].any(axis=1) & np.isin(triples[:, 0] + 3, normals)
    possible = ~are_codes & ~is_signed
    if len(triples) > 1:
        if len(points) > 1:
            possible &= (count > 1)[triples].any(axis=1)
        possible = _fitting(
            possible & (positive & is_whole & (high <= 255))[triples].all(axis=1),
            possible & (positive & (high <= 1))[triples].all(axis=1),
            possible & (positive & is_whole & (high <= 65535))[triples].all(axis=1),
            (count > _CODES)[triples].all(axis=1),
        )
    return (3 + np.flatnonzero(possible)).tolist()


def _fitting(bytes_: Bools, fractions: Bools, words: Bools, rich: Bools) -> Bools:
    """Choose the columns that fit the range of colours best; `rich` ones have many different values."""
    bytes_ = bytes_ & ~fractions
    if (bytes_ & rich).any():
        return bytes_ & rich
    # Codes from 0 to 255 may accompany colours of another range.
    finer = fractions & rich
    found = bytes_ | (finer if finer.any() else words & rich)
    return found if found.any() else fractions if fractions.any() else words


def _are_normals(triple: Float64s) -> bool:
    """Whether all vectors have length 1, or 0 where none is known."""
    finite = triple[np.isfinite(triple).all(axis=1)]
    for vectors in (finite[:_SAMPLE], finite):
        with np.errstate(over="ignore"):
            lengths = np.linalg.norm(vectors, axis=1)
        if not ((np.abs(lengths - 1) < _UNIT) | (lengths == 0)).all():
            return False
    return bool(lengths.any())


def _apart_from(colours: int, normals: list[int]) -> list[int]:
    """Return the normals that share no column with some colours."""
    return [start for start in normals if abs(start - colours) >= 3]


def _range_of(column: Float64s) -> tuple[float, float, bool, int]:
    """Return the extremes of the finite values, whether they are integers, and how many differ, of some if many."""
    finite = column[np.isfinite(column)]
    if not finite.size:
        return np.nan, np.nan, False, 0
    count = len(np.unique(finite[:_SAMPLE]))
    if count <= _CODES:
        count = len(np.unique(finite))
    return float(finite.min()), float(finite.max()), bool((np.rint(finite) == finite).all()), count


def _by_name(names: tuple[str, ...], name: str, notice: str) -> _Columns:
    remedy = _example_of(len(names))
    position = _together(names, (_POSITION,))
    if not position:
        raise InputError(name, f"the columns {' '.join(names)[:200]} have no x, y and z", remedy)
    intensity = next(((names.index(known),) for known in _INTENSITIES if known in names), ())
    colours = _together(names, _COLOUR_NAMES) or intensity
    if not colours:
        raise NoColoursError(name, f"the columns {' '.join(names)[:200]} have no colours", remedy)
    normal = _together(names, _NORMAL_NAMES)
    used = {*position, *colours, *normal}
    others = {known: column for column, known in enumerate(names) if column not in used}
    return _Columns(position, colours, normal, others, names, notice)


def _together(names: tuple[str, ...], triples: tuple[tuple[str, ...], ...]) -> tuple[int, ...]:
    found = next((triple for triple in triples if {*triple} <= {*names}), ())
    return tuple(names.index(known) for known in found)


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
        colours = new_colours(self.data, *self._places(), self._colours, new.colours, self._scale)
        return Written(renumbered(self.data, [colours]))

    def _dropped(self) -> list[str]:
        others = self._columns.others
        return [f"columns {', '.join(others)}"] if others else []

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
    def _columns(self) -> _Columns:
        table = self._table
        columns = _find_columns(table.names, table.values, self.name, is_pts=bool(table.counts))
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

    def _places(self) -> tuple[Int64s, Int64s]:
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
