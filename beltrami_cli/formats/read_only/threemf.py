"""3MF files with colours of triangles or of their corners; objects are assembled as in the build.

trimesh reads the places and triangles of 3MF files only: it drops every colour, of groups as of materials.

References
----------
.. [1] 3MF Consortium, "3D Manufacturing Format, core specification", version 1.3.
.. [2] 3MF Consortium, "Materials and properties extension", version 1.2.
"""

from __future__ import annotations

import posixpath
import re
from array import array
from dataclasses import dataclass, field
from functools import cached_property
from xml.parsers import expat

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s, Int64s
from beltrami_cli.errors import InputError, MemoryLimitError
from beltrami_cli.formats.files.access import Access
from beltrami_cli.formats.files.archives import Archive
from beltrami_cli.formats.meshes.coloured_polygons import ColouredPolygons
from beltrami_cli.formats.read_only.xml import MEMORY_PER_BYTE, safe_parser
from beltrami_cli.surface.records import Frame

_RELATIONSHIPS = "_rels/.rels"
_DEFAULT_PART = "3D/3dmodel.model"
_TARGET = re.compile(rb"<Relationship\b[^<>]*+>")
_PATH = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06 path"
_MAX_NESTING = 32  # parts within parts
_MAX_PARTS = 20_000
_MAX_TRIANGLES = 1 << 26
_BYTES_OF_TRIANGLE = 400  # that one takes while it is put together
_NUMBERS = 12  # of a transform
_NONE = -1

_OTHER_GROUPS = {
    "texture2dgroup": "textures",
    "compositematerials": "mixtures of materials",
    "multiproperties": "several properties at once",
}

_UNITS = {
    "micron": 1e-6, "millimeter": 1e-3, "centimeter": 1e-2, "inch": 0.0254, "foot": 0.3048, "meter": 1.0,
}  # fmt: skip
Attributes = dict[str, str]
Rgba = tuple[int, int, int, int]


@dataclass(frozen=True)
class _Part:
    """An object that is built, or is part of another: the model file it is in (empty: this one), its place."""

    path: str
    number: str
    matrix: Float64s


@dataclass
class _Object:
    """Vertices, triangles with the indices of their properties and the group of these, or parts."""

    group: str = ""
    index: int = 0
    vertices: array[float] = field(default_factory=lambda: array("d"))
    triangles: array[int] = field(default_factory=lambda: array("q"))  # three vertices, three properties
    groups: list[str] = field(default_factory=list)
    parts: list[_Part] = field(default_factory=list)


@dataclass
class _Model:
    """The content of one model file; colours are of 0 to 255, with opacity."""

    objects: dict[str, _Object] = field(default_factory=dict)
    colours: dict[str, list[Rgba]] = field(default_factory=dict)
    items: list[_Part] = field(default_factory=list)  # of the build
    unread_groups: set[str] = field(default_factory=set)  # kinds of groups that are not colours
    unit: float = _UNITS["millimeter"]  # metres


def read_3mf(data: bytes, name: str, access: Access) -> ColouredPolygons:
    building = _Building(Archive(data, name, access, MEMORY_PER_BYTE), name, access)
    for part in building.model(building.root).items:
        building.add(part, np.eye(4), building.root, 0)
    return building.polygons()


def _read_model(text: bytes, name: str) -> _Model:
    reading = _Reading()
    parser = safe_parser(namespace_separator=" ")
    parser.StartElementHandler = reading.start
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise InputError(name, f"its model is not XML ({error})", "export it again") from error
    except (ValueError, KeyError, OverflowError) as error:
        cause = f"line {parser.CurrentLineNumber} of its model is damaged ({error})"
        raise InputError(name, cause, "export it again") from error
    return reading.model


class _Reading:
    """The model while its elements are parsed."""

    def __init__(self) -> None:
        self.model = _Model()
        self._object = _Object()
        self._group: list[Rgba] = []

    def start(self, element: str, known: Attributes) -> None:
        match element.rpartition(" ")[2]:
            case "model" if "unit" in known:
                self.model.unit = _UNITS[known["unit"]]
            case "vertex":
                self._object.vertices.extend(float(known[axis]) for axis in "xyz")
            case "triangle":
                first = int(known.get("p1", _NONE))
                self._object.triangles.extend([int(known["v1"]), int(known["v2"]), int(known["v3"])])
                self._object.triangles.extend(
                    [first, int(known.get("p2", first)), int(known.get("p3", first))]
                )
                self._object.groups.append(known.get("pid", ""))
            case "object":
                self._object = _Object(known.get("pid", ""), int(known.get("pindex", 0)))
                self.model.objects[known["id"]] = self._object
            case "component":
                self._object.parts.append(_part(known))
            case "item":
                self.model.items.append(_part(known))
            case "colorgroup" | "basematerials":
                self._group = self.model.colours[known["id"]] = []
            case "color":
                self._group.append(_colour(known["color"]))
            case "base":
                self._group.append(_colour(known["displaycolor"]))
            case other if other in _OTHER_GROUPS:
                self.model.unread_groups.add(_OTHER_GROUPS[other])


def _part(known: Attributes) -> _Part:
    numbers = [float(word) for word in known.get("transform", "1 0 0 0 1 0 0 0 1 0 0 0").split()]
    if len(numbers) != _NUMBERS:
        raise ValueError(f"a transform has {len(numbers)} numbers")
    matrix = np.eye(4)
    matrix[:, :3] = np.array(numbers).reshape(4, 3)
    return _Part(known.get(_PATH, ""), known["objectid"], matrix)


def _colour(text: str) -> Rgba:
    digits = text.strip().removeprefix("#")
    if len(digits) not in (6, 8):
        raise ValueError(f"{text[:20]!r} is not a colour")
    octets = bytes.fromhex(digits.ljust(8, "f"))
    return octets[0], octets[1], octets[2], octets[3]


def _colours_of(model: _Model, solid: _Object) -> Float32s:
    """Return the colours of the corners of an object's triangles, shape (F, 3, 4); NaN where there is none."""
    table = np.array(solid.triangles, np.int64).reshape(-1, 6)
    result = np.full((len(table), 3, 4), np.nan, np.float32)
    names = np.array([group or solid.group for group in solid.groups], object)
    for group in set(names.tolist()):
        if group not in model.colours:
            continue
        palette = np.array(model.colours[group] or np.empty((0, 4)), np.float32).reshape(-1, 4) / 255
        palette = np.append(palette, [[np.nan] * 4], axis=0)
        rows = np.flatnonzero(names == group)
        indices = np.where(table[rows, 3:] == _NONE, solid.index, table[rows, 3:])
        is_valid = (indices >= 0) & (indices < len(palette) - 1)
        result[rows] = palette[np.where(is_valid, indices, -1)]
    return result


class _Building:
    """Objects while they are assembled."""

    def __init__(self, archive: Archive, name: str, access: Access) -> None:
        self._archive, self._name = archive, name
        memory = access.memory if access.memory is not None else _MAX_TRIANGLES * _BYTES_OF_TRIANGLE
        self._triangles_left = min(_MAX_TRIANGLES, memory // _BYTES_OF_TRIANGLE)
        self._models: dict[str, _Model] = {}
        self._parts, self._vertices = 0, 0
        self._positions: list[Float64s] = []
        self._corners: list[Int64s] = []
        self._colours: list[Float32s] = []

    @cached_property
    def root(self) -> str:
        """The path of the root model file in the archive."""
        if _RELATIONSHIPS in self._archive.members:
            for relation in _TARGET.findall(self._archive.read(_RELATIONSHIPS)):
                target = re.search(rb"""Target\s*=\s*["']/?([^"']+)["']""", relation)
                if target and b"3dmodel" in relation:
                    return target[1].decode("utf-8", "replace")
        return _DEFAULT_PART

    def model(self, path: str) -> _Model:
        if path not in self._models:
            self._models[path] = _read_model(self._archive.read(path), self._name)
        return self._models[path]

    def add(self, part: _Part, above: Float64s, path: str, depth: int) -> None:
        """Add an object and all of its parts; matrices act on rows."""
        self._parts += 1
        if depth > _MAX_NESTING or self._parts > _MAX_PARTS:
            raise InputError(self._name, "it has too many parts within parts", "export it as one mesh")
        path = posixpath.normpath(part.path).lstrip("/") if part.path else path
        model = self.model(path)
        if part.number not in model.objects:
            raise InputError(self._name, f"there is no object {part.number[:20]!r}", "export it again")
        solid, matrix = model.objects[part.number], part.matrix @ above
        triangles = np.array(solid.triangles, np.int64).reshape(-1, 6)[:, :3]
        self._triangles_left -= len(triangles)
        if self._triangles_left < 0:
            raise MemoryLimitError(
                self._name, "it has more triangles than fit into memory", "raise --max-memory"
            )
        positions = np.array(solid.vertices, np.float64).reshape(-1, 3)
        if triangles.size and (triangles.min() < 0 or triangles.max() >= len(positions)):
            raise InputError(
                self._name, f"a triangle names a vertex beyond the {len(positions)} of its object"
            )
        with np.errstate(over="ignore", invalid="ignore"):  # values that are not finite are refused later
            self._positions.append(positions @ matrix[:3, :3] + matrix[3, :3])
        self._corners.append(triangles.ravel() + self._vertices)
        self._colours.append(_colours_of(model, solid).reshape(-1, 4))
        self._vertices += len(positions)
        for inner in solid.parts:
            self.add(inner, matrix, path, depth + 1)

    def polygons(self) -> ColouredPolygons:
        corners = np.concatenate([np.empty(0, np.int64), *self._corners])
        unread = set().union(*(model.unread_groups for model in self._models.values()))
        return ColouredPolygons(
            positions=np.concatenate([np.empty((0, 3)), *self._positions]),
            corners=corners,
            offsets=3 * np.arange(len(corners) // 3 + 1),
            colours=np.concatenate([np.empty((0, 4), np.float32), *self._colours]),
            stored="uint8",
            left_out=(*sorted(unread), "names, metadata and settings of printers"),
            frame=Frame("Z", self.model(self.root).unit),
        )
