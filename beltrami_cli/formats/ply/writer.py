"""Writing a whole mesh as a little-endian PLY file: with colours, with textures, or with numbers at its vertices.

Positions become floats if that loses nothing, otherwise doubles. Colours keep 8 or 16 bit and become floats from any
other type. They are display values, so linear ones go through the sRGB transfer function; from 8 bit they become
16 bit, as the steps near black would merge otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Array, Float32s, Float64s, Int32s, Int64s, Uint8s
from beltrami_cli.formats.colours import display_colours, quantised
from beltrami_cli.formats.document import Written, not_converted
from beltrami_cli.formats.ply.tables import TYPES, values_in_bytes
from beltrami_cli.formats.textured_mesh import image_names
from beltrami_cli.surface.geometry import shortest_type
from beltrami_cli.surface.records import MeshContents, TexturedMesh, VertexColours

_NAMES = {code: name for name, code in reversed(TYPES.items())}
_INTEGERS = {"uint8": "u1", "uint16": "u2"}  # the stored types that remain as they are
_PLACES = (("x", "y", "z"), ("nx", "ny", "nz"))
_CHANNELS = ("red", "green", "blue", "alpha")
_MANY = 255  # corners that a list whose count is a uchar can have


def write_ply(contents: MeshContents, stem: str) -> Written:
    """Write a mesh with colours of vertices; there is one file, so that `stem` does not matter."""
    colours, notices = _stored_colours(contents)
    columns = [*_PLACES, _CHANNELS[: colours.shape[1]]]
    blocks = [shortest_type(contents.positions), contents.normals, colours]
    properties, rows = _vertex_element(columns, blocks)
    announced, polygons = _face_element(contents.corners, contents.offsets)
    header = _header([*properties, *announced]).encode()
    return Written([header, rows.tobytes(), polygons], notices=(*notices, *not_converted(contents)))


def _stored_colours(contents: MeshContents | VertexColours) -> tuple[Array, list[str]]:
    colours, notices = display_colours(contents)
    kind = _INTEGERS.get(contents.stored, "f4")
    if contents.encoding == "linear" and kind == "u1":
        kind = "u2"
        notices.append("Linear 8-bit colours are written as 16-bit sRGB, so that dark steps stay apart.")
    if contents.alpha is not None:
        colours = np.column_stack([colours, contents.alpha])
    return quantised(colours, kind), notices


def write_textured_ply(mesh: TexturedMesh, stem: str) -> Written:
    """Write a mesh and its textures as MeshLab and photogrammetry programs do; images are named after `stem`."""
    normals, lost = _normals_by_vertex(mesh)
    colours, notices = (None, []) if mesh.colours is None else _stored_colours(mesh.colours)
    columns = [*_PLACES, () if colours is None else _CHANNELS[: colours.shape[1]]]
    properties, rows = _vertex_element(columns, [shortest_type(mesh.positions), normals, colours])
    announced, faces = _textured_faces(mesh)
    images = image_names(mesh, stem)
    header = _header([*(f"comment TextureFile {image}" for image in images), *properties, *announced])
    files = {name: image.file.data for name, image in zip(images, mesh.images, strict=True)}
    lost += ["names of materials"] if any(material.name for material in mesh.materials) else []
    lost += ["groups and objects"] if len(mesh.groups) > 1 else []
    pieces = [header.encode(), rows.tobytes(), faces.tobytes()]
    return Written(pieces, files, (*notices, *not_converted(mesh, lost)))


def _normals_by_vertex(mesh: TexturedMesh) -> tuple[Float32s | None, list[str]]:
    """Return the normals of vertices, shape (V, 3), if all corners of a vertex agree, and notices of other ones."""
    if mesh.normals is None:
        return None, []
    normals = np.zeros((len(mesh.positions), 3), np.float32)
    normals[mesh.faces.ravel()] = mesh.normals.reshape(-1, 3)
    if np.array_equal(normals[mesh.faces], mesh.normals):
        return normals, []
    return None, ["normals, which differ at the corners of one vertex"]


def _textured_faces(mesh: TexturedMesh) -> tuple[list[str], NDArray[np.void]]:
    """Return the lines and the rows of triangles with their texture coordinates."""
    image_of = np.array([m.maps["baseColor"].image if m.maps else -1 for m in mesh.materials], np.int32)
    numbers = image_of[mesh.material_numbers]
    numbers[np.isnan(mesh.uv).any(axis=(1, 2))] = -1
    fields: list[Any] = [("corners", "u1"), ("vertices", "<i4", 3), ("numbers", "u1"), ("uv", "<f4", (3, 2))]
    announced = [
        f"element face {len(mesh.faces)}",
        "property list uchar int vertex_indices",
        "property list uchar float texcoord",
    ]
    if numbers.any():
        fields.append(("image", "<i4"))
        announced.append("property int texnumber")
    faces = np.empty(len(mesh.faces), fields)
    faces["corners"], faces["vertices"] = 3, mesh.faces
    faces["numbers"], faces["uv"] = 6, np.nan_to_num(mesh.uv) * [1, -1] + [0, 1]
    if numbers.any():
        faces["image"] = numbers
    return announced, faces


def write_scalars_as_ply(
    positions: Float64s,
    faces: Int32s,
    shades: Uint8s,
    scalars: Mapping[str, Float32s],
    comments: Sequence[str] = (),
) -> Written:
    """Write triangles whose vertices have a colour, (V, 3), and scalar properties by name, (V,)."""
    names = [("x", "y", "z"), ("red", "green", "blue"), *((name,) for name in scalars)]
    blocks = [shortest_type(positions), shades, *(values[:, None] for values in scalars.values())]
    properties, rows = _vertex_element(names, blocks)
    announced, polygons = _face_element(faces.ravel(), 3 * np.arange(len(faces) + 1))
    header = _header([*(f"comment {line}" for line in comments), *properties, *announced])
    return Written([header.encode("ascii", "replace"), rows.tobytes(), polygons])


def _header(lines: Sequence[str]) -> str:
    whole = ["ply", "format binary_little_endian 1.0", *lines, "end_header"]
    return "".join(f"{line}\n" for line in whole)


def _vertex_element(
    columns: Sequence[tuple[str, ...]], blocks: Sequence[Array | None]
) -> tuple[list[str], NDArray[np.void]]:
    """Return the lines and the rows of the vertex element; `blocks` of None are left out."""
    there = [(names, values) for names, values in zip(columns, blocks, strict=True) if values is not None]
    fields = {name: column for names, values in there for name, column in zip(names, values.T, strict=True)}
    count = len(there[0][1])
    rows = np.empty(count, [(name, f"<{column.dtype.str[1:]}") for name, column in fields.items()])
    for name, column in fields.items():
        rows[name] = column
    properties = [f"property {_NAMES[column.dtype.str[1:]]} {name}" for name, column in fields.items()]
    return [f"element vertex {count}", *properties], rows


def _face_element(corners: Int32s, offsets: Int64s) -> tuple[list[str], bytearray]:
    """Return the lines and the rows of the face element; none of either for a cloud of points."""
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
