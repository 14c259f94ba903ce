"""Which columns of a table of points are positions, colours and normals, by their names."""

from __future__ import annotations

from dataclasses import dataclass

from beltrami_cli.arrays import Float64s
from beltrami_cli.errors import InputError, NoColoursError
from beltrami_cli.formats.points.unnamed_columns import NORMAL, POSITION, RGB, example_of, names_by_values

_COLOUR_NAMES = (("r", "g", "b"), RGB, ("rf", "gf", "bf"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
_NORMAL_NAMES = (NORMAL, ("normal_x", "normal_y", "normal_z"))
_INTENSITIES = ("intensity", "i", "scalar_intensity", "reflectance", "grey", "gray")
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
    return {*POSITION} <= {*words}


def column_names(line: bytes) -> tuple[str, ...]:
    """Return the names in a line; they may contain blanks and quotes if the separator is another character."""
    separator = next((each for each in (b";", b",", b"\t") if each in line), None)
    words = (word.strip(b" \t\"'")[:_MAX_SHOWN] for word in line.strip().split(separator))
    shown = (word.decode("ascii", "replace").lower() for word in words)
    return tuple("".join(c if c.isprintable() else "?" for c in word) for word in shown)


def find_columns(names: tuple[str, ...], values: Float64s, name: str, *, is_pts: bool) -> Columns:
    """Find the columns of values, shape (P, K), by their names or, without any, by `names_by_values`."""
    if names:
        return _columns_by_name(names, name, "")
    names = names_by_values(values, name, is_pts=is_pts)
    width = len(names)
    notice = "" if width == 6 else f"Its {width} columns are taken for {' '.join(names)}."
    return _columns_by_name(names, name, notice)


def _columns_by_name(names: tuple[str, ...], name: str, notice: str) -> Columns:
    remedy = example_of(len(names))
    position = _first_present(names, (POSITION,))
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
