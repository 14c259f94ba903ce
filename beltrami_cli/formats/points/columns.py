"""Which columns of a table of points are positions, colours and normals: by their names, or else by their values.

The names are in a line above the points, or given. Without names the first three columns are x, y and z, and three
neighbouring columns are red, green and blue if they can be colours and no other three can:

- integers of 0 to 255; without any, numbers of 0 to 1; without any, integers of 0 to 65535;
- not all constant, and no normals, which are recognised by their length;
- columns that all have many different values go before columns with few, such as a classification.

With four columns, the fourth is an intensity. Everything else is refused with the option that decides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Bools, Float64s
from beltrami_cli.errors import InputError, NoColoursError

RGB, NORMAL = ("red", "green", "blue"), ("nx", "ny", "nz")
_POSITION = ("x", "y", "z")
_COLOUR_NAMES = (("r", "g", "b"), RGB, ("rf", "gf", "bf"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
_NORMAL_NAMES = (NORMAL, ("normal_x", "normal_y", "normal_z"))
_INTENSITIES = ("intensity", "i", "scalar_intensity", "reflectance", "grey", "gray")
_UNIT_TOLERANCE = 0.01  # how far the length of a normal may be from 1, for as few decimals as two
# Different values: the classes of LAS have 5 bits (ASPRS, LAS 1.4, table 8), and its other codes fewer.
_MAX_CODES = 32
_SAMPLE_SIZE = 1 << 12  # values that are counted first, since sorting all takes a second per ten million
_REMEDY = "give --columns with all of their names, such as {}, or the names in a first line"
_MAX_SHOWN = 40  # characters of a name in a message


@dataclass(frozen=True)
class Columns:
    """The meaning of columns: three positions, three colours or one intensity, three normals or none."""

    position: tuple[int, ...]
    colours: tuple[int, ...]
    normal: tuple[int, ...]
    others: dict[str, int]  # the rest that has a name
    names: tuple[str, ...]  # of all columns, or what they were taken for
    notice: str


def is_header(words: tuple[str, ...]) -> bool:
    """Whether words are names of columns instead of a sentence."""
    return {*_POSITION} <= {*words}


def column_names(line: bytes) -> tuple[str, ...]:
    """Return the names in a line; they may contain blanks and quotes if the separator is another character."""
    separator = next((each for each in (b";", b",", b"\t") if each in line), None)
    words = (word.strip(b" \t\"'")[:_MAX_SHOWN] for word in line.strip().split(separator))
    shown = (word.decode("ascii", "replace").lower() for word in words)
    return tuple("".join(c if c.isprintable() else "?" for c in word) for word in shown)


def find_columns(names: tuple[str, ...], values: Float64s, name: str, *, is_pts: bool) -> Columns:
    """Find the columns of values, shape (P, K), by their names or, without any, by the values.

    `is_pts`: a line above the points says how many they are; in PTS files seven columns are x y z intensity r g b.
    """
    if names:
        return _columns_by_name(names, name, "")
    width = values.shape[1]
    if width == 3:
        cause = "its points have 3 numbers each, so there are no colours"
        raise NoColoursError(name, cause, "add r g b to each line")
    names = (*_POSITION, *(("intensity",) if width == 4 else _names_by_values(values, name, is_pts)))
    notice = "" if width == 6 else f"Its {width} columns are taken for {' '.join(names)}."
    return _columns_by_name(names, name, notice)


def _names_by_values(values: Float64s, name: str, is_pts: bool) -> tuple[str, ...]:
    """Name the columns behind x, y and z by their values; InputError if two readings are possible, or none."""
    measured, width = np.isfinite(values[:, :3]).all(axis=1), values.shape[1]
    points = values if measured.all() else values[measured]
    normals = [start for start in range(3, width - 2) if _are_normals(points[:, start : start + 3])]
    starts = _colour_starts(points, normals)
    if len(starts) > 1:
        explained = [start for start in starts if _normals_apart_from(start, normals)]
        starts = explained if len(explained) == 1 else starts
    if is_pts and width == 7 and 4 in starts:
        starts = [4]
    if len(starts) != 1:
        shown = " or ".join(f"{start + 1} to {start + 3}" for start in starts)
        unclear = f"its points have {width} numbers each, and it is not clear which are colours"
        if normals:
            unclear = f"columns {normals[0] + 1} to {normals[0] + 3} are normals, and no colours"
        cause = f"the colours can be columns {shown}" if starts else unclear
        raise InputError(name, cause, example_of(width))
    found = {starts[0] + channel: RGB[channel] for channel in range(3)}
    for normal in _normals_apart_from(starts[0], normals)[:1]:
        found |= {normal + axis: NORMAL[axis] for axis in range(3)}
    if starts[0] == 4:
        found[3] = "intensity"
    return tuple(found.get(column, f"column_{column + 1}") for column in range(3, width))


def example_of(width: int) -> str:
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
    is_few = (count <= _MAX_CODES) & (len(points) > _MAX_CODES)
    is_code = (is_whole & is_few & positive & (high > 1) & (high < _MAX_CODES))[triples]
    # Three columns are codes, or two integers of 16 bits with one: intensity, return, class.
    are_codes = is_code.all(axis=1) | (is_code.any(axis=1) & (high[triples] > 255).any(axis=1))
    # Pure red, green and blue have length 1 as well.
    is_signed = ((low < 0) | ~is_whole)[triples].any(axis=1) & np.isin(triples[:, 0] + 3, normals)
    possible = ~are_codes & ~is_signed
    if len(triples) > 1:
        if len(points) > 1:
            possible &= (count > 1)[triples].any(axis=1)
        possible = _best_range(
            possible & (positive & is_whole & (high <= 255))[triples].all(axis=1),
            possible & (positive & (high <= 1))[triples].all(axis=1),
            possible & (positive & is_whole & (high <= 65535))[triples].all(axis=1),
            (count > _MAX_CODES)[triples].all(axis=1),
        )
    return (3 + np.flatnonzero(possible)).tolist()


def _best_range(bytes_: Bools, fractions: Bools, words: Bools, rich: Bools) -> Bools:
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
    for vectors in (finite[:_SAMPLE_SIZE], finite):
        with np.errstate(over="ignore"):
            lengths = np.linalg.norm(vectors, axis=1)
        if not ((np.abs(lengths - 1) < _UNIT_TOLERANCE) | (lengths == 0)).all():
            return False
    return bool(lengths.any())


def _normals_apart_from(colours: int, normals: list[int]) -> list[int]:
    """Return the normals that share no column with some colours."""
    return [start for start in normals if abs(start - colours) >= 3]


def _range_of(column: Float64s) -> tuple[float, float, bool, int]:
    """Return the extremes of the finite values, whether they are integers, and how many differ, of some if many."""
    finite = column[np.isfinite(column)]
    if not finite.size:
        return np.nan, np.nan, False, 0
    count = len(np.unique(finite[:_SAMPLE_SIZE]))
    if count <= _MAX_CODES:
        count = len(np.unique(finite))
    return float(finite.min()), float(finite.max()), bool((np.rint(finite) == finite).all()), count


def _columns_by_name(names: tuple[str, ...], name: str, notice: str) -> Columns:
    remedy = example_of(len(names))
    position = _first_present(names, (_POSITION,))
    if not position:
        raise InputError(name, f"the columns {' '.join(names)[:200]} have no x, y and z", remedy)
    intensity = next(((names.index(known),) for known in _INTENSITIES if known in names), ())
    colours = _first_present(names, _COLOUR_NAMES) or intensity
    if not colours:
        raise NoColoursError(name, f"the columns {' '.join(names)[:200]} have no colours", remedy)
    normal = _first_present(names, _NORMAL_NAMES)
    used = {*position, *colours, *normal}
    others = {known: column for column, known in enumerate(names) if column not in used}
    return Columns(position, colours, normal, others, names, notice)


def _first_present(names: tuple[str, ...], triples: tuple[tuple[str, ...], ...]) -> tuple[int, ...]:
    found = next((triple for triple in triples if {*triple} <= {*names}), ())
    return tuple(names.index(known) for known in found)
