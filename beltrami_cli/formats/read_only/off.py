"""OFF files: text of vertices and polygons, with colours of either.

trimesh reads the positions and faces of OFF files [1]_ only: it drops all colours, and cuts polygons.

References
----------
.. [1] Geomview manual, "OFF Files", http://www.geomview.org/docs/html/OFF.html
"""

from __future__ import annotations

import re

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s, Int64s
from beltrami_cli.errors import InputError
from beltrami_cli.formats.files.tokens import Lines, without_comments
from beltrami_cli.formats.full_scale import full_scale
from beltrami_cli.formats.meshes.coloured_polygons import ColouredPolygons
from beltrami_cli.surface.polygons import polygons_of
from beltrami_cli.surface.precision import require_single

_HEADER = re.compile(rb"(?:\s++|#[^\n]*+\n)*+(ST)?(C)?(N)?(4)?(n)?OFF(?![A-Za-z_])", re.IGNORECASE)
_COLOUR = (3, 4)  # numbers
_MAX_INDEX = 1 << 53  # index that a float64 holds


def is_off(data: bytes) -> bool:
    return _HEADER.match(data) is not None


def read_off(data: bytes, name: str) -> ColouredPolygons:
    """Read an OFF file in text: one vertex a line, then one face a line."""
    header = _HEADER.match(data)
    assert header is not None  # by which it was recognised
    texture, _, normals, *other = header.groups()
    text = without_comments(b" " * header.end() + data[header.end() :], b"#")
    if any(other) or text.split(None, 1)[:1] == [b"BINARY"]:
        raise InputError(name, "only text of three dimensions is read of OFF", "save it as a plain OFF file")
    lines = Lines(data, text, name)
    vertices, faces = _counts(lines)
    first = 3 + (3 if normals else 0)
    table = _vertex_rows(lines, vertices, first)
    extra = table[:, first : table.shape[1] - (2 if texture else 0)]
    rows = slice(1 + vertices, 1 + vertices + faces)
    corners, offsets = _corners(lines, rows)
    if extra.shape[1] in _COLOUR and vertices:
        scaled, scale = _scaled(extra, name)
        inside = (corners >= 0) & (corners < vertices)  # other corners are refused later
        colours = scaled[np.where(inside, corners, 0)]
    else:
        shades, scale = _face_colours(lines, rows, np.diff(offsets))
        colours = shades[polygons_of(offsets)]
    stored = "uint8" if scale > 1 else "float32"
    left = [what for what, there in (("normals", normals), ("texture coordinates", texture)) if there]
    return ColouredPolygons(table[:, :3], corners, offsets, colours, stored, tuple(left))


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


def _vertex_rows(lines: Lines, vertices: int, least: int) -> Float64s:
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
    """Return the vertices of all corners, and the first corner of each face."""
    heads, stops = lines.heads[rows], lines.stops[rows]
    counted = lines.numbers(heads)
    wrong = ~((counted >= 1) & (counted < stops - heads) & (counted % 1 == 0))
    if wrong.any():
        cause = f"face {np.argmax(wrong)} does not name the vertices that it counts"
        raise InputError(lines.name, cause, "export it again")
    sizes = counted.astype(np.int64)
    offsets = np.append(0, np.cumsum(sizes))
    corners = lines.numbers(np.repeat(heads + 1 - offsets[:-1], sizes) + np.arange(offsets[-1]))
    if not ((np.abs(corners) < _MAX_INDEX) & (corners % 1 == 0)).all():
        raise InputError(lines.name, "a face names a vertex that cannot be", "export it again")
    return corners.astype(np.int64), offsets


def _face_colours(lines: Lines, rows: slice, sizes: Int64s) -> tuple[Float32s, float]:
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
