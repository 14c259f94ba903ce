"""Points as lines of numbers: where these stand, and what the columns are: by their names, or by how many there are.

Without names 6 columns are x y z r g b, 4 are x y z intensity and 7 are x y z intensity r g b. 9 and 10 have normals as
well, before or behind the colours, which are recognised by their length.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Float64s, Int64s
from beltrami_cli.errors import InputError, UnpaintedError
from beltrami_cli.formats.tokens import Lines, without_comments

_SEPARATORS = bytes.maketrans(b",;", b"  ")
_COMMENT = re.compile(rb"(?:#|//)([^\r\n]*)")
_HEAD = 4096  # bytes in which a comment may name the columns
_MOST_SHOWN = 40  # characters of a token in a message
_POSITION = (("x", "y", "z"),)
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
class PointTable:
    """The points of a text."""

    names: tuple[str, ...]  # of the columns, in lower case, from a line above the points; or empty
    counts: tuple[int, ...]  # of the points that follow lines of a single number
    values: Float64s  # shape (P, K), maybe infinite or NaN
    starts: Int64s  # where they are in the file, shape (P, K)
    ends: Int64s


def read_table(data: bytes, name: str) -> PointTable:
    """Read lines of numbers between blanks, tabs, commas or semicolons; InputError with the line if that fails."""
    if b"\0" in data[:_HEAD]:
        raise InputError(name, "it is no plain text", "export its points as lines of numbers, or as PLY")
    return _Reader(data, name).read()


class _Reader(Lines):
    """The lines of a text; `rows` are those that have any token."""

    def __init__(self, data: bytes, name: str) -> None:
        head = data[:_HEAD].translate(_SEPARATORS)
        self._comments = [found.split() for found in _COMMENT.findall(head)]
        super().__init__(data, without_comments(data.translate(_SEPARATORS), b"#", b"//"), name)

    def read(self) -> PointTable:
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
        return PointTable(names, counts, values, self.starts[tokens], self.ends[tokens])

    def _take_names(self) -> tuple[str, ...]:
        """Take off the first line with more than a count, if it has words in place of numbers."""
        for row in range(min(2, len(self.heads))):
            first, stop = self.heads[row], self.stops[row]
            words = [self.word(t) for t in range(first, stop)]
            if not any(_is_number(word) for word in words):
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


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _column_names(words: list[bytes]) -> tuple[str, ...]:
    shown = (word[:_MOST_SHOWN].decode("ascii", "replace").lower() for word in words)
    return tuple("".join(c if c.isprintable() else "?" for c in word) for word in shown)


@dataclass(frozen=True)
class Columns:
    """Which columns are what: three of the position, three colours or one intensity, three of the normal or none."""

    position: tuple[int, ...]
    colours: tuple[int, ...]
    normal: tuple[int, ...]
    others: dict[str, int]  # the rest that has a name
    notice: str

    @property
    def channels(self) -> tuple[str, ...]:
        return _RGB if len(self.colours) == 3 else ("intensity",)

    def names(self, count: int) -> list[str]:
        """Return what each of all columns was taken for."""
        names = ["?"] * count
        known = zip(self.position, ("x", "y", "z"), strict=True)
        for column, name in (*known, *zip(self.colours, self.channels, strict=True)):
            names[column] = name
        for column, name in zip(self.normal, _NORMAL, strict=False):
            names[column] = name
        for name, column in self.others.items():
            names[column] = name
        return names


def find_columns(table: PointTable, name: str) -> Columns:
    """Return what the columns of a table are; InputError if there are no positions or colours, or it is not clear."""
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
        cause = "the normals cannot be distinguished from colours"
        cause = "columns 4 to 6 are normals, and no colours" if width == 6 else cause
        raise InputError(name, cause, _REMEDY)
    names = ("x", "y", "z", *layouts[0])
    notice = "" if width == 6 else f"Its {width} columns are taken for {' '.join(names)}."
    return _by_name(names, name, notice)


def _by_name(names: tuple[str, ...], name: str, notice: str) -> Columns:
    position = _together(names, _POSITION)
    if not position:
        raise InputError(name, f"the columns {' '.join(names)[:200]} have no x, y and z", _REMEDY)
    intensity = next(((names.index(known),) for known in _INTENSITIES if known in names), ())
    colours = _together(names, _COLOURS) or intensity
    if not colours:
        raise UnpaintedError(name, f"the columns {' '.join(names)[:200]} have no colours", _REMEDY)
    normal = _together(names, _NORMALS)
    used = {*position, *colours, *normal}
    others = {known: column for column, known in enumerate(names) if column not in used}
    return Columns(position, colours, normal, others, notice)


def _together(names: tuple[str, ...], triples: tuple[tuple[str, ...], ...]) -> tuple[int, ...]:
    """Return the columns of the first triple of names that is there."""
    for triple in triples:
        if all(known in names for known in triple):
            return tuple(names.index(known) for known in triple)
    return ()


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
