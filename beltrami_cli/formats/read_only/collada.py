"""COLLADA files, plain (.dae) or in an archive (.zae), read by pycollada.

Malicious files can break pycollada, so it runs as `python -m` of this module, with a limit on memory and time. trimesh
reads COLLADA by pycollada, too, but drops the vertex colours of every mesh that has a material and all polygons with a
skin, and rounds other colours to 8 bits.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from typing import Any
from xml.parsers import expat

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s
from beltrami_cli.errors import InputError
from beltrami_cli.formats.files.access import Access
from beltrami_cli.formats.files.archives import Archive
from beltrami_cli.formats.files.foreign_library import ForeignLibrary, serve_files
from beltrami_cli.formats.meshes.coloured_polygons import ColouredPolygons
from beltrami_cli.formats.read_only.xml import MEMORY_PER_BYTE, safe_parser
from beltrami_cli.surface.records import Frame
from beltrami_cli.surface.worker_process import Message

_STARTS_XML = re.compile(rb"(?:\xef\xbb\xbf)?\s*<|\xff\xfe<|\xfe\xff\0<")  # UTF-8 or UTF-16
_PYCOLLADA = ForeignLibrary(
    "beltrami_cli.formats.read_only.collada", "foreign", 10, "export it as PLY or glTF"
)


def is_collada(data: bytes) -> bool:
    return _STARTS_XML.match(data) is not None


def read_collada(data: bytes, name: str, access: Access) -> ColouredPolygons:
    """Read a COLLADA file, or the first one in an archive (.zae)."""
    if data[:2] == b"PK":
        archive = Archive(data, name, access, MEMORY_PER_BYTE)
        member = next((each for each in archive.members if each.lower().endswith(".dae")), None)
        if member is None:
            raise InputError(name, "the archive has no .dae file in it")
        data = archive.read(member)
    _require_sound_xml(data, name)
    question = {"data": np.frombuffer(data, np.uint8)}
    (left_out, up, unit), made = _PYCOLLADA.ask((None, question), name, len(data), access.memory)
    corners = np.arange(len(made["positions"]))  # triangles have vertices of their own
    offsets = 3 * np.arange(len(corners) // 3 + 1)
    places, frame = made["positions"], Frame(up, unit)
    return ColouredPolygons(places, corners, offsets, made["colours"], "float32", tuple(left_out), frame)


def _require_sound_xml(data: bytes, name: str) -> None:
    """Refuse truncated XML, which pycollada would read as far as it goes, and entities that expand."""
    try:
        safe_parser().Parse(data, True)
    except (expat.ExpatError, ValueError) as error:
        raise InputError(name, f"it is damaged ({error})", "export it again") from error


def _answer(_: object, question: dict[str, Array]) -> Message:
    """Return losses, axis and unit, and positions and colours of all corners of triangles, transformed by nodes."""
    import collada

    document = collada.Collada(io.BytesIO(question["data"].tobytes()), ignore=[collada.common.DaeError])
    positions, colours, left = [], [], set()
    for geometry, matrix in _placed_geometries(document.scene) if document.scene is not None else ():
        for primitive in geometry.primitives:
            if isinstance(primitive, (collada.polylist.Polylist, collada.polygons.Polygons)):
                primitive = primitive.triangleset()
            if not isinstance(primitive, collada.triangleset.TriangleSet):
                left.add("lines")
                continue
            if primitive.vertex is None or not len(primitive.index):
                continue
            places = primitive.vertex[primitive.vertex_index].reshape(-1, 3).astype(np.float64)
            positions.append(places @ matrix[:3, :3].T + matrix[:3, 3])
            colours.append(_colours_of(primitive))
    if document.errors and not positions:
        raise document.errors[0]
    losses = {
        "what could not be read": document.errors,
        "skins": document.controllers,
        "materials": document.materials,
        "textures": document.images,
    }
    left |= {what for what, found in losses.items() if found}
    arrays = {
        "positions": np.concatenate([np.empty((0, 3)), *positions]),
        "colours": np.concatenate([np.empty((0, 4), np.float32), *colours]),
    }
    asset = document.assetInfo
    up, unit = (asset.upaxis or "Y_UP")[0], float(asset.unitmeter or 1.0)
    if up == "X":  # and -y is to the right
        up, arrays["positions"] = "Y", arrays["positions"][:, [1, 0, 2]] * [-1, 1, 1]
    return (sorted(left), up, unit if 0 < unit < np.inf else 1.0), arrays


def _placed_geometries(scene: Any) -> Iterator[tuple[Any, Float64s]]:
    """Yield every geometry with its matrix: of its node or, with a skin, of where it was bound to the joints."""
    for bound in scene.objects("geometry"):
        yield bound.original, bound.matrix
    for bound in scene.objects("controller"):
        if hasattr(bound, "skin"):
            yield bound.skin.geometry, bound.skin.bind_shape_matrix


def _colours_of(primitive: Any) -> Float32s:
    """Return colours of all corners of triangles, shape (3 F, 4)."""
    result = np.full((3 * len(primitive.index), 4), np.nan, np.float32)
    sources = primitive.sources.get("COLOR")
    if sources:
        offset, source = sources[0][0], sources[0][4].data
        values = source[primitive.index[:, :, offset]].reshape(len(result), -1)[:, :4]
        result[:, : values.shape[1]] = values
        if values.shape[1] == 3:
            result[:, 3] = 1
    return result


if __name__ == "__main__":
    serve_files(_answer, "dae", "pycollada")
