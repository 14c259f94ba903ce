"""What one pass over the statements of an OBJ file leaves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from beltrami_cli.formats.obj.polygons import read_polygons
from beltrami_cli.formats.obj.polypaint import MARK, Polypaint, painted_by, read_polypaint
from beltrami_cli.formats.obj.statements import Statements
from beltrami_cli.formats.obj.vertices import Vertices, read_vertices

if TYPE_CHECKING:
    import numpy as np
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
    """What is in an OBJ file, texture coordinates and normals apart.

    Attributes
    ----------
    vertices : Vertices
        All vertices.
    polypaint : Polypaint or None
        Where the colours stand if they are not on the lines of the vertices.
    corners, offsets : ndarray
        Polygons as from `read_polygons`.
    libraries : list of (bytes, int)
        What stands behind `mtllib` keywords, and where.
    dropped : tuple of str
        What no conversion takes over.
    notices : tuple of str
        What the user should be told.
    """

    vertices: Vertices
    polypaint: Polypaint | None
    corners: NDArray[np.int32]
    offsets: NDArray[np.int64]
    libraries: list[tuple[bytes, int]]
    dropped: tuple[str, ...]
    notices: tuple[str, ...]


def scan_file(data: bytes, name: str) -> Scan:
    """Read an OBJ file.

    Raises
    ------
    InputError
        If a statement that counts is damaged, with the line.
    """
    statements = Statements(data, name)
    vertices, polypaint = read_vertices(statements, name), None
    notices = []
    if not vertices.coloured.size:
        polypaint = read_polypaint(data, len(vertices.positions), name)
    elif MARK in data:
        notices.append(_TWICE)
    if polypaint is not None:
        vertices = painted_by(polypaint, vertices, statements)
    corners, offsets = read_polygons(statements)
    libraries = [statements.rest(chosen) for chosen in statements.select(b"mtllib").tolist()]
    dropped = [
        what for what, words in _DROPPED.items() if any(statements.select(word).size for word in words)
    ]
    count = len(vertices.positions)
    missing = count - len(vertices.coloured)
    if 0 < missing < count:
        notices.append(f"{missing} of {count} vertices have no colour; they and their faces take no part.")
        dropped.append("vertices without colour and their faces")
    return Scan(vertices, polypaint, corners, offsets, libraries, tuple(dropped), tuple(notices))
