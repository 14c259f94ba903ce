"""What the columns of a cloud are: by their names, or by how many there are.

Without names 6 columns are x y z r g b, 4 are x y z intensity and 7 are x y z intensity r g b. 9 and 10 have normals as
well, before or behind the colours, which are recognised by their length.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import InputError, UnpaintedError

if TYPE_CHECKING:
    from beltrami_cli.arrays import Float64s
    from beltrami_cli.formats.points.table import PointTable

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
class Columns:
    """Which columns are what: three of the position, three colours or one intensity, three of the normal or none."""

    position: tuple[int, ...]
    colours: tuple[int, ...]
    normal: tuple[int, ...]
    others: dict[str, int]
    """The rest that has a name."""
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
        raise UnpaintedError(
            name, "its points have 3 numbers each, so there are no colours", "add r g b to each line"
        )
    if width not in _KNOWN:
        raise InputError(
            name, f"its points have {width} numbers each, and it is not clear which are colours", _REMEDY
        )
    layouts = [layout for layout in _KNOWN[width] if _fits(layout, table.values)]
    if not layouts:
        cause = (
            "columns 4 to 6 are normals, and no colours"
            if width == 6
            else "the normals cannot be distinguished from colours"
        )
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
