"""Material libraries (MTL): the texture maps of each material, and where their file names stand.

References
----------
.. [1] Wavefront Technologies, "Advanced Visualizer manual, appendix B2: MTL material format".
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from beltrami_cli.surface.records import Slot

SLOTS: dict[str, Slot] = {
    "map_kd": "baseColor",
    "map_ke": "emissive",
    "norm": "normal",
    "map_bump": "normal",
    "bump": "normal",
}
"""What is painted by the maps of a keyword; the first keyword that a material has is the one that counts."""

# Possessive (++), so that lines of a million blanks or digits are not tried again from each of them.
_STATEMENT = re.compile(
    rb"^[ \t]*+(newmtl|(?!map_aat\b)map_\w+|bump|disp|decal|refl|norm)[ \t]++([^\r\n]*[^\s])",
    re.IGNORECASE | re.MULTILINE,
)
_NUMBERS = rb"(?:[ \t]++[-+]?(?:\d++\.?\d*+|\.\d++)(?:e[-+]?\d++)?(?=[ \t])){1,3}"
_OPTION = re.compile(
    rb"-(?:([ost])(" + _NUMBERS + rb")|mm(?:[ \t]+\S+){2}|(\w+)[ \t]+(\S+))[ \t]+", re.IGNORECASE
)


@dataclass(frozen=True)
class Map:
    """A texture map of a material.

    Attributes
    ----------
    material : str
        The material's name.
    keyword : str
        "map_kd" and so on, in lower case.
    name : str
        The file, as it is named there.
    start, end : int
        Where the name stands in the library, in bytes.
    scale, offset : tuple of two float
        What texture coordinates (v up) are multiplied with, and then added to them.
    clamped : bool
        Whether the image is not repeated.
    """

    material: str
    keyword: str
    name: str
    start: int
    end: int
    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)
    clamped: bool = False


def read_maps(text: bytes) -> tuple[list[str], list[Map]]:
    """Return the names of the materials of a library, and all its maps, in file order."""
    materials: list[str] = []
    maps = []
    for match in _STATEMENT.finditer(text):
        keyword = match[1].lower().decode("ascii")
        if keyword == "newmtl":
            materials.append(os.fsdecode(match[2]))
        else:
            maps.append(_read_map(materials[-1] if materials else "", keyword, match[2], match.start(2)))
    return materials, maps


def _read_map(material: str, keyword: str, rest: bytes, start: int) -> Map:
    """Read options up to the file name, which may hold blanks and stand in quotes."""
    scale, offset, clamped = (1.0, 1.0), (0.0, 0.0), False
    at = 0
    while option := _OPTION.match(rest, at):
        at = option.end()
        numbers = option[1].lower() if option[1] else b""  # none, if what follows is no number
        if numbers == b"s":
            scale = _pair(option[2], 1.0)
        elif numbers == b"o":
            offset = _pair(option[2], 0.0)
        elif option[3] and option[3].lower() == b"clamp":
            clamped = option[4].lower() == b"on"
    name = rest[at:]
    if len(name) > 2 and name[:1] == name[-1:] == b'"':
        name, at = name[1:-1], at + 1
    begin = start + at
    return Map(material, keyword, os.fsdecode(name), begin, begin + len(name), scale, offset, clamped)


def _pair(numbers: bytes, default: float) -> tuple[float, float]:
    values = [*(float(number) for number in numbers.split()), default]
    return values[0], values[1]
