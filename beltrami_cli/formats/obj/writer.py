"""Writing a whole mesh as an OBJ file with vertex colours."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.colours import display_colours, left_out
from beltrami_cli.formats.document import Written

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from beltrami_cli.surface.records import MeshContents

_BLOCK = 1 << 16  # lines made at a time, which bounds the memory that their tokens take


def write_obj(contents: MeshContents, stem: str) -> Written:
    """Write a mesh as an OBJ file.

    Parameters
    ----------
    contents : MeshContents
        The mesh.
    stem : str
        Name of the file without folder and extension; not needed, as there is only one file.

    Returns
    -------
    Written
        The file, and what it does not hold of the mesh or holds in another way.

    Notes
    -----
    Positions and normals have as many digits as they need to be read back the same, colours six decimals.
    """
    colours, notices = display_colours(contents)
    if contents.stored not in ("uint8", "uint16", "text"):
        notices.append("Colours are rounded to six decimals.")
    if contents.alpha is not None:
        notices.append("Opacity is dropped: vertices of OBJ files hold red, green and blue only.")
    pieces = [*_vertex_lines(contents.positions, colours)]
    if contents.normals is not None:
        pieces += _normal_lines(contents.normals)
    pieces += _face_lines(
        contents.corners, contents.offsets, "{0}//{0}" if contents.normals is not None else "{0}"
    )
    return Written(pieces, notices=(*notices, *left_out(contents)))


def _vertex_lines(positions: NDArray[np.float64], colours: NDArray[np.float32]) -> Iterator[bytes]:
    short = shortest(positions)
    for block in blocks(len(positions)):
        tokens = [*spell(short[block]), *colours[block].T.tolist()]
        rows = zip(*tokens, strict=True)
        yield "".join([f"v {x} {y} {z} {r:.6f} {g:.6f} {b:.6f}\n" for x, y, z, r, g, b in rows]).encode()


def _normal_lines(normals: NDArray[np.float32]) -> Iterator[bytes]:
    for block in blocks(len(normals)):
        tokens = spell(normals[block])
        yield "".join([f"vn {x} {y} {z}\n" for x, y, z in zip(*tokens, strict=True)]).encode()


def _face_lines(corners: NDArray[np.int32], offsets: NDArray[np.int64], style: str) -> Iterator[bytes]:
    for block in blocks(len(offsets) - 1):
        ends = offsets[block.start : block.stop + 1]
        tokens = [style.format(index) for index in (corners[ends[0] : ends[-1]] + 1).tolist()]
        bounds = pairwise((ends - ends[0]).tolist())
        yield "".join([f"f {' '.join(tokens[first:stop])}\n" for first, stop in bounds]).encode()


def shortest(positions: NDArray[np.float64]) -> NDArray[np.float32] | NDArray[np.float64]:
    """Return positions as floats if that loses nothing, so that they are spelled with fewer digits."""
    with np.errstate(over="ignore"):  # Beyond float32 they become infinite, which is not equal.
        single = positions.astype(np.float32)
    return single if bool((single == positions).all()) else positions


def spell(rows: NDArray[np.float32] | NDArray[np.float64]) -> list[list[str]]:
    """Return the columns as the shortest tokens that are read back the same."""
    columns: list[list[str]] = rows.T.astype("U32").tolist()
    return columns


def blocks(count: int) -> Iterator[slice]:
    """Split lines into blocks that are made at a time."""
    for first in range(0, count, _BLOCK):
        yield slice(first, min(first + _BLOCK, count))
