"""What is in an OBJ file beside textures: vertices, polygons, and normals as far as vertices have them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.obj.statements import Statements
from beltrami_cli.formats.obj.vertices import (
    MARK,
    Polypaint,
    Vertices,
    painted_by,
    read_polypaint,
    read_vertices,
)
from beltrami_cli.surface.geometry import unit_vectors

if TYPE_CHECKING:
    from numpy.typing import NDArray


_DROPPED = {
    "materials": (b"usemtl",),
    "texture coordinates": (b"vt",),
    "normals": (b"vn",),
    "groups and objects": (b"g", b"o"),
    "lines and points": (b"l", b"p"),
    "curves and surfaces": (b"curv", b"curv2", b"surf"),
}
_TWICE = "Vertices have colours on their own lines and in #MRGB lines; these are left as they are."


@dataclass(frozen=True)
class Scan:
    """What is in an OBJ file, texture coordinates and normals apart."""

    vertices: Vertices
    polypaint: Polypaint | None  # where the colours stand if they are not on the lines of the vertices
    corners: NDArray[np.int32]  # (K,) vertices of the corners of all polygons
    offsets: NDArray[np.int64]  # (P + 1,) where each polygon starts
    libraries: list[tuple[bytes, int]]  # what stands behind `mtllib` keywords, and where
    dropped: tuple[str, ...]  # what no conversion takes over
    notices: tuple[str, ...]


def scan_file(data: bytes, name: str) -> Scan:
    """Read an OBJ file; InputError names the line of a statement that is damaged."""
    statements = Statements(data, name)
    vertices, polypaint = read_vertices(statements, name), None
    notices = []
    if not vertices.coloured.size:
        polypaint = read_polypaint(data, len(vertices.positions), name)
    elif MARK in data:
        notices.append(_TWICE)
    if polypaint is not None:
        vertices = painted_by(polypaint, vertices, statements)
    corners, _, offsets = statements.corners(b"v")
    libraries = [statements.rest(chosen) for chosen in statements.select(b"mtllib").tolist()]
    dropped = [
        what for what, words in _DROPPED.items() if any(statements.select(word).size for word in words)
    ]
    count = len(vertices.positions)
    missing = count - len(vertices.coloured)
    if 0 < missing < count:
        notices.append(f"{missing} of {count} vertices have no colour; they and their faces take no part.")
        dropped.append("vertices without colour and their faces")
    return Scan(
        vertices, polypaint, corners.astype(np.int32), offsets, libraries, tuple(dropped), tuple(notices)
    )


def among(
    corners: NDArray[np.int32], offsets: NDArray[np.int64], vertices: NDArray[np.int64], count: int
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Keep the polygons that have all corners among some vertices, and number these from 0."""
    row = np.full(count, -1, np.int32)
    row[vertices] = np.arange(len(vertices))
    sizes = np.diff(offsets)
    moved = row[corners]
    polygon = np.repeat(np.arange(len(sizes)), sizes)
    kept = np.bincount(polygon[moved < 0], minlength=len(sizes)) == 0
    ends = np.concatenate([[0], np.cumsum(sizes[kept])])
    return moved[kept[polygon]], ends


def read_normals(statements: Statements, corners: NDArray[np.int32], count: int) -> NDArray[np.float64]:
    """Read the unit normals of all vertices, shape (count, 3); NaN where no corner of a vertex has one."""
    values = _unit_normals(statements)
    rows, tokens, _ = statements.corners(b"vn")
    given = rows >= 0
    normals = np.full((count, 3), np.nan)
    vertices, found = corners[given], values[rows[given]]
    normals[vertices[::-1]] = found[::-1]  # so that the first one of a vertex stays
    differs = (normals[vertices] != found).any(axis=1)
    if differs.any():
        token = tokens[given][int(np.argmax(differs))]
        raise statements.error(token, "has another normal than an earlier corner of the same vertex")
    return normals


def _unit_normals(statements: Statements) -> NDArray[np.float64]:
    """Return all `vn` statements as unit vectors, shape (N, 3)."""
    chosen = statements.select(b"vn")
    tokens, offsets = statements.arguments(chosen)
    wrong = np.diff(offsets) != 3
    if wrong.any():
        head = statements.heads[chosen[int(np.argmax(wrong))]]
        raise statements.error(head, "has not three numbers behind it")
    return unit_vectors(statements.finite_numbers(tokens).reshape(-1, 3))
