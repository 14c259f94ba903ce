"""The materials of an OBJ file: its libraries (MTL) [1]_, their numbers and texture maps, and the image files.

References
----------
.. [1] Wavefront Technologies, "Advanced Visualizer manual, appendix B2: MTL material format".
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import PurePosixPath

from beltrami_cli.errors import Obstacle
from beltrami_cli.formats.colours import emission_and_strength
from beltrami_cli.formats.sidecars.model_folder import IGNORED, ModelFolder, UnfitReferenceError, is_outside
from beltrami_cli.surface.records import Material, Slot

SLOTS: dict[str, Slot] = {
    "map_kd": "baseColor",
    "map_ke": "emissive",
    "norm": "normal",
    "map_bump": "normal",
    "bump": "normal",
}
"""The slot of each map keyword; the first keyword that a material has counts."""

MAP_SLOTS = tuple(dict.fromkeys(SLOTS.values()))  # the slots that maps fill
# Maps that are no loss in other formats, and that get the new image, if they show that of the base colour.
BASE_COLOUR_ALIASES = ("map_ka", "map_d")
_BASE_COLOUR_COMPANIONS = (*BASE_COLOUR_ALIASES, "map_ks")  # all that get it
# Possessive (++), against quadratic time on lines of a million blanks or digits.
_STATEMENT = re.compile(
    rb"^(?:\xef\xbb\xbf)?[ \t]*+(newmtl|kd|ke|d|tr|pm|pr|(?!map_aat\b)map_\w+|bump|disp|decal|refl|norm)"
    rb"[ \t]++([^\r\n]*[^\s])",
    re.IGNORECASE | re.MULTILINE,
)
_FACTORS = ("kd", "ke", "d", "tr", "pm", "pr")  # keywords that numbers follow
_NUMBERS = rb"(?:[ \t]++[-+]?(?:\d++\.?\d*+|\.\d++)(?:e[-+]?\d++)?(?=[ \t])){1,3}"
_OPTION = re.compile(
    rb"-(?:([ost])(" + _NUMBERS + rb")|mm(?:[ \t]+\S+){2}|(\w+)[ \t]+(\S+))[ \t]+", re.IGNORECASE
)
_END_OF_NAME = re.compile(r"\.mtl(?=\s|$)", re.IGNORECASE)
_WORD = re.compile(r"\S+")

_MAX_BYTES = 1 << 24  # of a material file that are read: some 50,000 materials of ten lines
_MAX_NOTICES = 20


@dataclass(frozen=True)
class Map:
    """A texture map of a material."""

    material: str
    keyword: str  # "map_kd" and so on, in lower case
    name: str  # file name as spelled in the library
    start: int  # offset of the name in the library
    end: int
    scale: tuple[float, float] = (1.0, 1.0)  # texture coordinates (v up) are multiplied by this
    offset: tuple[float, float] = (0.0, 0.0)  # and this is added
    clamped: bool = False  # whether the image is not repeated
    channel: str = ""  # channel of the image for a scalar map (r, g, b, m for alpha, l, z), or empty


Factors = dict[str, list[float]]
"""The numbers of a material, by keyword in lower case."""


def _read_library(text: bytes) -> tuple[dict[str, Factors], list[Map]]:
    """Return the materials of a library by name, and all its maps in file order."""
    materials, name, factors = dict[str, Factors](), "", Factors()
    maps = []
    for match in _STATEMENT.finditer(text):
        keyword = match[1].lower().decode("ascii")
        if keyword == "newmtl":
            name = os.fsdecode(match[2])
            materials[name] = factors = {}
        elif keyword not in _FACTORS:
            maps.append(_read_map(name, keyword, match[2], match.start(2)))
        elif numbers := _finite_numbers(match[2]):
            factors[keyword] = numbers
    return materials, maps


def _finite_numbers(text: bytes) -> list[float]:
    try:
        values = [float(word) for word in text.split(b"#")[0].split()]
    except ValueError:  # a spectrum in a file, or another space of colours
        return []
    return values if all(map(isfinite, values)) else []


def _read_map(material: str, keyword: str, arguments: bytes, start: int) -> Map:
    """Read options up to the file name, which may hold blanks and stand in quotes."""
    scale, offset, clamped, channel = (1.0, 1.0), (0.0, 0.0), False, ""
    at = 0
    while option := _OPTION.match(arguments, at):
        at = option.end()
        match (option[1] or option[3] or b"").lower():  # a letter, if what follows is a number
            case b"s" if option[2]:
                scale = _pair(option[2], 1.0)
            case b"o" if option[2]:
                offset = _pair(option[2], 0.0)
            case b"clamp":
                clamped = option[4].lower() == b"on"
            case b"imfchan":
                channel = option[4].lower().decode("ascii", "replace")
    name = arguments[at:]
    if len(name) > 2 and name[:1] == name[-1:] == b'"':
        name, at = name[1:-1], at + 1
    begin = start + at
    end = begin + len(name)
    return Map(material, keyword, os.fsdecode(name), begin, end, scale, offset, clamped, channel)


def _pair(numbers: bytes, default: float) -> tuple[float, float]:
    values = [*(float(number) for number in numbers.split()), default]
    return values[0], values[1]


@dataclass(frozen=True)
class Library:
    """A material file."""

    path: str  # relative to the folder of the model
    data: bytes
    materials: Mapping[str, Factors]
    # In file order, each with the path of its file or None.
    maps: tuple[tuple[Map, str | None], ...]
    # Its name in the OBJ file, and the span of the name there.
    mentions: tuple[tuple[str, int, int], ...]


class Materials:
    """Existing files that an OBJ file refers to, directly or through its materials, by its `mtllib` statements."""

    def __init__(self, folder: ModelFolder, statements: Sequence[tuple[bytes, int]]) -> None:
        self.paths: list[str] = []  # of regular files inside the folder, relative to it, "/" separates
        self.notices: list[str] = []  # one sentence for each file that is missing
        self.obstacles: list[Obstacle] = []  # of them
        self.folder = folder
        self._unread: dict[str, Obstacle] = {}
        self._listed: set[str] = set()
        mentions: dict[str, list[tuple[str, int, int]]] = {}
        for text, start in statements:
            for name, begin in self._names(text, start):
                path = self._found(name, PurePosixPath())
                if path is not None:
                    mentions.setdefault(path, []).append((name, begin, begin + len(os.fsencode(name))))
        self.libraries = [self._read(path, places) for path, places in mentions.items()]
        self._shown: dict[tuple[str, Slot], tuple[Map, str | None]] = {}
        self._factors: dict[str, Factors] = {}
        for library in self.libraries:
            # The first library with a material counts; in it, the last map of the preferred keyword.
            for keyword, slot in reversed(SLOTS.items()):
                for each, file in library.maps:
                    if each.keyword == keyword and each.material not in self._factors:
                        self._shown[each.material, slot] = each, file
            new = library.materials.keys() - self._factors.keys()
            self._factors |= {name: library.materials[name] for name in new}

    def maps_of(self, material: str) -> dict[Slot, tuple[Map, str | None]]:
        """Return the map of each slot of a material, and the path of its file or None."""
        return {slot: self._shown[material, slot] for slot in MAP_SLOTS if (material, slot) in self._shown}

    def material(self, name: str) -> Material:
        """Return a material without its maps; the defaults if no library has it."""
        factors = self._factors.get(name, {})
        transparency = factors.get("tr", [0.0])[0]
        # Some exporters write "Tr 1" for opaque materials; fully transparent ones are not exported.
        given = factors.get("d", [1 - transparency])[0]
        opacity = given if given > 0 else 1.0
        emission, strength = emission_and_strength(_colour(factors.get("ke", [0.0])))
        return Material(
            name=name,
            colour=_colour(factors.get("kd", [1.0])),
            emission=tuple(emission),
            emission_strength=strength,
            opacity=opacity,
            metalness=factors.get("pm", [0.0])[0],
            roughness=factors.get("pr", [1.0])[0],
            alpha="blend" if opacity < 1 else "opaque",
        )

    def obstacle(self, name: str) -> Obstacle:
        return self._unread.get(name, Obstacle("cannot be read"))

    def paths_by_file(self) -> dict[str, list[str]]:
        """Return the paths that maps use for each file: its own, and then tile sets that it is part of."""
        used = {path: None for library in self.libraries for _, path in library.maps if path is not None}
        found: dict[str, list[str]] = {}
        for path in sorted(used, key=lambda path: len(self.folder.tiles_of(path)) > 0):
            for file in self.folder.files(path):
                found.setdefault(file, []).append(path)
        return found

    def slots(self) -> tuple[Slot, ...]:
        shown = {slot for _, slot in self._shown}
        return tuple(slot for slot in MAP_SLOTS if slot in shown)

    def uses(self, path: str) -> int:
        return sum(used == path for library in self.libraries for _, used in library.maps)

    def affected(self, slot: Slot, path: str) -> Iterator[tuple[Library, Map]]:
        """Yield all maps through which an image is visible in a slot."""
        for library in self.libraries:
            showing = {m.material for m, p in library.maps if p == path and SLOTS.get(m.keyword) == slot}
            along = _BASE_COLOUR_COMPANIONS if slot == "baseColor" else ()
            for each, its_path in library.maps:
                goes_along = each.keyword in along and each.material in showing
                if its_path == path and (goes_along or SLOTS.get(each.keyword) == slot):
                    yield library, each

    def _names(self, text: bytes, start: int) -> Iterator[tuple[str, int]]:
        """Split a list of library names, which may contain blanks; yield each with its span."""
        whole = os.fsdecode(text)
        if len(whole) > 2 and whole[0] == whole[-1] == '"':
            whole, start = whole[1:-1], start + 1
        if self.folder.find(whole) is not None:
            yield whole, start
            return
        done = 0
        for begin, end in _split(whole.split(" #")[0]):  # A comment may follow.
            start += len(os.fsencode(whole[done:begin]))
            done = begin
            yield whole[begin:end], start

    def _read(self, path: str, mentions: list[tuple[str, int, int]]) -> Library:
        try:
            data = self.folder.read(path, _MAX_BYTES + 1)
        except OSError as error:
            self._ignore(Obstacle(f"'{path}' cannot be read ({error.strerror})"))
            data = b""
        if len(data) > _MAX_BYTES:
            self._ignore(Obstacle(f"'{path}' has more than {_MAX_BYTES} bytes"))
            data = b""
        materials, maps = _read_library(data)
        within = PurePosixPath(path).parent
        located = tuple((each, self._found(each.name, within)) for each in maps)
        return Library(path, data, materials, located, tuple(mentions))

    def _ignore(self, obstacle: Obstacle) -> None:
        self.obstacles.append(obstacle)
        self.notices.append(f"{obstacle.cause}{IGNORED}")

    def _found(self, name: str, within: PurePosixPath) -> str | None:
        """Return the path of a file or tile set, and record it; None, with a notice, if it cannot be used."""
        try:
            path, instead = self.folder.locate_similar(name, within)
            notice = f"'{name}' {instead}"
            self.notices += [notice] if instead and notice not in self.notices else []
        except UnfitReferenceError as error:
            if name not in self._unread:
                self._unread[name] = error.obstacle
                if len(self._unread) <= _MAX_NOTICES:
                    self._ignore(Obstacle(f"'{name}' {error}", error.obstacle.remedy))
                elif len(self._unread) == _MAX_NOTICES + 1:  # a file may name a million
                    self.notices.append("Further files are missing as well.")
            return None
        if is_outside(path):
            return path
        new = [file for file in self.folder.files(path) if file not in self._listed]
        self.paths += new
        self._listed.update(new)
        return path


def _colour(numbers: list[float]) -> tuple[float, ...]:
    whole = numbers if len(numbers) >= 3 else [numbers[0]] * 3  # one number stands for three
    return tuple(whole[:3])


def _split(names: str) -> Iterator[tuple[int, int]]:
    """Yield the spans of library names: up to each .mtl, and after the last of these single words."""
    at = 0
    for match in _END_OF_NAME.finditer(names):
        begin = at + len(names[at : match.end()]) - len(names[at : match.end()].lstrip())
        yield begin, match.end()
        at = match.end()
    for match in _WORD.finditer(names, at):
        yield match.span()
