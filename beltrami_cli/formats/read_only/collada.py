"""COLLADA files with vertex colours, read by pycollada in a process of its own.

pycollada is not made for files that mean harm, so it runs as `python -m` of this module, with a limit on memory and
time. trimesh reads COLLADA by pycollada, too, but drops the vertex colours of every mesh that has a material and all
polygons with a skin, and rounds other colours to 8 bits.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import Any
from xml.parsers import expat

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s
from beltrami_cli.errors import InputError
from beltrami_cli.formats.access import Access
from beltrami_cli.formats.archives import Archive
from beltrami_cli.formats.colours import ColouredPolygons
from beltrami_cli.formats.foreign_library import ForeignLibrary, serve_files

_TREE = 16  # times as much memory as its text takes an XML document while it is read
_PYCOLLADA = ForeignLibrary(
    "beltrami_cli.formats.read_only.collada", "foreign", 10, "export it as PLY or glTF"
)


def read_dae(data: bytes, name: str, access: Access) -> ColouredPolygons:
    """Read a COLLADA file, or the first one in an archive (.zae)."""
    if data[:2] == b"PK":
        archive = Archive(data, name, access, _TREE)
        member = next((each for each in archive.members if each.lower().endswith(".dae")), None)
        if member is None:
            raise InputError(name, "the archive has no .dae file in it")
        data = archive.read(member)
    _check(data, name)
    question = {"data": np.frombuffer(data, np.uint8)}
    left_out, made = _PYCOLLADA.ask((None, question), name, len(data), access.memory)
    corners = np.arange(len(made["positions"]))  # triangles have vertices of their own
    sizes = np.full(len(corners) // 3, 3)
    return ColouredPolygons(made["positions"], corners, sizes, made["colours"], "float32", tuple(left_out))


def _check(data: bytes, name: str) -> None:
    """Refuse truncated XML, which pycollada would read as far as it goes, and entities that expand."""
    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = _refuse
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, ValueError) as error:
        raise InputError(name, f"it is damaged ({error})", "export it again") from error


def _refuse(*_: object) -> None:
    raise ValueError("a document type, which could make it grow without bounds, is not allowed")


def _answer(_: object, question: dict[str, Array]) -> tuple[list[str], dict[str, Array]]:
    """Return notices of losses, and the places and colours of the corners of all triangles, where nodes place them."""
    import collada

    document = collada.Collada(io.BytesIO(question["data"].tobytes()), ignore=[collada.common.DaeError])
    positions, colours, left = [], [], set()
    for geometry, matrix in _placed(document.scene) if document.scene is not None else ():
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
    there = {
        "what could not be read": document.errors,
        "skins": document.controllers,
        "materials": document.materials,
        "textures": document.images,
    }
    left |= {what for what, found in there.items() if found}
    arrays = {
        "positions": np.concatenate([np.empty((0, 3)), *positions]),
        "colours": np.concatenate([np.empty((0, 4), np.float32), *colours]),
    }
    return sorted(left), arrays


def _placed(scene: Any) -> Iterator[tuple[Any, Float64s]]:
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
