"""Meshes as PLY files that beltrami reads."""

import numpy as np

_FACE_LINE = "property list uchar int vertex_indices"
_UV_LINES = ["property list uchar float texcoord", "property int texnumber"]
FACE = [("corners", "u1"), ("vertex", "<i4", 3)]
TEXTURED_FACE = [*FACE, ("numbers", "u1"), ("uv", "<f4", 6), ("texture", "<i4")]


def numbers(items, name, width, kind):
    values = np.empty(len(items) * width, kind)
    items.foreach_get(name, values)
    return values.reshape(-1, width) if width > 1 else values


def positions_of(mesh, matrix):
    """Return positions in world space, so that object scale counts."""
    places = numbers(mesh.vertices, "co", 3, np.float32).astype(np.float64)
    matrix = np.array(matrix)
    return (places @ matrix[:3, :3].T + matrix[:3, 3]).astype("<f4")


def triangles_of(mesh):
    mesh.calc_loop_triangles()
    triangles = mesh.loop_triangles
    return (
        numbers(triangles, "vertices", 3, np.int32),
        numbers(triangles, "loops", 3, np.int32),
        numbers(triangles, "material_index", 1, np.int32),
    )


def write_ply(path, positions, colours, faces, textures=()):
    """Write a binary PLY file; `colours` are uint8 or float, RGBA, or None."""
    rows = [("place", "<f4", 3)]
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment TextureFile {name}" for name in textures)]
    lines += [f"element vertex {len(positions)}", *(f"property float {axis}" for axis in "xyz")]
    if colours is not None:
        kind, word = ("u1", "uchar") if colours.dtype == np.uint8 else ("<f4", "float")
        rows.append(("colour", kind, 4))
        lines += [f"property {word} {name}" for name in ("red", "green", "blue", "alpha")]
    table = np.zeros(len(positions), rows)
    table["place"] = positions
    if colours is not None:
        table["colour"] = colours
    lines += [f"element face {len(faces)}", _FACE_LINE, *(_UV_LINES if textures else ()), "end_header\n"]
    path.write_bytes("\n".join(lines).encode() + table.tobytes() + faces.tobytes())
