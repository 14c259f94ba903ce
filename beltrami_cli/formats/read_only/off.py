"""OFF files with colours of vertices or of faces.

trimesh reads the places and faces of OFF files only: it drops all colours, and cuts polygons.

References
----------
.. [1] Geomview manual, "OFF Files", http://www.geomview.org/docs/html/OFF.html
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s, Int64s
from beltrami_cli.errors import InputError
from beltrami_cli.formats.colours import full_scale
from beltrami_cli.formats.read_only.polygons import ColouredPolygons
from beltrami_cli.formats.tokens import require_short_lines

HEADER = re.compile(rb"(?:\s++|#[^\n]*+\n)*+(ST)?(C)?(N)?(4)?(n)?OFF(?![A-Za-z_])", re.IGNORECASE)
_COMMENT = re.compile(rb"#[^\r\n]*")
_COLOUR = (3, 4)  # numbers


def read_off(data: bytes, name: str) -> ColouredPolygons:
    """Read an OFF file in text: one vertex a line, then one face a line."""
    header = HEADER.match(data)
    assert header is not None  # by which it was recognised
    texture, _, normals, *other = header.groups()
    rest = _COMMENT.sub(b"", data[header.end() :])
    require_short_lines(rest, name)
    if any(other) or rest.split(None, 1)[:1] == [b"BINARY"]:
        raise InputError(name, "only text of three dimensions is read of OFF", "save it as a plain OFF file")
    lines = [line for line in rest.splitlines() if line and not line.isspace()]
    vertices, faces = _counts(lines, name)
    first = 3 + (3 if normals else 0)
    table = _table(lines[1 : 1 + vertices], first, name)
    extra = table[:, first : table.shape[1] - (2 if texture else 0)]
    rows = [line.split() for line in lines[1 + vertices : 1 + vertices + faces]]
    corners, sizes = _corners(rows, name)
    if extra.shape[1] in _COLOUR and vertices:
        scaled, scale = _scaled(extra, name)
        inside = (corners >= 0) & (corners < vertices)  # what is outside is refused later
        colours = scaled[np.where(inside, corners, 0)]
    else:
        painted, scale = _of_faces(rows, sizes, name)
        colours = np.repeat(painted, sizes, axis=0)
    stored = "uint8" if scale > 1 else "float32"
    left = [what for what, there in (("normals", normals), ("texture coordinates", texture)) if there]
    return ColouredPolygons(table[:, :3], corners, sizes, colours, stored, tuple(left))


def _counts(lines: Sequence[bytes], name: str) -> tuple[int, int]:
    try:
        vertices, faces = (int(word) for word in lines[0].split()[:2])
    except (IndexError, ValueError):
        raise InputError(name, "its first line does not count vertices and faces") from None
    if vertices < 0 or faces < 0 or vertices + faces > len(lines) - 1:
        cause = f"it announces {vertices} vertices and {faces} faces, but has {len(lines) - 1} lines"
        raise InputError(name, cause, "the file may be cut off")
    return vertices, faces


def _table(lines: Sequence[bytes], least: int, name: str) -> Float64s:
    rows = [line.split() for line in lines]
    width = len(rows[0]) if rows else least
    for number, row in enumerate(rows):
        if len(row) != width or width < least:
            cause = f"vertex {number} has {len(row)} numbers, not {max(width, least)}"
            raise InputError(name, cause, "export it again")
    try:
        return np.array(rows, np.float64).reshape(-1, width)
    except ValueError:
        raise InputError(name, "a vertex is not made of numbers", "export it again") from None


def _corners(rows: Sequence[Sequence[bytes]], name: str) -> tuple[Int64s, Int64s]:
    corners: list[int] = []
    sizes = []
    for number, row in enumerate(rows):
        try:
            size = int(row[0])
            new = [int(word) for word in row[1 : 1 + size]] if size > 0 else []
        except ValueError:
            new, size = [], -1
        if size < 1 or len(new) != size:
            cause = f"face {number} does not name the vertices that it counts"
            raise InputError(name, cause, "export it again")
        sizes.append(size)
        corners += new
    try:
        return np.array(corners, np.int64), np.array(sizes, np.int64)
    except OverflowError:
        raise InputError(name, "a face names a vertex that cannot be", "export it again") from None


def _of_faces(rows: Sequence[Sequence[bytes]], sizes: Int64s, name: str) -> tuple[Float32s, float]:
    found = np.full((len(rows), 4), np.nan)
    for number, (row, size) in enumerate(zip(rows, sizes.tolist(), strict=True)):
        words = row[1 + size :]  # one number is an index of a map that is not in the file
        if len(words) in _COLOUR:
            try:
                found[number, : len(words)] = [float(word) for word in words]
            except ValueError:
                raise InputError(name, f"the colour of face {number} is not made of numbers") from None
    painted = np.isfinite(found[:, :3]).all(axis=1)
    if not painted.any():
        return np.full((len(rows), 3), np.nan, np.float32), 1.0
    result = np.full((len(rows), 4), np.nan, np.float32)
    scaled, scale = _scaled(found[painted, :3], name)
    alpha = found[painted, 3] / (scale if np.nanmax(found[painted, 3], initial=0) > 1 else 1)
    result[painted] = np.column_stack([scaled, np.where(np.isnan(alpha), 1, alpha)])
    return result, scale


def _scaled(colours: Float64s, name: str) -> tuple[Float32s, float]:
    if not np.isfinite(colours).all():
        raise InputError(name, "a colour is not finite", "export it again")
    scale, _ = full_scale(colours[:, :3], name)
    values = colours / scale
    if colours.shape[1] == 4 and colours[:, 3].max() <= 1:  # beside colours of 0..255, opacity of 0..1
        values[:, 3] = colours[:, 3]
    return values.astype(np.float32), scale
