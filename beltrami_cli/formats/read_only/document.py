"""Documents of the formats that are only read: coloured polygons, to be written in another format."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from pathlib import Path

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.changes import Changes, Naming, Written
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.files.access import Access
from beltrami_cli.formats.meshes.coloured_polygons import (
    ColouredPolygons,
    check_polygons,
    colours_of_vertices,
    joined,
)
from beltrami_cli.formats.read_only.collada import is_collada, read_collada
from beltrami_cli.formats.read_only.off import is_off, read_off
from beltrami_cli.formats.read_only.stl import is_stl, read_stl
from beltrami_cli.formats.read_only.threemf import read_3mf
from beltrami_cli.surface.records import MeshContents

_READERS: dict[str, Callable[[bytes, str, Access], ColouredPolygons]] = {
    "off": lambda data, name, _: read_off(data, name),
    "stl": lambda data, name, _: read_stl(data, name),
    "3mf": read_3mf,
    "dae": read_collada,
    "zae": read_collada,
}
_NEW_FILE_NOTICE = (
    "{} files are read, but not written: OUTPUT holds the polygons and their colours, and nothing else."
)


def kind_of(data: bytes, name: str) -> str | None:
    """Return the format of a file by its content, and by its name where many formats have such content."""
    suffix = name.lower().rpartition(".")[2]
    if data[:2] == b"PK":
        return suffix if suffix in ("3mf", "zae") else None
    if is_off(data):
        return "off"
    is_known = (suffix == "stl" and is_stl(data)) or (suffix == "dae" and is_collada(data))
    return suffix if is_known else None


class ReadOnlyDocument(Document):
    def _open(self, folder: Path | None) -> None:
        kind = kind_of(self.data, self.name)
        assert kind is not None
        self.format = kind

    @property
    def notices(self) -> tuple[str, ...]:
        return (_NEW_FILE_NOTICE.format(self.format.upper()),)

    @cached_property
    def _mesh(self) -> MeshContents:
        found = _READERS[self.format](self.data, self.name, self.access)
        check_polygons(found, self.name)
        if len(found.positions) == len(found.corners):  # every polygon has vertices of its own
            found = joined(found)
        colours, notices = colours_of_vertices(found)
        opacity = colours[:, 3] if colours.shape[1] == 4 else None
        if opacity is not None and (np.isnan(opacity).any() or (opacity == 1).all()):
            opacity = None
        return MeshContents(
            positions=found.positions,
            corners=found.corners.astype(np.int32),
            offsets=found.offsets,
            colours=np.ascontiguousarray(colours[:, :3]),
            encoding="srgb",
            stored=found.stored,
            alpha=None if opacity is None else np.clip(opacity, 0, 1),
            left_out=found.left_out,
            frame=found.frame,
            notices=tuple(notices),
        )

    def _patched(self, new: Changes, naming: Naming) -> Written:
        remedy = "name an output in .ply, .obj, .glb or .gltf"
        raise InputError(self.name, f"a {self.format.upper()} file is not written", remedy)

    def require_movable(self) -> None:
        """Allow any positions: the output is a new file."""

    def facts(self) -> dict[str, object]:
        contents = self._mesh
        return {
            "vertices": len(contents.positions),
            "polygons": len(contents.offsets) - 1,
            "opacity": contents.alpha is not None,
            "other": list(contents.left_out),
        }
