"""Which columns of a table of points without names are positions, colours and normals.

The first three columns are x, y and z, and three neighbouring columns are red, green and blue if they can be colours
and no other three can:

- integers of 0 to 255; without any, numbers of 0 to 1; without any, integers of 0 to 65535;
- not all constant, and no normals, which are recognised by their length;
- columns that all have many different values go before columns with few, such as a classification.

With four columns, the fourth is an intensity. Everything else is refused with the option that decides.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Float64s
from beltrami_cli.errors import InputError, NoColoursError

POSITION, RGB, NORMAL = ("x", "y", "z"), ("red", "green", "blue"), ("nx", "ny", "nz")
_UNIT_TOLERANCE = 0.01  # how far the length of a normal may be from 1, for as few decimals as two
# Different values: the classes of LAS have 5 bits (ASPRS, LAS 1.4, table 8), and its other codes fewer.
_MAX_CODES = 32
_SAMPLE_SIZE = 1 << 12  # values that are counted first, since sorting all takes a second per ten million
_REMEDY = "give --columns with all of their names, such as {}, or the names in a first line"


@dataclass(frozen=True)
class _Column:
    """What the finite values of a column say of it; NaN if there are none."""

    low: float
    high: float
    is_whole: bool
    is_constant: bool
    has_few: bool  # at most `_MAX_CODES` different values

    @classmethod
    def of(cls, column: Float64s) -> _Column:
        finite = column[np.isfinite(column)]
        if not finite.size:
            return cls(np.nan, np.nan, is_whole=False, is_constant=True, has_few=True)
        count = len(np.unique(finite[:_SAMPLE_SIZE]))
        if count <= _MAX_CODES:
            count = len(np.unique(finite))
        is_whole = bool((np.rint(finite) == finite).all())
        return cls(
            float(finite.min()),
            float(finite.max()),
            is_whole,
            is_constant=count == 1,
            has_few=count <= _MAX_CODES,
        )

    @property
    def is_code(self) -> bool:
        """Whether it can be a code, as of a class, if there are more points than codes."""
        return self.is_whole and self.has_few and self.low >= 0 and 1 < self.high < _MAX_CODES


_Triple = Sequence[_Column]
"""Three neighbouring columns."""


def names_by_values(values: Float64s, name: str, *, is_pts: bool) -> tuple[str, ...]:
    """Name all columns, shape (P, K); InputError if two readings are possible, or none.

    `is_pts`: a line above the points says how many they are; in PTS files seven columns are x y z intensity r g b.
    """
    width = values.shape[1]
    if width == 3:
        cause = "its points have 3 numbers each, so there are no colours"
        raise NoColoursError(name, cause, "add r g b to each line")
    if width == 4:
        return (*POSITION, "intensity")
    measured = np.isfinite(values[:, :3]).all(axis=1)
    points = values if measured.all() else values[measured]
    normals = [start for start in range(3, width - 2) if _are_normals(points[:, start : start + 3])]
    starts = _colour_starts(points, normals)
    if len(starts) > 1:
        explained = [start for start in starts if _normals_apart_from(start, normals)]
        starts = explained if len(explained) == 1 else starts
    if is_pts and width == 7 and 4 in starts:
        starts = [4]
    if len(starts) != 1:
        raise InputError(name, _ambiguity(starts, normals, width), example_of(width))
    found = {starts[0] + channel: RGB[channel] for channel in range(3)}
    for normal in _normals_apart_from(starts[0], normals)[:1]:
        found |= {normal + axis: NORMAL[axis] for axis in range(3)}
    if starts[0] == 4:
        found[3] = "intensity"
    return (*POSITION, *(found.get(column, f"column_{column + 1}") for column in range(3, width)))


def _ambiguity(starts: list[int], normals: list[int], width: int) -> str:
    if starts:
        return f"the colours can be columns {' or '.join(f'{start + 1} to {start + 3}' for start in starts)}"
    if normals:
        return f"columns {normals[0] + 1} to {normals[0] + 3} are normals, and no colours"
    return f"its points have {width} numbers each, and it is not clear which are colours"


def example_of(width: int) -> str:
    """Return the remedy for ambiguous columns, with an example of that many names."""
    names = ("x", "y", "z", "r", "g", "b", "scalar")[:width]
    return _REMEDY.format(",".join((*names, *(f"scalar{number}" for number in range(2, width - 5)))))


def _colour_starts(points: Float64s, normals: list[int]) -> list[int]:
    """Return the first columns of candidates for the colours; `normals`: first columns of unit vectors."""
    columns = [_Column.of(column) for column in points[:, 3:].T]
    triples = {3 + first: columns[first : first + 3] for first in range(len(columns) - 2)}
    can_be_codes = len(points) > _MAX_CODES  # among fewer points, few values say nothing
    possible = {
        start: triple
        for start, triple in triples.items()
        if not (can_be_codes and _are_codes(triple)) and not (start in normals and _are_signed(triple))
    }
    if len(triples) == 1:
        return list(possible)
    if len(points) > 1:
        possible = {
            start: triple
            for start, triple in possible.items()
            if not all(column.is_constant for column in triple)
        }
    return _of_best_range(possible)


def _are_codes(triple: _Triple) -> bool:
    """Whether columns are codes, or two integers of 16 bits with one: intensity, return, class."""
    codes = [column.is_code for column in triple]
    return all(codes) or (any(codes) and any(column.high > 255 for column in triple))


def _are_signed(triple: _Triple) -> bool:
    """Whether vectors of unit length are not pure red, green and blue."""
    return any(column.low < 0 or not column.is_whole for column in triple)


def _of_best_range(triples: Mapping[int, _Triple]) -> list[int]:
    """Choose the columns that fit the range of colours best; columns with many different values go first."""
    rich = {start for start, triple in triples.items() if not any(column.has_few for column in triple)}
    fractions = _within(triples, 1, whole=False)
    octets = [start for start in _within(triples, 255) if start not in fractions]
    words = _within(triples, 65535)
    if rich.intersection(octets):
        return [start for start in octets if start in rich]
    # Codes from 0 to 255 may accompany colours of another range.
    finer = rich.intersection(fractions) or rich.intersection(words)
    return sorted(finer.union(octets)) or fractions or words


def _within(triples: Mapping[int, _Triple], most: float, *, whole: bool = True) -> list[int]:
    return [
        start
        for start, triple in triples.items()
        if all(
            column.low >= 0 and column.high <= most and (column.is_whole or not whole) for column in triple
        )
    ]


def _are_normals(triple: Float64s) -> bool:
    """Whether all vectors have length 1, or 0 where none is known."""
    finite = triple[np.isfinite(triple).all(axis=1)]
    for vectors in (finite[:_SAMPLE_SIZE], finite):
        with np.errstate(over="ignore"):
            lengths = np.linalg.norm(vectors, axis=1)
        if not ((np.abs(lengths - 1) < _UNIT_TOLERANCE) | (lengths == 0)).all():
            return False
    return bool(lengths.any())


def _normals_apart_from(colours: int, normals: list[int]) -> list[int]:
    """Return the normals that share no column with some colours."""
    return [start for start in normals if abs(start - colours) >= 3]
