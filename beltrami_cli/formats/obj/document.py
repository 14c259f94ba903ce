"""OBJ files whose vertex colours and textures can be replaced, every other byte staying as it is."""

from __future__ import annotations

import codecs
import dataclasses
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s, Int32s, Int64s
from beltrami_cli.errors import InputError, NoColoursError, Obstacle
from beltrami_cli.formats.changes import Changes, Naming, PlannedImages, Written
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.files.edits import (
    PLACEHOLDER,
    Spans,
    exchange_spans,
    new_colours,
    renumbered,
    shifted,
    without_tokens,
)
from beltrami_cli.formats.fingerprint import Fingerprint, labelled
from beltrami_cli.formats.full_scale import BYTE, full_scale, opacity
from beltrami_cli.formats.meshes.scene import Scene
from beltrami_cli.formats.obj.materials import Materials
from beltrami_cli.formats.obj.polypaint import with_entries, without_entries
from beltrami_cli.formats.obj.renaming import renaming
from beltrami_cli.formats.obj.scene import Coordinates, convert, read_coordinates, read_normals, read_scene
from beltrami_cli.formats.obj.statements import Statements
from beltrami_cli.formats.obj.vertices import Scan, among, new_positions, scan_file
from beltrami_cli.formats.sidecars.model_folder import ModelFolder
from beltrami_cli.surface.records import MeshContents, Slot

_STALE_NOTICE = (
    "The vertices moved, but the normals ('vn') are as they were; make them again, or leave them out."
)


class _Read(NamedTuple):
    """What is read from the text of a file in one go."""

    scan: Scan
    materials: Materials
    coordinates: (
        Coordinates | InputError | None
    )  # the error concerns only those who need textures; None: not read


class ObjDocument(Document):
    """A Wavefront OBJ file with colours behind the positions of its vertices."""

    format = "obj"

    def _open(self, folder: Path | None) -> None:
        if self.data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            raise InputError(self.name, "it is text in UTF-16", "save it as UTF-8")
        self._folder = ModelFolder(folder, self.access)

    @property
    def notices(self) -> tuple[str, ...]:
        return (*self._scan.notices, *self._materials.notices)

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        return tuple(self._materials.obstacles)

    @cached_property
    def _mesh(self) -> MeshContents:
        colours, vertices = self._colours, self._scan.vertices
        notices = () if self._scan.polypaint is not None else (vertices.notice, self._full_scale[1])
        return MeshContents(
            vertices.positions[vertices.coloured], *self._polygons, colours, "srgb", self._stored,
            notices=tuple(filter(None, notices)),
        )  # fmt: skip

    @property
    def _stored(self) -> str:
        return "text" if self._scan.polypaint is None else "uint8"

    def has_vertex_colours(self) -> bool:
        return bool(self._scan.vertices.coloured.size)

    def slots(self) -> tuple[Slot, ...]:
        return self._materials.slots()

    @cached_property
    def _scene(self) -> Scene:
        return read_scene(self._scan, self._coordinates, self._materials, self.name)

    def _why_untextured(self) -> Obstacle | None:
        defined = set[str]().union(*(library.materials for library in self._materials.libraries))
        unknown = next((name for name in self._coordinates.names if name not in defined), None)
        if unknown is None:
            return None
        remedy = "correct the name at usemtl, or name the library that has it at mtllib"
        return Obstacle(f"no library has its material '{unknown}'", remedy)

    def _patched(self, new: Changes, naming: Naming) -> Written:
        colours, places = new.colours, new.places
        renamed = renaming(self._materials, new.images, self.name, naming)
        sidecars, spans = renamed.written(), renamed.spans
        data = exchange_spans(self.data, spans)
        vertices, polypaint = self._scan.vertices, self._scan.polypaint
        starts, ends = (shifted(tokens, spans) for tokens in (vertices.token_starts, vertices.token_ends))
        parts = []
        if colours is not None:
            if polypaint is not None:
                changed = colours != self._colours
                data = with_entries(data, shifted(polypaint.starts, spans), colours, changed)
            else:
                both = self._colours, colours
                parts.append(new_colours(data, starts[:, 3:], ends[:, 3:], *both, self._scale))
        if places is not None:
            changed = places.positions != vertices.positions[vertices.coloured]
            parts.append(new_positions(data, starts[:, :3], ends[:, :3], places.positions, changed))
        notices = (_STALE_NOTICE,) if places is not None and "normal" in self.attributes() else ()
        main = renumbered(data, parts) if parts else [data]
        return dataclasses.replace(sidecars, main=main, notices=(*sidecars.notices, *notices))

    def sidecar_names(self, images: PlannedImages, naming: Naming, **_: object) -> list[str]:
        return renaming(self._materials, images, self.name, naming).sidecar_names

    def require_movable(self) -> None:
        """Allow any positions: numbers in text can have any value."""

    def has_normals_by_vertex(self) -> bool:
        """Return False: normals belong to the corners of polygons."""
        return False

    def attributes(self) -> tuple[str, ...]:
        return ("normal",) if "normals" in self._scan.dropped else ()

    def _attribute(self, name: str) -> Float64s:
        vertices = self._scan.vertices
        normals = read_normals(self._tokenised(), self._scan.corners, len(vertices.positions))
        normals = normals[vertices.coloured]
        if np.isnan(normals).any():
            row = int(vertices.coloured[int(np.argmax(np.isnan(normals).any(axis=1)))])
            raise InputError(self.name, f"vertex {row + 1} has no normal, so normals cannot guide")
        return normals

    def references(self) -> Sequence[str]:
        return self._materials.paths

    def contents(self) -> MeshContents:
        return dataclasses.replace(self._mesh, alpha=self._alpha(), left_out=self._scan.dropped)

    def textured_mesh(self, colours: Float32s | None = None) -> MeshContents:
        return self._with_vertex_colours(self._converted, colours)

    @cached_property
    def _converted(self) -> MeshContents:
        return convert(self._scene, self._tokenised(), self._scan, self._materials)

    def _alpha(self) -> Float32s | None:
        alpha = self._scan.vertices.alpha
        return None if alpha is None else opacity(alpha, self._scale)

    def fingerprint(self) -> Fingerprint:
        data, libraries, vertices = self.data, self._materials.libraries, self._scan.vertices
        mentions: Spans = {(a, b): PLACEHOLDER for library in libraries for _, a, b in library.mentions}
        colours = {"vertex colours": self._colours} if self.has_vertex_colours() else {}
        if self._scan.polypaint is not None:
            data = without_entries(data, self._scan.polypaint.starts)
        text = exchange_spans(data, mentions)
        if colours and self._scan.polypaint is None:
            tokens = vertices.token_starts, vertices.token_ends
            starts, ends = (np.sort(shifted(places[:, 3:].ravel(), mentions)) for places in tokens)
            text = without_tokens(text, starts, ends)
        parts, shown = {"statements": text}, dict[str, str | None]()
        for number, library in enumerate(libraries, 1):
            used = [each for each, path in library.maps if path is not None]
            names: Spans = {(each.start, each.end): PLACEHOLDER for each in used}
            parts[f"material library {number}"] = exchange_spans(library.data, names)
            for index, (each, path) in enumerate(library.maps, 1):
                shown[f"material {each.material!r}, {each.keyword} ({number}.{index})"] = path
        images = self._folder.files_by_label(shown)
        return Fingerprint(parts, colours, labelled(images, self._folder.content))

    def facts(self) -> dict[str, object]:
        return {
            "format": self.format,
            "vertices": len(self._scan.vertices.positions),
            "coloured_vertices": len(self._scan.vertices.coloured),
            "polygons": len(self._scan.offsets) - 1,
            "material_libraries": len(self._scan.libraries),
            "other": list(self._scan.dropped),
        }

    def _tokenised(self) -> Statements:
        return Statements(self.data, self.name)  # not kept: it takes several times the memory of the text

    @cached_property
    def _read(self) -> _Read:
        """All that most runs need of the file; texture coordinates if there are textures."""
        statements = self._tokenised()
        scan = scan_file(statements)
        materials = Materials(self._folder, scan.libraries)
        coordinates: Coordinates | InputError | None = None
        if materials.slots():
            try:
                coordinates = read_coordinates(statements, materials)
            except InputError as error:
                coordinates = error
        return _Read(scan, materials, coordinates)

    @property
    def _scan(self) -> Scan:
        return self._read.scan

    @property
    def _materials(self) -> Materials:
        return self._read.materials

    @cached_property
    def _polygons(self) -> tuple[Int32s, Int64s]:
        vertices = self._scan.vertices
        if len(vertices.coloured) == len(vertices.positions):
            return self._scan.corners, self._scan.offsets
        return among(self._scan.corners, self._scan.offsets, vertices.coloured, len(vertices.positions))

    @cached_property
    def _colours(self) -> Float32s:
        return (self._scan.vertices.colours / self._scale).astype(np.float32)

    @property
    def _scale(self) -> float:
        return self._full_scale[0]

    @cached_property
    def _full_scale(self) -> tuple[float, str]:
        """The number that is full scale, and a notice if it is a guess, or ""."""
        vertices = self._scan.vertices
        if not vertices.coloured.size:
            cause = "there are no vertex colours on its 'v' lines"
            cause += ", only materials" if self._scan.libraries else ""
            raise NoColoursError(self.name, cause, "export the mesh with vertex colours (v x y z r g b)")
        return (BYTE, "") if self._scan.polypaint is not None else full_scale(vertices.colours, self.name)

    @cached_property
    def _coordinates(self) -> Coordinates:
        coordinates = self._read.coordinates
        if isinstance(coordinates, InputError):
            raise coordinates
        return coordinates or read_coordinates(self._tokenised(), self._materials)
