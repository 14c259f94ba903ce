"""The vertices and polygons of an OBJ file, and a list of its other contents.

Numbers of a `v` line: six are x y z r g b, and eight x y z w r g b a. Seven are x y z r g b a, unless all such lines
of the file have 1 as the fourth number and not all of them 1 as the seventh: then they are x y z w r g b. With three
to five numbers a vertex has no colour.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from beltrami_cli.arrays import Bools, Float64s, Int32s, Int64s
from beltrami_cli.errors import InputError
from beltrami_cli.formats.files.edits import NewNumbers, most_decimals
from beltrami_cli.formats.obj.polypaint import MARK, Polypaint, read_polypaint
from beltrami_cli.formats.obj.statements import Statements
from beltrami_cli.surface.polygons import polygons_of, polygons_with

_SIZES = (3, 4, 5, 6, 7, 8)
_WITH_COLOURS, _WITH_ALPHA_OR_WEIGHT, _WITH_ALPHA_AND_WEIGHT = 6, 7, 8  # numbers of a vertex with colours

_COORDINATE_DIGITS = 8  # of the largest new coordinate, at least: a little more than float32 has
_MAX_DECIMALS = 17

_UNSUPPORTED = {
    "materials": (b"usemtl",),
    "texture coordinates": (b"vt",),
    "normals": (b"vn",),
    "groups and objects": (b"g", b"o"),
    "lines and points": (b"l", b"p"),
    "curves and surfaces": (b"curv", b"curv2", b"surf"),
}
_DUPLICATE_NOTICE = "Vertices have colours on their own lines and in #MRGB lines; these are left as they are."


@dataclass(frozen=True)
class Vertices:
    """The vertices of a file."""

    positions: Float64s  # (N, 3) of all vertices; 0 where one is not finite
    finite: Bools  # (N,) which of them have a position
    coloured: Int64s  # (V,) which of these have colours, in file order
    colours: Float64s  # (V, 3) the numbers in the file
    alpha: Float64s | None  # (V,) the numbers in the file, if all coloured vertices have one
    token_starts: Int64s  # (V, 6) where positions and colours of coloured vertices stand in the file
    token_ends: Int64s
    notice: str  # on the interpretation of ambiguous numbers, or empty


def _read_vertices(statements: Statements) -> Vertices:
    """Read all vertices; InputError names the line of one that is not made of 3 to 8 finite numbers."""
    chosen = statements.select(b"v")
    if not chosen.size:
        cause = "there are no vertices ('v' lines)"
        raise InputError(statements.name, cause, "is this a Wavefront OBJ file?")
    tokens, offsets = statements.arguments(chosen)
    sizes = np.diff(offsets)
    strange = ~np.isin(sizes, _SIZES)
    if strange.any():
        bad = int(np.argmax(strange))
        line = statements.line(statements.heads[chosen[bad]])
        raise InputError(statements.name, f"line {line}: a vertex has 3 to 8 numbers, not {sizes[bad]}")
    values = statements.numbers(tokens)
    positions = values[offsets[:-1, None] + np.arange(3)]
    finite = np.asarray(np.isfinite(positions).all(axis=1))
    weights, notice = False, ""  # whether the fourth of seven numbers is a weight
    firsts = offsets[:-1][sizes == _WITH_ALPHA_OR_WEIGHT]
    if firsts.size:
        weights = bool((values[firsts + 3] == 1).all() and (values[firsts + 6] != 1).any())
        meaning = "x y z w r g b" if weights else "x y z r g b a"
        notice = f"Vertices of seven numbers are taken for {meaning}."
    coloured = np.flatnonzero((sizes >= _WITH_COLOURS) & finite)
    weighted = (sizes[coloured] == _WITH_ALPHA_AND_WEIGHT) | (
        (sizes[coloured] == _WITH_ALPHA_OR_WEIGHT) & weights
    )
    colour_at = (offsets[coloured] + 3 + weighted)[:, None] + np.arange(3)
    known_at = np.column_stack([offsets[coloured, None] + np.arange(3), colour_at])
    statements.require_finite(tokens, values, colour_at.ravel())
    has_alpha = offsets[coloured + 1] - colour_at[:, 2] > 1
    return Vertices(
        positions=np.where(finite[:, None], positions, 0),
        finite=finite,
        coloured=coloured,
        colours=values[colour_at],
        alpha=values[colour_at[:, 2] + 1] if has_alpha.size and has_alpha.all() else None,
        token_starts=statements.starts[tokens[known_at]],
        token_ends=statements.ends[tokens[known_at]],
        notice=notice,
    )


def _with_polypaint(polypaint: Polypaint, vertices: Vertices, statements: Statements) -> Vertices:
    """Return vertices without colours on their lines with the polypaint colours; only positions have tokens."""
    tokens, offsets = statements.arguments(statements.select(b"v"))
    kept = np.flatnonzero(vertices.finite)
    places = tokens[offsets[kept, None] + np.arange(3)]
    return replace(
        vertices,
        coloured=kept,
        colours=polypaint.colours.astype(np.float64),
        token_starts=statements.starts[places],
        token_ends=statements.ends[places],
    )


def new_positions(
    data: bytes, starts: Int64s, ends: Int64s, positions: Float64s, changed: Bools
) -> NewNumbers:
    """Format changed coordinates with the decimals of the old ones, and at least the precision of float32."""
    largest = float(np.abs(positions).max(initial=0)) or 1.0
    enough = _COORDINATE_DIGITS - 1 - int(np.floor(np.log10(largest)))
    present = most_decimals(data, starts, ends) if changed.any() else 0
    decimals = min(max(present, enough, 0), _MAX_DECIMALS)
    return NewNumbers(starts[changed], ends[changed], positions[changed], b"%%.%df" % decimals)


@dataclass(frozen=True)
class Scan:
    """The content of an OBJ file, except for texture coordinates and normals."""

    vertices: Vertices
    polypaint: Polypaint | None  # colours outside the lines of the vertices, or None
    corners: Int32s  # (K,) vertices of the corners of all polygons
    offsets: Int64s  # (P + 1,) where each polygon starts
    libraries: list[tuple[bytes, int]]  # arguments of `mtllib` statements, and their offsets
    dropped: tuple[str, ...]  # what conversions lose
    notices: tuple[str, ...]


def scan_file(statements: Statements) -> Scan:
    """Read an OBJ file; InputError names the line of a statement that is damaged."""
    data, name = statements.data, statements.name
    vertices, polypaint = _read_vertices(statements), None
    notices = []
    if not vertices.coloured.size:
        polypaint = read_polypaint(data, len(vertices.positions), name)
    elif MARK in data:
        notices.append(_DUPLICATE_NOTICE)
    if polypaint is not None:
        polypaint = Polypaint(polypaint.colours[vertices.finite], polypaint.starts[vertices.finite])
        vertices = _with_polypaint(polypaint, vertices, statements)
    corners, _, offsets = statements.corners(b"v")
    libraries = [statements.rest(chosen) for chosen in statements.select(b"mtllib").tolist()]
    dropped = [what for what, words in _UNSUPPORTED.items() if any(statements.select(w).size for w in words)]
    count = len(vertices.positions)
    missing = count - len(vertices.coloured)
    unknown = int(np.count_nonzero(~vertices.finite))
    if unknown:
        notices.append(
            f"{unknown} of {count} vertices have no finite position; they and their faces are ignored."
        )
        dropped.append("vertices without a finite position and their faces")
    if unknown < missing < count:
        notices.append(f"{missing} of {count} vertices have no colour; they and their faces are ignored.")
        dropped.append("vertices without colour and their faces")
    whole = corners.astype(np.int32)
    return Scan(vertices, polypaint, whole, offsets, libraries, tuple(dropped), tuple(notices))


def among(corners: Int32s, offsets: Int64s, vertices: Int64s, count: int) -> tuple[Int32s, Int64s]:
    """Keep the polygons whose corners are all among some vertices, and renumber these from 0."""
    row = np.full(count, -1, np.int32)
    row[vertices] = np.arange(len(vertices))
    moved = row[corners]
    kept = ~polygons_with(moved < 0, offsets)
    return moved[kept[polygons_of(offsets)]], np.concatenate([[0], np.cumsum(np.diff(offsets)[kept])])
