"""Which columns of a table of points are the position, the colour and the normal: by their names, or by their values.

The first three columns are x, y and z. Without names, three neighbouring columns are red, green and blue if they can
be colours and no other three can:

- integers of 0 to 255; without any, numbers of 0 to 1; without any, integers of 0 to 65535;
- not all constant, and no normals, which are recognised by their length;
- columns that all have many different values go before columns with few, such as a classification.

With four columns, the fourth is an intensity. Everything else is refused with the option that decides.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Bools, Float64s
from beltrami_cli.errors import InputError, UnpaintedError

RGB, NORMAL = ("red", "green", "blue"), ("nx", "ny", "nz")
_POSITION = ("x", "y", "z")
_COLOURS = (("r", "g", "b"), RGB, ("rf", "gf", "bf"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
_NORMALS = (NORMAL, ("normal_x", "normal_y", "normal_z"))
_INTENSITIES = ("intensity", "i", "scalar_intensity", "reflectance", "grey", "gray")
_UNIT = 0.01  # how far the length of a normal may be from 1, for as few decimals as two
# Different values: the classes of LAS have 5 bits (ASPRS, LAS 1.4, table 8), and its other codes fewer.
_CODES = 32
_SAMPLE = 1 << 12  # values that are counted first, since sorting all takes a second per ten million
_REMEDY = "give --columns with all of their names, such as {}, or the names in a first line"


@dataclass(frozen=True)
class Columns:
    """Which columns are what: three of the position, three colours or one intensity, three of the normal or none."""

    position: tuple[int, ...]
    colours: tuple[int, ...]
    normal: tuple[int, ...]
    others: dict[str, int]  # the rest that has a name
    names: tuple[str, ...]  # of all columns, or what they were taken for
    notice: str


def is_header(words: tuple[str, ...]) -> bool:
    """Whether words are names of columns, and not a sentence."""
    return {*_POSITION} <= {*words}


def find_columns(names: tuple[str, ...], values: Float64s, name: str, *, is_pts: bool) -> Columns:
    """Find the columns of values, shape (P, K), by their names or, without any, by the values.

    `is_pts`: a line above the points says how many they are; in PTS files seven columns are x y z intensity r g b.
    """
    if names:
        return _by_name(names, name, "")
    width = values.shape[1]
    if width == 3:
        cause = "its points have 3 numbers each, so there are no colours"
        raise UnpaintedError(name, cause, "add r g b to each line")
    names = (*_POSITION, *(("intensity",) if width == 4 else _further_names(values, name, is_pts)))
    notice = "" if width == 6 else f"Its {width} columns are taken for {' '.join(names)}."
    return _by_name(names, name, notice)


def _further_names(values: Float64s, name: str, is_pts: bool) -> tuple[str, ...]:
    """Name the columns behind x, y and z by their values; InputError if two readings are possible, or none."""
    columns = _Values(values)
    starts = columns.colour_starts(is_pts=is_pts)
    width = values.shape[1]
    if len(starts) != 1:
        shown = " or ".join(f"{start + 1} to {start + 3}" for start in starts)
        unclear = f"its points have {width} numbers each, and it is not clear which are colours"
        normals = "columns 4 to 6 are normals, and no colours"
        cause = f"the colours can be columns {shown}" if starts else normals if columns.normals else unclear
        raise InputError(name, cause, example_of(width))
    found = {starts[0] + channel: RGB[channel] for channel in range(3)}
    if (normal := columns.normal_beside(starts[0])) is not None:
        found |= {normal + axis: NORMAL[axis] for axis in range(3)}
    if starts[0] == 4:
        found[3] = "intensity"
    return tuple(found.get(column, f"column_{column + 1}") for column in range(3, width))


def example_of(width: int) -> str:
    """Return the remedy where columns are not clear, with an example of that many names."""
    names = ("x", "y", "z", "r", "g", "b", "scalar")[:width]
    return _REMEDY.format(",".join((*names, *(f"scalar{number}" for number in range(2, width - 5)))))


class _Values:
    """What the values of columns can be."""

    def __init__(self, values: Float64s) -> None:
        measured = np.isfinite(values[:, :3]).all(axis=1)
        self._values = values if measured.all() else values[measured]
        self._width = values.shape[1]
        ranges = [_range_of(column) for column in self._values[:, 3:].T]
        self._low, self._high, is_whole, count = np.array(ranges).reshape(-1, 4).T
        self._is_whole, self._count = is_whole > 0, count
        # Where there are no more points than codes, few values say nothing.
        self._is_code = (
            self._is_whole & (self._count <= _CODES) & (len(self._values) > _CODES)
            & (self._low >= 0) & (self._high > 1) & (self._high < _CODES)
        )  # fmt: skip
        self.normals = [start for start in self._starts() if self._is_normal(start)]

    def _starts(self) -> range:
        return range(3, self._width - 2)

    def colour_starts(self, *, is_pts: bool) -> list[int]:
        """Return the first column of each three that can be the colours."""
        possible = [start for start in self._starts() if not self._is_signed_normal(start)]
        if self._width == 6:
            return [start for start in possible if not self._are_codes(start)]
        possible = [start for start in possible if self._varies(start) and not self._are_codes(start)]
        found = self._chosen(possible)
        if len(found) > 1:
            explained = [start for start in found if self.normal_beside(start) is not None]
            found = explained if len(explained) == 1 else found
        if len(found) > 1 and is_pts and self._width == 7 and 4 in found:
            return [4]
        return found

    def _chosen(self, possible: list[int]) -> list[int]:
        """Return the columns that fit the range of colours best."""
        bytes_, fractions, words = (
            [start for start in possible if fits[start - 3 : start].all()] for fits in self._ranges()
        )
        bytes_ = [start for start in bytes_ if start not in fractions]
        rich = [[start for start in starts if self._is_rich(start)] for starts in (bytes_, fractions, words)]
        if rich[0]:
            return rich[0]
        # Codes of 0 to 255 may be next to colours of another range.
        found = sorted({*bytes_, *(rich[1] or rich[2])})
        return found or fractions or words

    def _ranges(self) -> Iterator[Bools]:
        within = (self._low >= 0) & np.isfinite(self._high)
        yield self._is_whole & within & (self._high <= 255)
        yield within & (self._high <= 1)
        yield self._is_whole & within & (self._high <= 65535)

    def _is_rich(self, start: int) -> bool:
        return bool((self._count[start - 3 : start] > _CODES).all())

    def _varies(self, start: int) -> bool:
        # In a table of one point nothing does.
        return len(self._values) == 1 or bool((self._count[start - 3 : start] > 1).any())

    def _are_codes(self, start: int) -> bool:
        """Whether three columns are codes, or two integers of 16 bits with one: intensity, return, class."""
        codes, high = self._is_code[start - 3 : start], self._high[start - 3 : start]
        return bool(codes.all() or (codes.any() and (high > 255).any()))

    def _is_normal(self, start: int) -> bool:
        """Whether all vectors have length 1, or 0 where none is known."""
        triple = self._triple(start)
        for vectors in (triple[:_SAMPLE], triple):
            lengths = np.linalg.norm(vectors, axis=1)
            if not ((np.abs(lengths - 1) < _UNIT) | (lengths == 0)).all():
                return False
        return bool(lengths.any())

    def _is_signed_normal(self, start: int) -> bool:
        # Pure red, green and blue have length 1 as well.
        triple = self._triple(start)
        return start in self.normals and bool(((triple < 0) | (triple % 1 != 0)).any())

    def _triple(self, start: int) -> Float64s:
        triple = self._values[:, start : start + 3]
        return triple[np.isfinite(triple).all(axis=1)]

    def normal_beside(self, colours: int) -> int | None:
        """Return the first column of normals that are no colours of some."""
        return next((start for start in self.normals if abs(start - colours) >= 3), None)


def _range_of(column: Float64s) -> tuple[float, float, bool, int]:
    """Return the extremes of the finite values, whether they are integers, and how many differ, of some if many."""
    finite = column[np.isfinite(column)]
    if not finite.size:
        return np.nan, np.nan, False, 0
    count = len(np.unique(finite[:_SAMPLE]))
    if count <= _CODES:
        count = len(np.unique(finite))
    return float(finite.min()), float(finite.max()), bool((np.rint(finite) == finite).all()), count


def _by_name(names: tuple[str, ...], name: str, notice: str) -> Columns:
    remedy = example_of(len(names))
    position = _together(names, (_POSITION,))
    if not position:
        raise InputError(name, f"the columns {' '.join(names)[:200]} have no x, y and z", remedy)
    intensity = next(((names.index(known),) for known in _INTENSITIES if known in names), ())
    colours = _together(names, _COLOURS) or intensity
    if not colours:
        raise UnpaintedError(name, f"the columns {' '.join(names)[:200]} have no colours", remedy)
    normal = _together(names, _NORMALS)
    used = {*position, *colours, *normal}
    others = {known: column for column, known in enumerate(names) if column not in used}
    return Columns(position, colours, normal, others, names, notice)


def _together(names: tuple[str, ...], triples: tuple[tuple[str, ...], ...]) -> tuple[int, ...]:
    found = next((triple for triple in triples if {*triple} <= {*names}), ())
    return tuple(names.index(known) for known in found)
