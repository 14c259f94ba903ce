"""3MF files with colours of triangles or of their corners, put together as they are built."""

from __future__ import annotations

import posixpath
import re
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.foreign.archive import Archive
from beltrami_cli.formats.foreign.painting import PaintedPolygons
from beltrami_cli.formats.foreign.threemf_model import Model, Part, object_colours, read_model

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.access import Access

_RELATIONS = "_rels/.rels"
_USUAL = "3D/3dmodel.model"
_TARGET = re.compile(rb"<Relationship\b[^<>]*+>")
_DEEPEST = 32  # parts within parts
_MOST_PARTS = 20_000
_MOST_TRIANGLES = 1 << 26
_BYTES_OF_TRIANGLE = 400  # that one takes while it is put together


def read_3mf(data: bytes, name: str, access: Access) -> PaintedPolygons:
    """Read a 3MF file.

    Raises
    ------
    InputError
        If the archive or a model is damaged, or parts within parts grow without bounds.
    """
    building = _Building(Archive(data, name, access), name, access)
    root = building.model(building.start())
    for part in root.built:
        building.add(part, np.eye(4), building.start(), 0)
    return building.whole()


class _Building:
    """Objects while they are put where they belong."""

    def __init__(self, archive: Archive, name: str, access: Access) -> None:
        self._archive, self._name = archive, name
        memory = access.memory if access.memory is not None else _MOST_TRIANGLES * _BYTES_OF_TRIANGLE
        self._room = min(_MOST_TRIANGLES, memory // _BYTES_OF_TRIANGLE)
        self._models: dict[str, Model] = {}
        self._parts, self._vertices = 0, 0
        self._positions: list[NDArray[np.float64]] = []
        self._corners: list[NDArray[np.int64]] = []
        self._colours: list[NDArray[np.float32]] = []

    def start(self) -> str:
        """Return the member that the archive says to start with."""
        if _RELATIONS in self._archive.members:
            for relation in _TARGET.findall(self._archive.read(_RELATIONS)):
                target = re.search(rb"""Target\s*=\s*["']/?([^"']+)["']""", relation)
                if target and b"3dmodel" in relation:
                    return target[1].decode("utf-8", "replace")
        return _USUAL

    def model(self, path: str) -> Model:
        """Return a model file of the archive, read once."""
        if path not in self._models:
            self._models[path] = read_model(self._archive.read(path), self._name)
        return self._models[path]

    def add(self, part: Part, above: NDArray[np.float64], path: str, depth: int) -> None:
        """Add an object and all of its parts; matrices act on rows."""
        self._parts += 1
        if depth > _DEEPEST or self._parts > _MOST_PARTS:
            raise InputError(self._name, "it has too many parts within parts", "export it as one mesh")
        path = posixpath.normpath(part.path).lstrip("/") if part.path else path
        model = self.model(path)
        if part.number not in model.objects:
            raise InputError(self._name, f"there is no object {part.number[:20]!r}", "export it again")
        thing, matrix = model.objects[part.number], part.matrix @ above
        triangles = np.array(thing.triangles, np.int64).reshape(-1, 6)[:, :3]
        self._room -= len(triangles)
        if self._room < 0:
            raise InputError(self._name, "it has more triangles than fit into memory", "raise --max-memory")
        positions = np.array(thing.vertices, np.float64).reshape(-1, 3)
        if triangles.size and (triangles.min() < 0 or triangles.max() >= len(positions)):
            raise InputError(self._name, f"a triangle names a vertex that is none of the {len(positions)}")
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is told of later
            self._positions.append(positions @ matrix[:3, :3] + matrix[3, :3])
        self._corners.append(triangles.ravel() + self._vertices)
        self._colours.append(object_colours(model, thing).reshape(-1, 4))
        self._vertices += len(positions)
        for inner in thing.parts:
            self.add(inner, matrix, path, depth + 1)

    def whole(self) -> PaintedPolygons:
        """Return everything that was added."""
        corners = np.concatenate([np.empty(0, np.int64), *self._corners])
        others = set().union(*(model.others for model in self._models.values()))
        return PaintedPolygons(
            positions=np.concatenate([np.empty((0, 3)), *self._positions]),
            corners=corners,
            sizes=np.full(len(corners) // 3, 3),
            colours=np.concatenate([np.empty((0, 4), np.float32), *self._colours]),
            stored="uint8",
            left_out=(*sorted(others), "names, metadata and settings of printers"),
        )
