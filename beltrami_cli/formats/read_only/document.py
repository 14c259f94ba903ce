"""Files of formats that are read only, as documents: their coloured polygons, to be written in another format."""

from __future__ import annotations

import re
from functools import cached_property
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.colours import (
    ColouredPolygons,
    check_polygons,
    colours_of_vertices,
    joined,
)
from beltrami_cli.formats.document import Changes, Document, Naming, Written
from beltrami_cli.formats.read_only.off_stl import OFF_HEADER, is_binary_stl, read_off, read_stl
from beltrami_cli.surface.records import MeshContents

Kind = Literal["off", "stl", "3mf", "dae", "zae"]

_STARTS_XML = re.compile(rb"(?:\xef\xbb\xbf)?\s*<|\xff\xfe<|\xfe\xff\0<")  # UTF-8 or UTF-16
_ARCHIVES: dict[str, Kind] = {".3mf": "3mf", ".zae": "zae"}
_READ_ONLY = (
    "{} files are read, but not written: OUTPUT holds the polygons and their colours, and nothing else."
)


def kind_of(data: bytes, name: str) -> Kind | None:
    """Return the format of a file by its content, and by its name where many formats have such content."""
    suffix = "." + name.lower().rpartition(".")[2]
    if suffix == ".obj":
        return None
    if data[:2] == b"PK":
        return _ARCHIVES.get(suffix)
    if OFF_HEADER.match(data):
        return "off"
    if suffix == ".stl" and (data[:5].lower() == b"solid" or is_binary_stl(data)):
        return "stl"
    return "dae" if suffix == ".dae" and _STARTS_XML.match(data) else None


class ReadOnlyDocument(Document):
    """A file of a format that is not written."""

    format: ClassVar[str] = "foreign"

    def _open(self, folder: Path | None) -> None:
        kind = kind_of(self.data, self.name)
        assert kind is not None
        self._kind = kind

    @cached_property
    def _mesh(self) -> MeshContents:
        found = self._read()
        check_polygons(found, self.name)
        self.notices.append(_READ_ONLY.format(self._kind.upper()))
        if len(found.positions) == len(found.corners):  # every polygon has vertices of its own
            found = joined(found)
        colours, notices = colours_of_vertices(found)
        self.notices += notices
        opacity = colours[:, 3] if colours.shape[1] == 4 else None
        if opacity is not None and (np.isnan(opacity).any() or (opacity == 1).all()):
            opacity = None
        return MeshContents(
            positions=found.positions,
            corners=found.corners.astype(np.int32),
            offsets=np.concatenate([[0], np.cumsum(found.sizes)]),
            colours=np.ascontiguousarray(colours[:, :3]),
            encoding="srgb",
            stored=found.stored,
            alpha=None if opacity is None else np.clip(opacity, 0, 1),
            left_out=found.left_out,
        )

    def _read(self) -> ColouredPolygons:
        if self._kind in ("off", "stl"):
            read = read_off if self._kind == "off" else read_stl
            return read(self.data, self.name)
        if self._kind == "3mf":
            from beltrami_cli.formats.read_only.threemf import read_3mf

            return read_3mf(self.data, self.name, self.access)
        from beltrami_cli.formats.read_only.collada import read_dae

        return read_dae(self.data, self.name, self.access)

    def _patched(self, new: Changes, naming: Naming) -> Written:
        remedy = "name an output in .ply, .obj, .glb or .gltf"
        raise InputError(self.name, f"a {self._kind.upper()} file is not written", remedy)

    def require_movable(self) -> None:
        """Check nothing: the output is a new file."""

    def facts(self) -> dict[str, object]:
        contents = self._mesh
        return {
            "format": self._kind,
            "vertices": len(contents.positions),
            "polygons": len(contents.offsets) - 1,
            "opacity": contents.alpha is not None,
            "other": list(contents.left_out),
        }
