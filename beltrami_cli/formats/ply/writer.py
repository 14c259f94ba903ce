"""Writing a whole mesh as a binary PLY file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.formats.colours import display_colours, left_out
from beltrami_cli.formats.document import Written
from beltrami_cli.formats.ply.body import values_in_bytes
from beltrami_cli.formats.ply.header import TYPES
from beltrami_cli.formats.ply.paint import store_colours

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from beltrami_cli.surface.records import MeshContents

_NAMES = {code: name for name, code in reversed(TYPES.items())}
_INTEGERS = {"uint8": "u1", "uint16": "u2"}  # the stored types that remain as they are
_MANY = 255  # corners that a list whose count is a uchar can have


def write_ply(contents: MeshContents, stem: str) -> Written:
    """Write a mesh as a little-endian PLY file.

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
    Positions become floats if that loses nothing, otherwise doubles. Colours keep 8 or 16 bit and become
    floats from any other type. PLY colours are display values by custom, so linear ones go through the sRGB
    transfer function; from 8 bit they become 16 bit, as the steps near black would merge otherwise.
    """
    colours, notices = display_colours(contents)
    kind = _INTEGERS.get(contents.stored, "f4")
    if contents.encoding == "linear" and kind == "u1":
        kind = "u2"
        notices.append("Linear 8-bit colours are written as 16-bit sRGB, so that dark steps stay apart.")
    if contents.alpha is not None:
        colours = np.column_stack([colours, contents.alpha])
    columns = [("x", "y", "z"), ("nx", "ny", "nz"), ("red", "green", "blue", "alpha")[: colours.shape[1]]]
    scale = 1.0 if kind == "f4" else float(np.iinfo(kind).max)
    blocks = [shortest(contents.positions), contents.normals, store_colours(colours, scale, kind)]
    properties, rows = vertex_element(columns, blocks)
    announced, polygons = face_element(contents.corners, contents.offsets)
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(rows)}",
        *properties,
        *announced,
    ]
    text = "".join(f"{line}\n" for line in [*header, "end_header"])
    return Written([text.encode(), rows.tobytes(), polygons], notices=(*notices, *left_out(contents)))


def shortest(positions: NDArray[np.float64]) -> NDArray[np.float32] | NDArray[np.float64]:
    """Return positions as floats if that loses nothing."""
    with np.errstate(over="ignore"):  # Beyond float32 they become infinite, which is not equal.
        single = positions.astype(np.float32)
    return single if bool((single == positions).all()) else positions


def vertex_element(
    columns: Sequence[tuple[str, ...]], blocks: Sequence[NDArray[Any] | None]
) -> tuple[list[str], NDArray[np.void]]:
    """Return the property lines and the rows of the vertex element.

    Parameters
    ----------
    columns : sequence of tuple of str
        Names of properties, block by block.
    blocks : sequence of ndarray of shape (V, number of the names), or None
        Their values, which become properties of the array's type; None: these properties are left out.
    """
    fields = [
        (name, values.dtype.str[1:])
        for names, values in zip(columns, blocks, strict=True)
        if values is not None
        for name in names
    ]
    count = next(len(values) for values in blocks if values is not None)
    rows = np.empty(count, [(name, "<" + kind) for name, kind in fields])
    for names, values in zip(columns, blocks, strict=True):
        if values is not None:
            for column, name in enumerate(names):
                rows[name] = values[:, column]
    return [f"property {_NAMES[kind]} {name}" for name, kind in fields], rows


def face_element(corners: NDArray[np.int32], offsets: NDArray[np.int64]) -> tuple[list[str], bytearray]:
    """Return the lines and the rows of the face element; none of either for a cloud of points.

    Parameters
    ----------
    corners : ndarray of int32, shape (K,)
        The corners of all polygons one after the other.
    offsets : ndarray of int64, shape (P + 1,)
        Polygon p has the corners from offsets[p] to offsets[p + 1].
    """
    sizes = np.diff(offsets)
    if not sizes.size:
        return [], bytearray()
    count = "u1" if sizes.max() <= _MANY else "u4"
    width = np.dtype(count).itemsize
    starts = width * np.arange(len(sizes)) + 4 * offsets[:-1]
    data = bytearray(width * len(sizes) + 4 * len(corners))
    values_in_bytes(data, "<" + count)[starts] = sizes
    items = 4 * np.arange(len(corners)) + np.repeat(width * np.arange(1, len(sizes) + 1), sizes)
    values_in_bytes(data, "<i4")[items] = corners
    return [f"element face {len(sizes)}", f"property list {_NAMES[count]} int vertex_indices"], data
