"""Writing the points of a mesh or cloud as lines of text or as a NumPy archive."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.formats.colours import display_colours, left_out
from beltrami_cli.formats.document import Written
from beltrami_cli.formats.tokens import blocks
from beltrami_cli.surface.geometry import shortest_type
from beltrami_cli.surface.polygons import triangulate

if TYPE_CHECKING:
    from collections.abc import Iterator

    from beltrami_cli.arrays import Float32s, Float64s, Uint8s
    from beltrami_cli.surface.records import MeshContents

_BLOCK = 1 << 16  # lines made at a time, which bounds the memory that their tokens take
_BYTE = 255


def write_xyz(contents: MeshContents, stem: str) -> Written:
    """Write points as lines of x y z r g b, then normals.

    Positions have as many digits as they need to be read back the same. Colours of 8 bit are integers of 0 to 255, all
    others have six decimals, of 0 to 1.
    """
    return _lines(contents, [])


def write_pts(contents: MeshContents, stem: str) -> Written:
    """Write points as `write_xyz` does, below a line with their number."""
    return _lines(contents, [f"{len(contents.positions)}\n".encode()])


def write_npz(contents: MeshContents, stem: str) -> Written:
    """Write points as the arrays positions and colours, with normals and faces if there are any.

    Positions become floats if that loses nothing. Colours keep 8 or 16 bit and become floats from any other type;
    opacity is their fourth channel.
    """
    colours, notices = display_colours(contents)
    if contents.alpha is not None:
        colours = np.column_stack([colours, contents.alpha])
    if contents.stored in ("uint8", "uint16") and contents.encoding == "srgb":
        scale = np.iinfo(contents.stored).max
        stored = np.rint(np.clip(colours.astype(np.float64), 0, 1) * scale).astype(contents.stored)
    else:
        stored = colours.astype(np.float32)
    arrays: dict[str, Any] = {"positions": shortest_type(contents.positions), "colours": stored}
    if contents.normals is not None:
        arrays["normals"] = contents.normals
    if len(contents.offsets) > 1:
        arrays["faces"] = triangulate(contents.positions, contents.corners, contents.offsets)
        if np.any(np.diff(contents.offsets) > 3):
            notices.append("Quads and polygons are cut into triangles.")
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return Written([buffer.getvalue()], notices=(*notices, *left_out(contents)))


def _lines(contents: MeshContents, pieces: list[bytes]) -> Written:
    colours, notices = display_colours(contents)
    if contents.alpha is not None:
        notices.append("Opacity is dropped: a line has red, green and blue only.")
    if len(contents.offsets) > 1:
        notices.append("Faces are dropped: the file has points only.")
    whole = contents.stored == "uint8" and contents.encoding == "srgb"
    shades = np.rint(np.clip(colours.astype(np.float64), 0, 1) * _BYTE).astype(np.uint8) if whole else colours
    pieces += _blocks(shortest_type(contents.positions), shades, contents.normals)
    return Written(pieces, notices=(*notices, *left_out(contents)))


def _blocks(
    positions: Float32s | Float64s, shades: Uint8s | Float32s, normals: Float32s | None
) -> Iterator[bytes]:
    style = "%s %s %s " + " ".join(["%d" if shades.dtype == np.uint8 else "%.6f"] * 3)
    style += "\n" if normals is None else " %s %s %s\n"
    for block in blocks(len(positions), _BLOCK):
        columns = [*positions[block].T.astype("U32").tolist(), *shades[block].T.tolist()]
        columns += [] if normals is None else normals[block].T.astype("U32").tolist()
        yield "".join([style % row for row in zip(*columns, strict=True)]).encode()
