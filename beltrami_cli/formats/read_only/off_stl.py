"""OFF files with colours of vertices or of faces, and binary STL files with colours of triangles.

trimesh reads the places and faces of OFF files [1]_ only: it drops all colours, and cuts polygons.

Two bytes of every triangle of an STL file [2]_ are a colour, in two dialects. VisCAM and SolidView mark triangles that
have a colour by the highest bit; blue is in the lowest five. Materialise Magics has COLOR= and a colour for all in the
header, marks triangles without one of their own, and has red lowest. trimesh reads the triangles. It leaves the two
bytes as numbers, and makes text of the header, so both are understood here.

References
----------
.. [1] Geomview manual, "OFF Files", http://www.geomview.org/docs/html/OFF.html
.. [2] M. Burns, "Automated fabrication", 1993, section 6.5: the STL format.
"""

from __future__ import annotations

import io
import re

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s, Int64s
from beltrami_cli.errors import InputError, UnpaintedError
from beltrami_cli.formats.colours import ColouredPolygons, full_scale, joined
from beltrami_cli.formats.tokens import Lines, without_comments

OFF_HEADER = re.compile(rb"(?:\s++|#[^\n]*+\n)*+(ST)?(C)?(N)?(4)?(n)?OFF(?![A-Za-z_])", re.IGNORECASE)
_COLOUR = (3, 4)  # numbers
_LARGEST = 1 << 53  # index that a float64 holds


def read_off(data: bytes, name: str) -> ColouredPolygons:
    """Read an OFF file in text: one vertex a line, then one face a line."""
    header = OFF_HEADER.match(data)
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
        painted, scale = _of_faces(lines, rows, sizes)
        colours = np.repeat(painted, sizes, axis=0)
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
    if not ((np.abs(corners) < _LARGEST) & (corners % 1 == 0)).all():
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
    painted = np.isfinite(found[:, :3]).all(axis=1)
    if not painted.any():
        return np.full((len(sizes), 3), np.nan, np.float32), 1.0
    result = np.full((len(sizes), 4), np.nan, np.float32)
    scaled, scale = _scaled(found[painted, :3], lines.name)
    alpha = found[painted, 3] / (scale if np.nanmax(found[painted, 3], initial=0) > 1 else 1)
    result[painted] = np.column_stack([scaled, np.where(np.isnan(alpha), 1, alpha)])
    return result, scale


def _scaled(colours: Float64s, name: str) -> tuple[Float32s, float]:
    if not np.isfinite(colours).all():
        raise InputError(name, "a colour is not finite", "export it again")
    scale, _ = full_scale(colours[:, :3], name)
    values = colours / scale
    if colours.shape[1] == 4 and colours[:, 3].max() <= 1:  # colours of 0..255 with opacity of 0..1
        values[:, 3] = colours[:, 3]
    return values.astype(np.float32), scale


_HEADER, _TRIANGLE = 80, 50  # bytes
_MAGICS = b"COLOR="
_LEVELS = 31  # of five bits


def is_binary_stl(data: bytes) -> bool:
    """Return whether a file has the length that its number of triangles asks for."""
    if len(data) < _HEADER + 4:
        return False
    count = int.from_bytes(data[_HEADER : _HEADER + 4], "little")
    return len(data) == _HEADER + 4 + count * _TRIANGLE


def read_stl(data: bytes, name: str) -> ColouredPolygons:
    """Read a binary STL file; vertices at one place become one."""
    if not is_binary_stl(data):
        cause = "an STL file in text has no colours"
        raise UnpaintedError(name, cause, "export it as PLY or OBJ with colours")
    from trimesh.exchange.stl import load_stl_binary

    triangles = load_stl_binary(io.BytesIO(data))
    if "vertices" not in triangles:
        raise InputError(name, "there are no polygons", "nothing in it can be smoothed")
    bits = triangles["face_attributes"]["stl"]
    colours = np.full((len(bits), 3), np.nan, np.float32)
    lowest_first = np.stack([bits & 31, bits >> 5 & 31, bits >> 10 & 31], axis=1) / np.float32(_LEVELS)
    marked = bits >> 15 == 1
    at = data.find(_MAGICS, 0, _HEADER)
    if at >= 0 and at + len(_MAGICS) + 4 <= _HEADER:
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
