"""Write a mesh as a little-endian PLY file: with colours, with textures, or with scalar properties of vertices.

Positions become floats if that loses nothing, otherwise doubles. Colours keep 8 or 16 bit and become floats from any
other type. They are display values, so linear ones go through the sRGB transfer function; from 8 bit they become
16 bit, as the steps near black would merge otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Array, Float32s, Float64s, Int32s, Uint8s
from beltrami_cli.formats.changes import Written
from beltrami_cli.formats.colours import display_colours, quantised
from beltrami_cli.formats.meshes.writing import (
    bare_polygons,
    image_names,
    lost_repetition,
    not_converted,
)
from beltrami_cli.formats.ply.header import NORMAL, POSITION, TYPES
from beltrami_cli.formats.ply.tables import values_in_bytes
from beltrami_cli.surface.polygons import polygons_of
from beltrami_cli.surface.precision import shortest_type
from beltrami_cli.surface.records import Material, MeshContents

_NAMES = {code: name for name, code in reversed(TYPES.items())}
_INTEGERS = {"uint8": "u1", "uint16": "u2"}  # stored types that are kept
_CHANNELS = ("red", "green", "blue", "alpha")
_MAX_CORNERS = 255  # corners that a list whose count is a uchar can have


def write_ply(mesh: MeshContents, stem: str) -> Written:
    """Write a mesh; textures as MeshLab and photogrammetry programs do, with images that are named after `stem`."""
    colours, notices = _stored_colours(mesh) if mesh.colours.shape[1] else (None, [])
    normals, lost = _normals_by_vertex(mesh)
    columns = [POSITION, NORMAL, () if colours is None else _CHANNELS[: colours.shape[1]]]
    properties, rows = _vertex_element(columns, [shortest_type(mesh.positions), normals, colours])
    announced, faces = _face_element(mesh)
    images = dict(zip(image_names(mesh, stem), mesh.images, strict=True))
    header = _header([*(f"comment TextureFile {name}" for name in images), *properties, *announced])
    lost += lost_repetition(mesh, "repeat")
    is_bare = all(material == Material(maps=material.maps) for material in mesh.materials)
    lost += [] if is_bare else ["materials, except for their base colour images"]
    lost += ["groups and objects"] if len(mesh.groups) > 1 else []
    files = {name: image.file.data for name, image in images.items()}
    pieces = [header, rows.tobytes(), faces.tobytes()]
    return Written(pieces, files, (*notices, *not_converted(mesh, lost)))


def _stored_colours(mesh: MeshContents) -> tuple[Array, list[str]]:
    colours, notices = display_colours(mesh)
    kind = _INTEGERS.get(mesh.stored, "f4")
    if mesh.encoding == "linear" and kind == "u1":
        kind = "u2"
        notices.append("Linear 8-bit colours are written as 16-bit sRGB, so that dark steps stay apart.")
    if mesh.alpha is not None:
        colours = np.column_stack([colours, mesh.alpha])
    return quantised(colours, kind), notices


def _normals_by_vertex(mesh: MeshContents) -> tuple[Float32s | None, list[str]]:
    """Return the normals of vertices, shape (V, 3), if all corners of a vertex agree, and notices of other ones."""
    if mesh.corner_normals is None:
        return mesh.normals, []
    normals = np.zeros((len(mesh.positions), 3), np.float32)
    normals[mesh.corners] = mesh.corner_normals
    if np.array_equal(normals[mesh.corners], mesh.corner_normals):
        return normals, []
    return None, ["normals, which differ at the corners of one vertex"]


def write_scalars_as_ply(
    positions: Float64s, faces: Int32s, shades: Uint8s, scalars: Mapping[str, Float32s]
) -> Written:
    """Write triangles whose vertices have a colour, (V, 3), and scalar properties by name, (V,)."""
    names = [POSITION, _CHANNELS[:3], *((name,) for name in scalars)]
    blocks = [shortest_type(positions), shades, *(values[:, None] for values in scalars.values())]
    properties, rows = _vertex_element(names, blocks)
    offsets, colours = 3 * np.arange(len(faces) + 1), np.empty((len(positions), 0), np.float32)
    announced, polygons = _face_element(MeshContents(positions, faces.ravel(), offsets, colours))
    return Written([_header([*properties, *announced]), rows.tobytes(), polygons.tobytes()])


def _header(lines: Sequence[str]) -> bytes:
    whole = ["ply", "format binary_little_endian 1.0", *lines, "end_header"]
    return "".join(f"{line}\n" for line in whole).encode()


def _vertex_element(
    columns: Sequence[tuple[str, ...]], blocks: Sequence[Array | None]
) -> tuple[list[str], NDArray[np.void]]:
    """Return the lines and the rows of the vertex element; `blocks` of None are left out."""
    given = [(names, values) for names, values in zip(columns, blocks, strict=True) if values is not None]
    fields = {name: column for names, values in given for name, column in zip(names, values.T, strict=True)}
    count = len(given[0][1])
    rows = np.empty(count, [(name, f"<{column.dtype.str[1:]}") for name, column in fields.items()])
    for name, column in fields.items():
        rows[name] = column
    properties = [f"property {_NAMES[column.dtype.str[1:]]} {name}" for name, column in fields.items()]
    return [f"element vertex {count}", *properties], rows


def _face_element(mesh: MeshContents) -> tuple[list[str], Uint8s]:
    """Return the lines and the bytes of the face element; none of either for a cloud of points."""
    sizes, polygon_of = mesh.sizes, polygons_of(mesh.offsets)
    if not sizes.size:
        return [], np.empty(0, np.uint8)
    lists: dict[str, Array] = {"int vertex_indices": mesh.corners[:, None].astype("<i4")}
    numbers = np.zeros(len(sizes), "<i4")
    if mesh.uv is not None:
        lists["float texcoord"] = (np.nan_to_num(mesh.uv) * [1, -1] + [0, 1]).astype("<f4")
        shown = [m.maps["baseColor"].image if m.maps else None for m in mesh.materials]
        image_of = np.array([-1 if each is None else mesh.images.index(each) for each in shown])
        numbers[:] = np.where(bare_polygons(mesh), -1, image_of[mesh.material_numbers])
    has_numbers, announced = bool(numbers.any()), [f"element face {len(sizes)}"]
    counts = ["u1" if sizes.max() * items.shape[1] <= _MAX_CORNERS else "u4" for items in lists.values()]
    row_sizes = np.full(len(sizes), 4 * has_numbers)
    for count, items in zip(counts, lists.values(), strict=True):
        row_sizes += np.dtype(count).itemsize + 4 * items.shape[1] * sizes
    at, data = np.cumsum(row_sizes) - row_sizes, bytearray(int(row_sizes.sum()))
    within = np.arange(len(mesh.corners)) - mesh.offsets[polygon_of]
    for count, (name, items) in zip(counts, lists.items(), strict=True):
        width = items.shape[1]
        values_in_bytes(data, "<" + count)[at] = width * sizes
        at = at + np.dtype(count).itemsize
        places = (at[polygon_of] + 4 * width * within)[:, None] + 4 * np.arange(width)
        values_in_bytes(data, items.dtype.str)[places] = items
        at = at + 4 * width * sizes
        announced.append(f"property list {_NAMES[count]} {name}")
    if has_numbers:
        values_in_bytes(data, "<i4")[at] = numbers
        announced.append("property int texnumber")
    return announced, np.frombuffer(data, np.uint8)
