"""One model file (XML) of a 3MF archive: its objects with their meshes and colours, and what is built of them.

References
----------
.. [1] 3MF Consortium, "3D Manufacturing Format, core specification", version 1.3.
.. [2] 3MF Consortium, "Materials and properties extension", version 1.2.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from typing import TYPE_CHECKING
from xml.parsers import expat

import numpy as np

from beltrami_cli.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

Attributes = dict[str, str]

_PATH = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06 path"
_NUMBERS = 12  # of a transform
_NONE = -1


@dataclass(frozen=True)
class Part:
    """An object that is built, or is part of another: the model file it is in (empty: this one), its place."""

    path: str
    number: str
    matrix: NDArray[np.float64]


@dataclass
class Object:
    """One object: vertices, triangles with the indices of their properties, and the group of these, or parts."""

    group: str = ""
    index: int = 0
    vertices: array[float] = field(default_factory=lambda: array("d"))
    triangles: array[int] = field(default_factory=lambda: array("q"))  # three vertices, three properties
    groups: list[str] = field(default_factory=list)
    parts: list[Part] = field(default_factory=list)


@dataclass
class Model:
    """What is in a model file; colours are of 0 to 255, with opacity."""

    objects: dict[str, Object] = field(default_factory=dict)
    colours: dict[str, list[tuple[int, int, int, int]]] = field(default_factory=dict)
    built: list[Part] = field(default_factory=list)
    others: set[str] = field(default_factory=set)  # kinds of groups that are no colours


def read_model(text: bytes, name: str) -> Model:
    """Read a model file.

    Raises
    ------
    InputError
        If it is no XML, has a document type (which could make it grow without bounds), or numbers are none.
    """
    reading = _Reading()
    parser = expat.ParserCreate(namespace_separator=" ")
    parser.StartElementHandler = reading.start
    parser.StartDoctypeDeclHandler = _refuse
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise InputError(name, f"its model is no XML ({error})", "export it again") from error
    except (ValueError, KeyError, OverflowError) as error:
        cause = f"line {parser.CurrentLineNumber} of its model is damaged ({error})"
        raise InputError(name, cause, "export it again") from error
    return reading.model


def _refuse(*_: object) -> None:
    raise ValueError("a document type is not allowed")


class _Reading:
    """The model while its elements come in."""

    def __init__(self) -> None:
        self.model = Model()
        self._object = Object()
        self._group: list[tuple[int, int, int, int]] = []
        self._actions: dict[str, Callable[[Attributes], None]] = {
            "object": self._start_object,
            "vertex": self._take_vertex,
            "triangle": self._take_triangle,
            "component": lambda known: self._object.parts.append(_part(known)),
            "item": lambda known: self.model.built.append(_part(known)),
            "colorgroup": self._start_group,
            "basematerials": self._start_group,
            "color": lambda known: self._group.append(_colour(known["color"])),
            "base": lambda known: self._group.append(_colour(known["displaycolor"])),
            "texture2dgroup": lambda _: self.model.others.add("textures"),
            "compositematerials": lambda _: self.model.others.add("mixtures of materials"),
            "multiproperties": lambda _: self.model.others.add("several properties at once"),
        }

    def start(self, element: str, known: Attributes) -> None:
        action = self._actions.get(element.rpartition(" ")[2])
        if action is not None:
            action(known)

    def _start_object(self, known: Attributes) -> None:
        self._object = Object(known.get("pid", ""), int(known.get("pindex", 0)))
        self.model.objects[known["id"]] = self._object

    def _start_group(self, known: Attributes) -> None:
        self._group = []
        self.model.colours[known["id"]] = self._group

    def _take_vertex(self, known: Attributes) -> None:
        self._object.vertices.extend([float(known["x"]), float(known["y"]), float(known["z"])])

    def _take_triangle(self, known: Attributes) -> None:
        first = int(known.get("p1", _NONE))
        self._object.triangles.extend([int(known["v1"]), int(known["v2"]), int(known["v3"])])
        self._object.triangles.extend([first, int(known.get("p2", first)), int(known.get("p3", first))])
        self._object.groups.append(known.get("pid", ""))


def _part(known: Attributes) -> Part:
    numbers = [float(word) for word in known.get("transform", "1 0 0 0 1 0 0 0 1 0 0 0").split()]
    if len(numbers) != _NUMBERS:
        raise ValueError(f"a transform has {len(numbers)} numbers")
    matrix = np.eye(4)
    matrix[:, :3] = np.array(numbers).reshape(4, 3)
    return Part(known.get(_PATH, ""), known["objectid"], matrix)


def _colour(text: str) -> tuple[int, int, int, int]:
    digits = text.strip().removeprefix("#")
    if len(digits) not in (6, 8):
        raise ValueError(f"{text[:20]!r} is no colour")
    octets = bytes.fromhex(digits.ljust(8, "f"))
    return octets[0], octets[1], octets[2], octets[3]


def object_colours(model: Model, thing: Object) -> NDArray[np.float32]:
    """Return the colours of the corners of an object's triangles, shape (F, 3, 4); NaN where there is none."""
    table = np.array(thing.triangles, np.int64).reshape(-1, 6)
    result = np.full((len(table), 3, 4), np.nan, np.float32)
    names = np.array([group or thing.group for group in thing.groups], object)
    for group in set(names.tolist()):
        if group not in model.colours:
            continue
        palette = np.array(model.colours[group] or np.empty((0, 4)), np.float32).reshape(-1, 4) / 255
        rows = np.flatnonzero(names == group)
        indices = np.where(table[rows, 3:] == _NONE, thing.index, table[rows, 3:])
        there = (indices >= 0) & (indices < len(palette))
        result[rows] = np.where(
            there[..., None], np.append(palette, [[np.nan] * 4], axis=0)[np.where(there, indices, -1)], np.nan
        )
    return result
