"""Write a mesh as an OBJ file, with vertex colours, or with materials and their textures.

Colours have six decimals, all other numbers as many digits as they need to be read back the same.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from beltrami_cli.arrays import Array, Int64s
from beltrami_cli.formats.changes import Written
from beltrami_cli.formats.colours import display_colours
from beltrami_cli.formats.files.tokens import number_lines
from beltrami_cli.formats.meshes.writing import (
    image_names,
    lost_repetition,
    material_names,
    not_converted,
    plain_name,
)
from beltrami_cli.surface.grouping import group_equal_rows
from beltrami_cli.surface.large_arrays import blocks
from beltrami_cli.surface.polygons import polygons_with
from beltrami_cli.surface.precision import shortest_type
from beltrami_cli.surface.records import Material, MeshContents, MeshImage, Slot

_BLOCK = 1 << 16  # lines made at a time, which bounds the memory that their tokens take
_COLOURED, _NORMAL = "v %s %s %s %.6f %.6f %.6f\n", "vn %s %s %s\n"
# By whether corners have texture coordinates and normals.
_CORNERS = {(False, False): "{}", (True, False): "{}/{}", (False, True): "{}//{}", (True, True): "{}/{}/{}"}


def write_obj(mesh: MeshContents, stem: str) -> Written:
    """Write a mesh; if it has materials, with a library and images that are named after `stem`."""
    positions, notices = shortest_type(mesh.positions), list[str]()
    vertices = number_lines("v %s %s %s\n", positions)
    if mesh.colours.shape[1]:
        values, notices = display_colours(mesh)
        vertices = number_lines(_COLOURED, positions, values)
        if mesh.stored not in ("uint8", "uint16", "text"):
            notices.append("Colours are rounded to six decimals.")
        if mesh.alpha is not None and (mesh.alpha < 1).any():
            notices.append("Opacity is dropped: vertices of OBJ files hold red, green and blue only.")
    pieces = [f"mtllib {stem}.mtl\n".encode(), *vertices] if mesh.materials else [*vertices]
    # Of position, texture coordinates and normal of each corner, from 1.
    indices = np.zeros((len(mesh.corners), 3), np.int64)
    indices[:, 0] = mesh.corners + 1
    if mesh.uv is not None:
        coordinates, indices[:, 1] = _distinct(mesh.uv)
        pieces += number_lines("vt %s %s\n", (coordinates * [1, -1] + [0, 1]).astype(np.float32))
    if mesh.corner_normals is not None:
        normals, indices[:, 2] = _distinct(mesh.corner_normals)
        pieces += number_lines(_NORMAL, normals)
    elif mesh.normals is not None:
        pieces += number_lines(_NORMAL, mesh.normals)
        indices[:, 2] = indices[:, 0]
    names, images = material_names(mesh.materials), image_names(mesh, stem)
    pieces += _polygons(mesh, names, indices)
    file_of = dict(zip(mesh.images, images, strict=True))
    entries = zip(names, mesh.materials, strict=True)
    library = "".join(_library_entry(name, material, file_of) for name, material in entries)
    sidecars = {f"{stem}.mtl": library.encode()} if mesh.materials else {}
    sidecars |= {name: image.file.data for image, name in file_of.items()}
    lost = lost_repetition(mesh, "repeat", "clamp")
    lost += (
        ["alpha cutoffs"] if any(material.cutoff != Material.cutoff for material in mesh.materials) else []
    )
    return Written(pieces, sidecars, (*notices, *not_converted(mesh, lost)))


def _distinct(corners: Array) -> tuple[Array, Int64s]:
    """Return the distinct rows of (K, C) numbers, and the index of each corner's row from 1; 0 for NaN."""
    given = ~np.isnan(corners).any(axis=1)
    number_of, first = group_equal_rows(*corners[given].T)
    numbers = np.zeros(len(corners), np.int64)
    numbers[given] = number_of + 1
    return corners[given][first], numbers


def _polygons(mesh: MeshContents, names: list[str], indices: Int64s) -> Iterator[bytes]:
    """Yield the lines of polygons, after the names of their groups and materials; indices are of corners."""
    group_of, material_of = mesh.group_numbers, mesh.material_numbers
    has = np.column_stack([~polygons_with(each == 0, mesh.offsets) for each in indices[:, 1:].T])
    kinds = np.column_stack([group_of, material_of, has])
    starts = np.flatnonzero((np.diff(kinds, axis=0, prepend=-1) != 0).any(axis=1))
    group, material = ("" if mesh.groups == ("",) else None), None
    for start, stop in pairwise([*starts.tolist(), len(kinds)]):
        name = plain_name(mesh.groups[group_of[start]])
        if name != group:
            yield f"g {name or 'default'}\n".encode()
            group = name
        if names and material_of[start] != material:
            material = material_of[start]
            yield f"usemtl {names[material]}\n".encode()
        has_uv, has_normals = has[start].tolist()
        style, columns = _CORNERS[has_uv, has_normals], np.array([True, has_uv, has_normals])
        for block in blocks(stop - start, _BLOCK):
            ends = mesh.offsets[start + block.start : start + block.stop + 1]
            corners = indices[ends[0] : ends[-1]].T[columns].tolist()
            tokens = [style.format(*corner) for corner in zip(*corners, strict=True)]
            bounds = pairwise((ends - ends[0]).tolist())
            yield "".join([f"f {' '.join(tokens[a:b])}\n" for a, b in bounds]).encode()


def _library_entry(name: str, material: Material, file_of: dict[MeshImage, str]) -> str:
    """Return a material as lines of MTL, with the usual extension for metalness and roughness."""
    lines = [f"newmtl {name}", f"Kd {_numbers(material.colour)}"]
    emission = tuple(material.emission_strength * channel for channel in material.emission)
    lines += [f"Ke {_numbers(emission)}"] if any(emission) else []
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
            lines += [f"{word} {clamp}{file_of[shown.image]}" for word in words]
    return "\n".join(lines) + "\n"


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:.6g}" for value in values)
