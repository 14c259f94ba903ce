"""Documents of the read-only formats OFF, STL and COLLADA: coloured polygons, to be written in another format.

OFF and STL files are read here. trimesh reads the places and faces of OFF files [1]_ only: it drops all colours, and
cuts polygons. Two bytes of every triangle of an STL file [2]_ are a colour, in two dialects. VisCAM and SolidView mark
triangles that have a colour by the highest bit; blue is in the lowest five. Materialise Magics has COLOR= and a colour
for all in the header, marks triangles without one of their own, and has red lowest. trimesh reads the triangles. It
leaves the two bytes as numbers, and makes text of the header, so both are understood here.

COLLADA files are read by pycollada, which malicious files can break, so it runs as `python -m` of this
module, with a limit on memory and time. trimesh reads COLLADA by pycollada, too, but drops the vertex colours of every
mesh that has a material and all polygons with a skin, and rounds other colours to 8 bits.

References
----------
.. [1] Geomview manual, "OFF Files", http://www.geomview.org/docs/html/OFF.html
.. [2] M. Burns, "Automated fabrication", 1993, section 6.5: the STL format.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s, Int64s
from beltrami_cli.errors import InputError, NoColoursError
from beltrami_cli.formats.access import Access
from beltrami_cli.formats.archives import Archive
from beltrami_cli.formats.changes import Changes, Naming, Written
from beltrami_cli.formats.colours import (
    ColouredPolygons,
    check_polygons,
    colours_of_vertices,
    full_scale,
    joined,
)
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.foreign_library import ForeignLibrary, serve_files
from beltrami_cli.formats.tokens import Lines, without_comments
from beltrami_cli.surface.precision import require_single
from beltrami_cli.surface.records import Frame, MeshContents
from beltrami_cli.surface.worker_process import Message

_STARTS_XML = re.compile(rb"(?:\xef\xbb\xbf)?\s*<|\xff\xfe<|\xfe\xff\0<")  # UTF-8 or UTF-16
_ARCHIVES = {".3mf": "3mf", ".zae": "zae"}
_READ_ONLY = (
    "{} files are read, but not written: OUTPUT holds the polygons and their colours, and nothing else."
)


def kind_of(data: bytes, name: str) -> str | None:
    """Return the format of a file by its content, and by its name where many formats have such content."""
    suffix = "." + name.lower().rpartition(".")[2]
    if data[:2] == b"PK":
        return _ARCHIVES.get(suffix)
    if _OFF_HEADER.match(data):
        return "off"
    if suffix == ".stl" and (data[:5].lower() == b"solid" or _is_binary_stl(data)):
        return "stl"
    return "dae" if suffix == ".dae" and _STARTS_XML.match(data) else None


class ReadOnlyDocument(Document):
    """A file of a read-only format."""

    format: str  # type: ignore[misc]  # one class reads all formats, so only an instance knows its own

    def _open(self, folder: Path | None) -> None:
        kind = kind_of(self.data, self.name)
        assert kind is not None
        self.format = kind

    @cached_property
    def _mesh(self) -> MeshContents:
        found = self._read()
        check_polygons(found, self.name)
        self.notices.append(_READ_ONLY.format(self.format.upper()))
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
            frame=found.frame,
        )

    def _read(self) -> ColouredPolygons:
        if self.format == "3mf":
            from beltrami_cli.formats.read_only.threemf import read_3mf

            return read_3mf(self.data, self.name, self.access)
        if self.format in ("dae", "zae"):
            return _read_dae(self.data, self.name, self.access)
        return (_read_off if self.format == "off" else _read_stl)(self.data, self.name)

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


_OFF_HEADER = re.compile(rb"(?:\s++|#[^\n]*+\n)*+(ST)?(C)?(N)?(4)?(n)?OFF(?![A-Za-z_])", re.IGNORECASE)
_COLOUR = (3, 4)  # numbers
_MAX_INDEX = 1 << 53  # index that a float64 holds


def _read_off(data: bytes, name: str) -> ColouredPolygons:
    """Read an OFF file in text: one vertex a line, then one face a line."""
    header = _OFF_HEADER.match(data)
    assert header is not None  # by which it was recognised
    texture, _, normals, *other = header.groups()
    text = without_comments(b" " * header.end() + data[header.end() :], b"#")
    if any(other) or text.split(None, 1)[:1] == [b"BINARY"]:
        raise InputError(name, "only text of three dimensions is read of OFF", "save it as a plain OFF file")
    lines = Lines(data, text, name)
    vertices, faces = _counts(lines)
    first = 3 + (3 if normals else 0)
    table = _table(lines, vertices, first)
    extra = table[:, first : table.shape[1] - (2 if texture else 0)]
    rows = slice(1 + vertices, 1 + vertices + faces)
    corners, sizes = _corners(lines, rows)
    if extra.shape[1] in _COLOUR and vertices:
        scaled, scale = _scaled(extra, name)
        inside = (corners >= 0) & (corners < vertices)  # other corners are refused later
        colours = scaled[np.where(inside, corners, 0)]
    else:
        shades, scale = _of_faces(lines, rows, sizes)
        colours = np.repeat(shades, sizes, axis=0)
    stored = "uint8" if scale > 1 else "float32"
    left = [what for what, there in (("normals", normals), ("texture coordinates", texture)) if there]
    return ColouredPolygons(table[:, :3], corners, sizes, colours, stored, tuple(left))


def _counts(lines: Lines) -> tuple[int, int]:
    try:
        first = range(lines.heads[0], min(lines.heads[0] + 2, lines.stops[0]))
        vertices, faces = (int(lines.word(token)) for token in first)
    except (IndexError, ValueError):
        raise InputError(lines.name, "its first line does not count vertices and faces") from None
    there = len(lines.heads) - 1
    if vertices < 0 or faces < 0 or vertices + faces > there:
        cause = f"it announces {vertices} vertices and {faces} faces, but has {there} lines"
        raise InputError(lines.name, cause, "the file may be cut off")
    return vertices, faces


def _table(lines: Lines, vertices: int, least: int) -> Float64s:
    heads = lines.heads[1 : 1 + vertices]
    sizes = lines.stops[1 : 1 + vertices] - heads
    width = int(sizes[0]) if vertices else least
    wrong = (sizes != width) | (width < least)
    if wrong.any():
        number = int(np.argmax(wrong))
        cause = f"vertex {number} has {sizes[number]} numbers, not {max(width, least)}"
        raise InputError(lines.name, cause, "export it again")
    return lines.numbers((heads[:, None] + np.arange(width)).ravel()).reshape(-1, width)


def _corners(lines: Lines, rows: slice) -> tuple[Int64s, Int64s]:
    heads, stops = lines.heads[rows], lines.stops[rows]
    counted = lines.numbers(heads)
    wrong = ~((counted >= 1) & (counted < stops - heads) & (counted % 1 == 0))
    if wrong.any():
        cause = f"face {np.argmax(wrong)} does not name the vertices that it counts"
        raise InputError(lines.name, cause, "export it again")
    sizes = counted.astype(np.int64)
    starts = np.cumsum(sizes) - sizes
    corners = lines.numbers(np.repeat(heads + 1 - starts, sizes) + np.arange(sizes.sum()))
    if not ((np.abs(corners) < _MAX_INDEX) & (corners % 1 == 0)).all():
        raise InputError(lines.name, "a face names a vertex that cannot be", "export it again")
    return corners.astype(np.int64), sizes


def _of_faces(lines: Lines, rows: slice, sizes: Int64s) -> tuple[Float32s, float]:
    """Return colours of faces, shape (P, 4), and their full scale in the file."""
    firsts = lines.heads[rows] + 1 + sizes
    behind = lines.stops[rows] - firsts  # one number is an index of a map that is not in the file
    found = np.full((len(sizes), 4), np.nan)
    for count in _COLOUR:
        given = np.flatnonzero(behind == count)
        tokens = firsts[given, None] + np.arange(count)
        found[given, :count] = lines.numbers(tokens.ravel()).reshape(-1, count)
    is_coloured = ~np.isnan(found[:, :3]).any(axis=1)
    if not is_coloured.any():
        return np.full((len(sizes), 3), np.nan, np.float32), 1.0
    result = np.full((len(sizes), 4), np.nan, np.float32)
    scaled, scale = _scaled(found[is_coloured, :3], lines.name)
    alpha = found[is_coloured, 3] / (scale if np.nanmax(found[is_coloured, 3], initial=0) > 1 else 1)
    result[is_coloured] = np.column_stack([scaled, np.where(np.isnan(alpha), 1, alpha)])
    return result, scale


def _scaled(colours: Float64s, name: str) -> tuple[Float32s, float]:
    require_single(colours, name, "the colour of row")
    scale, _ = full_scale(colours[:, :3], name)
    values = colours / scale
    if colours.shape[1] == 4 and colours[:, 3].max() <= 1:  # colours of 0..255 with opacity of 0..1
        values[:, 3] = colours[:, 3]
    return values.astype(np.float32), scale


_STL_HEADER, _STL_TRIANGLE = 80, 50  # bytes
_MAGICS = b"COLOR="
_LEVELS = 31  # of five bits


def _is_binary_stl(data: bytes) -> bool:
    """Whether the length of a file fits its number of triangles."""
    if len(data) < _STL_HEADER + 4:
        return False
    count = int.from_bytes(data[_STL_HEADER : _STL_HEADER + 4], "little")
    return len(data) == _STL_HEADER + 4 + count * _STL_TRIANGLE


def _read_stl(data: bytes, name: str) -> ColouredPolygons:
    """Read a binary STL file; vertices at one place become one."""
    if not _is_binary_stl(data):
        cause = "an STL file in text has no colours"
        raise NoColoursError(name, cause, "export it as PLY or OBJ with colours")
    from trimesh.exchange.stl import load_stl_binary

    triangles = load_stl_binary(io.BytesIO(data))
    if "vertices" not in triangles:
        raise InputError(name, "there are no polygons", "nothing in it can be smoothed")
    bits = triangles["face_attributes"]["stl"]
    colours = np.full((len(bits), 3), np.nan, np.float32)
    lowest_first = np.stack([bits & 31, bits >> 5 & 31, bits >> 10 & 31], axis=1) / np.float32(_LEVELS)
    marked = bits >> 15 == 1
    at = data.find(_MAGICS, 0, _STL_HEADER)
    if at >= 0 and at + len(_MAGICS) + 4 <= _STL_HEADER:
        whole = np.frombuffer(data, np.uint8, 3, at + len(_MAGICS)) / np.float32(255)
        colours[:] = np.where(marked[:, None], whole, lowest_first)
    else:
        colours[marked] = lowest_first[marked, ::-1]
    positions = triangles["vertices"].astype(np.float64)
    found = ColouredPolygons(
        positions=positions,
        corners=np.arange(len(positions)),
        sizes=np.full(len(bits), 3),
        colours=np.repeat(colours, 3, axis=0),
        stored="uint8",
        left_out=("normals",),
    )
    return joined(found) if np.isfinite(positions).all() else found


_TREE = 16  # times as much memory as its text takes an XML document while it is read
_PYCOLLADA = ForeignLibrary(
    "beltrami_cli.formats.read_only.document", "foreign", 10, "export it as PLY or glTF"
)


def _read_dae(data: bytes, name: str, access: Access) -> ColouredPolygons:
    """Read a COLLADA file, or the first one in an archive (.zae)."""
    if data[:2] == b"PK":
        archive = Archive(data, name, access, _TREE)
        member = next((each for each in archive.members if each.lower().endswith(".dae")), None)
        if member is None:
            raise InputError(name, "the archive has no .dae file in it")
        data = archive.read(member)
    _check_xml(data, name)
    question = {"data": np.frombuffer(data, np.uint8)}
    (left_out, up, unit), made = _PYCOLLADA.ask((None, question), name, len(data), access.memory)
    corners = np.arange(len(made["positions"]))  # triangles have vertices of their own
    sizes = np.full(len(corners) // 3, 3)
    places, frame = made["positions"], Frame(up, unit)
    return ColouredPolygons(places, corners, sizes, made["colours"], "float32", tuple(left_out), frame)


def _check_xml(data: bytes, name: str) -> None:
    """Refuse truncated XML, which pycollada would read as far as it goes, and entities that expand."""
    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = _refuse
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, ValueError) as error:
        raise InputError(name, f"it is damaged ({error})", "export it again") from error


def _refuse(*_: object) -> None:
    raise ValueError("a document type, which could make it grow without bounds, is not allowed")


def _answer(_: object, question: dict[str, Array]) -> Message:
    """Return losses, axis and unit, and positions and colours of all corners of triangles, transformed by nodes."""
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
    asset = document.assetInfo
    up, unit = (asset.upaxis or "Y_UP")[0], float(asset.unitmeter or 1.0)
    if up == "X":  # and -y is to the right
        up, arrays["positions"] = "Y", arrays["positions"][:, [1, 0, 2]] * [-1, 1, 1]
    return (sorted(left), up, unit if 0 < unit < np.inf else 1.0), arrays


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
