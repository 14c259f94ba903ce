"""Writing a whole mesh as an OBJ file, with colours of vertices, or with materials and their textures.

Colours have six decimals, all other numbers as many digits as they need to be read back the same.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Array, Int32s, Int64s
from beltrami_cli.formats.colours import display_colours
from beltrami_cli.formats.document import Written, not_converted
from beltrami_cli.formats.textured_mesh import image_names, material_names, plain_name
from beltrami_cli.formats.tokens import number_lines
from beltrami_cli.surface.geometry import shortest_type
from beltrami_cli.surface.grouping import group_equal_rows
from beltrami_cli.surface.large_arrays import blocks
from beltrami_cli.surface.records import Material, MeshContents, Slot, TexturedMesh

_BLOCK = 1 << 16  # lines made at a time, which bounds the memory that their tokens take
_MATERIAL = "painted"
_COLOURED, _NORMAL = "v %s %s %s %.6f %.6f %.6f\n", "vn %s %s %s\n"
# By whether corners have texture coordinates and normals.
_FACES = {
    (False, False): "f {} {} {}\n",
    (True, False): "f {}/{} {}/{} {}/{}\n",
    (False, True): "f {}//{} {}//{} {}//{}\n",
    (True, True): "f {}/{}/{} {}/{}/{} {}/{}/{}\n",
}


def write_obj(contents: MeshContents, stem: str) -> Written:
    """Write a mesh as an OBJ file, which is alone, so that `stem` does not matter."""
    colours, notices = display_colours(contents)
    if contents.stored not in ("uint8", "uint16", "text"):
        notices.append("Colours are rounded to six decimals.")
    if contents.alpha is not None:
        notices.append("Opacity is dropped: vertices of OBJ files hold red, green and blue only.")
    pieces = [*number_lines(_COLOURED, shortest_type(contents.positions), colours)]
    if contents.normals is not None:
        pieces += number_lines(_NORMAL, contents.normals)
    style = "{0}//{0}" if contents.normals is not None else "{0}"
    pieces += _polygon_lines(contents.corners, contents.offsets, style)
    return Written(pieces, notices=(*notices, *not_converted(contents)))


def _polygon_lines(corners: Int32s, offsets: Int64s, style: str) -> Iterator[bytes]:
    for block in blocks(len(offsets) - 1, _BLOCK):
        ends = offsets[block.start : block.stop + 1]
        tokens = [style.format(index) for index in (corners[ends[0] : ends[-1]] + 1).tolist()]
        bounds = pairwise((ends - ends[0]).tolist())
        yield "".join([f"f {' '.join(tokens[first:stop])}\n" for first, stop in bounds]).encode()


def write_textured_obj(mesh: TexturedMesh, stem: str) -> Written:
    """Write a mesh with its materials, with a library and images that are named after `stem`."""
    names, images = material_names(mesh.materials, _MATERIAL), image_names(mesh, stem)
    positions, notices = shortest_type(mesh.positions), list[str]()
    vertices = number_lines("v %s %s %s\n", positions)
    if mesh.colours is not None:
        values, notices = display_colours(mesh.colours)
        vertices = number_lines(_COLOURED, positions, values)
        if mesh.colours.alpha is not None and (mesh.colours.alpha < 1).any():
            notices.append("Opacity of vertices is dropped: they hold red, green and blue only.")
    coordinates, coordinate_of = _distinct(mesh.uv)
    pieces = [f"mtllib {stem}.mtl\n".encode(), *vertices]
    pieces += number_lines("vt %s %s\n", (coordinates * [1, -1] + [0, 1]).astype(np.float32))
    columns: list[Array] = [mesh.faces + 1, coordinate_of]
    if mesh.normals is not None:
        normals, normal_of = _distinct(mesh.normals)
        pieces += number_lines(_NORMAL, normals)
        columns.append(normal_of)
    pieces += _parts(mesh, names, np.stack(columns, axis=2))
    entries = zip(names, mesh.materials, strict=True)
    library = "".join(_library_entry(name, material, images) for name, material in entries)
    files = {name: image.file.data for name, image in zip(images, mesh.images, strict=True)}
    mirrored = any("mirror" in shown.wrap for material in mesh.materials for shown in material.maps.values())
    lost = not_converted(mesh, ["mirrored repetition of textures"] if mirrored else [])
    return Written(pieces, {f"{stem}.mtl": library.encode(), **files}, (*notices, *lost))


def _distinct(corners: Array) -> tuple[Array, Int64s]:
    """Return the distinct rows of (F, 3, C) numbers, and which of them every corner has, from 1; 0 for NaN."""
    rows = corners.reshape(-1, corners.shape[2])
    given = ~np.isnan(rows).any(axis=1)
    number_of, first = group_equal_rows(*rows[given].T)
    numbers = np.zeros(len(rows), np.int64)
    numbers[given] = number_of + 1
    return rows[given][first], numbers.reshape(-1, 3)


def _parts(mesh: TexturedMesh, names: list[str], indices: NDArray[np.integer]) -> Iterator[bytes]:
    """Write triangles, shape (F, 3, 2 or 3), below the names of their groups and materials."""
    count = len(mesh.faces)
    group_of, material_of = mesh.group_numbers, mesh.material_numbers
    has_uv, has_normals = np.zeros((2, count), np.bool_)
    has_uv |= (indices[:, :, 1] > 0).all(axis=1)
    if indices.shape[2] > 2:
        has_normals |= (indices[:, :, 2] > 0).all(axis=1)
    kinds = np.column_stack([group_of, material_of, has_uv, has_normals])
    starts = np.flatnonzero(np.append(True, (kinds[1:] != kinds[:-1]).any(axis=1)))
    group, material = ("" if mesh.groups == ("",) else None), None
    for start, stop in pairwise([*starts.tolist(), count]):
        name = plain_name(mesh.groups[group_of[start]])
        if name != group:
            yield f"g {name or 'default'}\n".encode()
            group = name
        if material_of[start] != material:
            material = material_of[start]
            yield f"usemtl {names[material]}\n".encode()
        kept = [0, *([1] if has_uv[start] else []), *([2] if has_normals[start] else [])]
        style, triangles = _FACES[has_uv[start], has_normals[start]], indices[start:stop, :, kept]
        for block in blocks(len(triangles), _BLOCK):
            corners = triangles[block].reshape(-1, 3 * len(kept)).tolist()
            yield "".join([style.format(*corner) for corner in corners]).encode()


def _library_entry(name: str, material: Material, images: list[str]) -> str:
    """Return a material as a library has it; metalness and roughness as the common extension has them."""
    lines = [f"newmtl {name}", f"Kd {_numbers(material.colour)}"]
    lines += [f"Ke {_numbers(material.emission)}"] if any(material.emission) else []
    lines += [f"d {material.opacity:.6g}"] if material.opacity < 1 else []
    if "metallicRoughness" in material.maps or (material.metalness, material.roughness) != (0, 1):
        lines += [f"Pm {material.metalness:.6g}", f"Pr {material.roughness:.6g}"]
    lines.append("illum 1")
    keywords: dict[Slot, tuple[str, ...]] = {
        "baseColor": ("map_Kd", *(["map_d -imfchan m"] if material.alpha != "opaque" else [])),
        "emissive": ("map_Ke",),
        "normal": ("norm",),
        "metallicRoughness": ("map_Pr -imfchan g", "map_Pm -imfchan b"),
    }
    for slot, words in keywords.items():
        if slot in material.maps:
            shown = material.maps[slot]
            clamp = "-clamp on " if shown.wrap == ("clamp", "clamp") else ""
            lines += [f"{word} {clamp}{images[shown.image]}" for word in words]
    return "\n".join(lines) + "\n"


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:.6g}" for value in values)
