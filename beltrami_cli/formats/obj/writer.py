"""Writing a whole mesh as an OBJ file, with colours of vertices or with one texture.

Colours have six decimals, all other numbers as many digits as they need to be read back the same.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.colours import display_colours, left_out
from beltrami_cli.formats.document import Written
from beltrami_cli.formats.tokens import blocks
from beltrami_cli.surface.geometry import shortest_type
from beltrami_cli.surface.grouping import distinct_corners

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from beltrami_cli.surface.records import MeshContents, TexturedMesh

_BLOCK = 1 << 16  # lines made at a time, which bounds the memory that their tokens take
_MATERIAL = "painted"


def write_obj(contents: MeshContents, stem: str) -> Written:
    """Write a mesh as an OBJ file, which is alone, so that `stem` does not matter."""
    colours, notices = display_colours(contents)
    if contents.stored not in ("uint8", "uint16", "text"):
        notices.append("Colours are rounded to six decimals.")
    if contents.alpha is not None:
        notices.append("Opacity is dropped: vertices of OBJ files hold red, green and blue only.")
    pieces = [*_vertex_lines(contents.positions, colours)]
    if contents.normals is not None:
        pieces += _lines("vn {} {} {}\n", contents.normals)
    style = "{0}//{0}" if contents.normals is not None else "{0}"
    pieces += _polygon_lines(contents.corners, contents.offsets, style)
    return Written(pieces, notices=(*notices, *left_out(contents)))


def _vertex_lines(positions: NDArray[np.float64], colours: NDArray[np.float32]) -> Iterator[bytes]:
    short = shortest_type(positions)
    for block in blocks(len(positions), _BLOCK):
        tokens = [*_spelled(short[block]), *colours[block].T.tolist()]
        rows = zip(*tokens, strict=True)
        yield "".join([f"v {x} {y} {z} {r:.6f} {g:.6f} {b:.6f}\n" for x, y, z, r, g, b in rows]).encode()


def _polygon_lines(corners: NDArray[np.int32], offsets: NDArray[np.int64], style: str) -> Iterator[bytes]:
    for block in blocks(len(offsets) - 1, _BLOCK):
        ends = offsets[block.start : block.stop + 1]
        tokens = [style.format(index) for index in (corners[ends[0] : ends[-1]] + 1).tolist()]
        bounds = pairwise((ends - ends[0]).tolist())
        yield "".join([f"f {' '.join(tokens[first:stop])}\n" for first, stop in bounds]).encode()


def write_textured_obj(mesh: TexturedMesh, stem: str) -> Written:
    """Write a mesh and its texture, with a library and an image beside it that are named after `stem`."""
    first, coordinate_of = distinct_corners(*mesh.uv.reshape(-1, 2).T)
    coordinates = (mesh.uv.reshape(-1, 2)[first] * [1, -1] + [0, 1]).astype(np.float32)
    image = stem + mesh.image.suffix
    pieces = [
        f"mtllib {stem}.mtl\n".encode(),
        *_lines("v {} {} {}\n", shortest_type(mesh.positions)),
        *_lines("vt {} {}\n", coordinates),
        f"usemtl {_MATERIAL}\n".encode(),
        *_triangle_lines(mesh.faces + 1, coordinate_of.reshape(-1, 3) + 1),
    ]
    alpha = f"map_d -imfchan m -clamp on {image}\n" if mesh.transparent else ""
    material = f"newmtl {_MATERIAL}\nKd 1 1 1\nillum 1\nmap_Kd -clamp on {image}\n{alpha}"
    return Written(pieces, {f"{stem}.mtl": material.encode(), image: mesh.image.data})


def _lines(style: str, rows: NDArray[np.float32] | NDArray[np.float64]) -> Iterator[bytes]:
    for block in blocks(len(rows), _BLOCK):
        yield "".join([style.format(*row) for row in zip(*_spelled(rows[block]), strict=True)]).encode()


def _triangle_lines(vertices: NDArray[np.integer], coordinates: NDArray[np.integer]) -> Iterator[bytes]:
    for block in blocks(len(vertices), _BLOCK):
        corners = np.stack([vertices[block], coordinates[block]], axis=2).reshape(-1, 6).tolist()
        yield "".join(["f {}/{} {}/{} {}/{}\n".format(*corner) for corner in corners]).encode()


def _spelled(rows: NDArray[np.float32] | NDArray[np.float64]) -> list[list[str]]:
    """Return the columns as the shortest tokens that are read back the same."""
    columns: list[list[str]] = rows.T.astype("U32").tolist()
    return columns
