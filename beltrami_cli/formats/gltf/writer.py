"""Meshes written as new, minimal glTF files: with colours of vertices, or with materials and textures."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Array, Float32s, Float64s, Int64s
from beltrami_cli.errors import InputError
from beltrami_cli.formats.changes import Written
from beltrami_cli.formats.colours import linear_colour, linear_colours, quantised
from beltrami_cli.formats.gltf.accessors import COMPONENTS, Stored, padded_elements
from beltrami_cli.formats.gltf.buffers import INDEX_DATA, VERTEX_DATA
from beltrami_cli.formats.gltf.container import BIN_CHUNK, JSON_CHUNK, Chunk, glb_pieces
from beltrami_cli.formats.gltf.entries import Tree
from beltrami_cli.formats.gltf.images import MEDIA, WRAPS
from beltrami_cli.formats.gltf.materials import EMISSIVE_STRENGTH, SLOT_PATHS
from beltrami_cli.formats.gltf.primitives import OWN_COLOURS
from beltrami_cli.formats.meshes.writing import (
    bare_polygons,
    image_names,
    normals_of_corners,
    not_converted,
    plain_name,
    shown_materials,
    triangulated,
)
from beltrami_cli.surface.geometry import unit_vectors
from beltrami_cli.surface.grouping import group_equal_rows
from beltrami_cli.surface.records import Frame, ImageFile, Material, MeshContents, MeshImage

_STORED_AS = {("linear", "uint8"): "<u1", ("linear", "uint16"): "<u2", ("srgb", "uint8"): "<u2"}
"""Component type of COLOR_0 by encoding and type of the source; float32 for all others.

sRGB levels are closest near black, where one of 255 is 20 of 65535 linear steps and one of 65535 is 0.08:
16 bits keep all 8-bit sRGB levels apart, and only float32 keeps the 16-bit ones.
"""

_COMPONENT_TYPE = {np.dtype(name): number for number, name in COMPONENTS.items()}
_MAX_FOR_U16 = 65535  # vertices: index 65535 would mean the restart of a strip
_LINEAR, _MIPMAPS = 9729, 9987  # filters of samplers
_OWN_COLOURS_NOTICE = (
    f"Vertex colours of textured parts are kept as {OWN_COLOURS}: as COLOR_0 they would tint the texture."
)

Model = tuple[list[Tree], Tree, Mapping[str, ImageFile]]
"""Meshes, the members of the JSON that colour these, and images by the names of their files."""


def _written(mesh: MeshContents, stem: str, *, is_binary: bool) -> Written:
    """Write a mesh as one binary file, or as JSON text with sidecar files for its numbers and its images."""
    arrays, sidecars, shown, mesh = Arrays(), dict[str, bytes](), list[Tree](), triangulated(mesh)
    meshes, look, images = (_coloured if mesh.uv is None else _textured)(mesh, stem, arrays)
    arrays.notices += not_converted(mesh, keeps_frame=True)
    for name, image in images.items():
        if is_binary:
            place = {"bufferView": arrays.add_bytes(image.data), "mimeType": MEDIA[image.suffix]}
        else:
            place, sidecars[name] = {"uri": quote(name)}, image.data
        shown.append(place | {"name": name.rpartition(".")[0]})
    binary, name = bytes(arrays.binary), f"{stem}.bin"
    buffer = {"byteLength": len(binary)} | ({} if is_binary else {"uri": quote(name)})
    tree = {
        "asset": {"version": "2.0", "generator": "beltrami"},
        **_scene(meshes, mesh.frame),
        "meshes": meshes,
        **look,
        "accessors": arrays.accessors,
        "bufferViews": arrays.views,
        "images": shown,
        "buffers": [buffer],
    }
    tree = {key: value for key, value in tree.items() if value != []}
    separators, indent = ((",", ":"), None) if is_binary else (None, 2)
    text = json.dumps(tree, ensure_ascii=False, separators=separators, indent=indent).encode()
    if is_binary:
        pieces = glb_pieces([Chunk(JSON_CHUNK, text), Chunk(BIN_CHUNK, binary)])
        return Written(pieces, notices=tuple(arrays.notices))
    return Written([text + b"\n"], {name: binary, **sidecars}, tuple(arrays.notices))


def _scene(meshes: list[Tree], frame: Frame) -> Tree:
    """Return the scene, which shows each mesh once."""
    nodes: list[Tree] = [{"mesh": number, "name": each["name"]} for number, each in enumerate(meshes)]
    shown = list(range(len(meshes)))
    if frame != Frame():
        unit, is_upright = frame.unit, frame.up == "Y"
        y, z = ([0, unit, 0, 0], [0, 0, unit, 0]) if is_upright else ([0, 0, -unit, 0], [0, unit, 0, 0])
        matrix = [unit, 0, 0, 0, *y, *z, 0, 0, 0, 1]  # column by column: metres, and y up
        nodes, shown = [*nodes, {"name": "root", "matrix": matrix, "children": shown}], [len(meshes)]
    return {"scene": 0, "scenes": [{"nodes": shown}], "nodes": nodes}


class Arrays:
    """Accessors, their views, and the bytes behind them, while they are put together, with notices for users."""

    def __init__(self) -> None:
        self.notices: list[str] = []
        self.accessors: list[Tree] = []
        self.views: list[Tree] = []
        self.binary = bytearray()

    def add(self, numbers: Stored, *, bounds: bool = False, target: int = VERTEX_DATA) -> int:
        """Add an array of shape (n, width) and return its accessor; vertex elements are padded to 4 bytes."""
        octets, size = padded_elements(numbers)
        if target == INDEX_DATA:
            octets = octets[:, :size]
        stride = octets.shape[1]
        view = self.add_bytes(octets.tobytes())
        self.views[view] |= ({"byteStride": stride} if stride != size else {}) | {"target": target}
        accessor: dict[str, Any] = {
            "bufferView": view,
            "componentType": _COMPONENT_TYPE[numbers.dtype],
            "count": len(numbers),
            "type": {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}[numbers.shape[1]],
        }
        if numbers.dtype.kind == "u" and target == VERTEX_DATA:
            accessor["normalized"] = True
        if bounds:
            accessor |= {"min": numbers.min(axis=0).tolist(), "max": numbers.max(axis=0).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1

    def add_faces(self, faces: NDArray[np.integer[Any]], vertices: int) -> int:
        """Add triangles, shape (F, 3), as narrow as the number of vertices allows, and return their accessor."""
        narrow = vertices <= _MAX_FOR_U16
        return self.add(faces.reshape(-1, 1).astype("<u2" if narrow else "<u4"), target=INDEX_DATA)

    def add_bytes(self, content: bytes) -> int:
        self.binary += bytes(-len(self.binary) % 4)
        self.views.append({"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(content)})
        self.binary += content
        return len(self.views) - 1


def _coloured(contents: MeshContents, stem: str, arrays: Arrays) -> Model:
    """Make a mesh with colours of vertices, which become linear, as glTF demands; `stem` is its name."""
    positions, rounding = _single_precision(contents.positions, stem)
    colours, conversions = _stored_colours(contents)
    arrays.notices += [*rounding, *conversions]
    attributes = {"POSITION": arrays.add(positions, bounds=True), "COLOR_0": arrays.add(colours)}
    if contents.normals is not None:
        attributes["NORMAL"] = arrays.add(_unit_normals(contents.normals))
    has_faces = len(contents.corners) > 0
    drawing = {"indices": arrays.add_faces(contents.corners, len(positions))} if has_faces else {"mode": 0}
    # glTF's default material is bare metal, which shows colours black without a sky.
    bare = {"metallicFactor": 0, "roughnessFactor": 1}
    material: Tree = {"pbrMetallicRoughness": bare, "doubleSided": True}
    if contents.alpha is not None and np.any(contents.alpha < 1):
        material["alphaMode"] = "BLEND"
    primitive = {"attributes": attributes, "material": 0, **drawing}
    return [{"primitives": [primitive], "name": stem}], {"materials": [material]}, {}


def _single_precision(exact: Float64s, stem: str) -> tuple[Stored, list[str]]:
    """Return positions as glTF stores them, and a notice if that rounds them."""
    with np.errstate(over="ignore"):
        positions = exact.astype("<f4")
    if not np.isfinite(positions).all():
        raise InputError(
            stem, "positions are too large for glTF, which stores float32", "scale the mesh down"
        )
    return positions, ["Positions are rounded to single precision."] if np.any(positions != exact) else []


def _stored_colours(contents: MeshContents) -> tuple[Stored, list[str]]:
    """Return COLOR_0 as stored, shape (V, 3), or (V, 4) with alpha, and notices."""
    colours, notices = linear_colours(contents, "glTF demands", "Grey values become three equal channels.")
    if np.any((colours < 0) | (colours > 1)):
        colours = np.clip(colours, 0, 1)
        notices.append("Colours outside [0, 1] are clipped, since glTF does not allow them.")
    if contents.alpha is not None:
        colours = np.concatenate([colours, np.clip(contents.alpha, 0, 1)[:, None]], axis=1)
    return quantised(colours, _STORED_AS.get((contents.encoding, contents.stored), "<f4")), notices


def _unit_normals(normals: Float32s) -> Stored:
    """Return normals of length one; where there is none, upwards, since glTF allows no others."""
    units = unit_vectors(np.nan_to_num(normals.astype(np.float64), posinf=0, neginf=0))
    units[~units.any(axis=1)] = [0.0, 0.0, 1.0]
    return units.astype("<f4")


def _textured(mesh: MeshContents, stem: str, arrays: Arrays) -> Model:
    """Make a mesh with its textures; vertices are split where their corners differ."""
    mesh = _with_bare_materials(mesh)
    positions, rounding = _single_precision(mesh.positions, stem)
    colours, conversions = _stored_colours(mesh) if mesh.colours.shape[1] else (None, [])
    arrays.notices += [*rounding, *conversions]
    meshes: list[Tree] = []
    for number in np.unique(mesh.group_numbers).tolist():
        faces = np.flatnonzero(mesh.group_numbers == number)
        material_of = mesh.material_numbers[faces]
        primitives = [
            _primitive(mesh, faces[material_of == material], positions, colours, arrays)
            | {"material": material}
            for material in np.unique(material_of).tolist()
        ]
        meshes.append({"primitives": primitives, "name": plain_name(mesh.groups[number]) or stem})
    is_bright = any(each.emission_strength != 1 for each in mesh.materials)
    look: Tree = {"extensionsUsed": [EMISSIVE_STRENGTH] if is_bright else []}
    look |= {"materials": [], "textures": [], "samplers": []}
    for each in mesh.materials:
        look["materials"].append(_material(each, look, mesh.images, stem))
    images = {name: image.file for name, image in zip(image_names(mesh, stem), mesh.images, strict=True)}
    arrays.notices[:] = dict.fromkeys(arrays.notices)
    return meshes, look, images


def _with_bare_materials(mesh: MeshContents) -> MeshContents:
    """Give triangles without texture coordinates copies of their materials that have no maps, as glTF demands."""
    bare = bare_polygons(mesh)
    material_of = mesh.material_numbers
    materials, numbers = list(mesh.materials), material_of.copy()
    for index in np.unique(material_of[bare]).tolist():
        if materials[index].maps:
            numbers[bare & (material_of == index)] = len(materials)
            materials.append(dataclasses.replace(materials[index], maps={}))
    shown, numbers = shown_materials(materials, numbers)
    return dataclasses.replace(mesh, materials=shown, material_of=numbers)


def _primitive(
    mesh: MeshContents, faces: Int64s, positions: Stored, colours: Stored | None, arrays: Arrays
) -> Tree:
    """Return a primitive for triangles of one material; its numbers go into the arrays."""
    mesh = mesh.polygons(faces)
    assert mesh.uv is not None
    corners, uv = mesh.corners, mesh.uv.astype("<f4")
    tables: dict[str, Array] = {"TEXCOORD_0": uv} if np.isfinite(uv).all() else {}
    normals, lost = normals_of_corners(mesh)
    arrays.notices += lost
    if normals is not None:
        tables["NORMAL"] = normals
    vertex_of, first = group_equal_rows(corners, *(column for table in tables.values() for column in table.T))
    attributes = {"POSITION": arrays.add(positions[corners[first]], bounds=True)}
    for name, table in tables.items():
        attributes[name] = arrays.add(_unit_normals(table[first]) if name == "NORMAL" else table[first])
    if colours is not None:
        is_textured = "baseColor" in mesh.materials[mesh.material_numbers[0]].maps
        attributes[OWN_COLOURS if is_textured else "COLOR_0"] = arrays.add(colours[corners[first]])
        arrays.notices += [_OWN_COLOURS_NOTICE] if is_textured else []
    return {"attributes": attributes, "indices": arrays.add_faces(vertex_of.reshape(-1, 3), len(first))}


def _index(entry: Tree, entries: list[Tree]) -> int:
    if entry not in entries:
        entries.append(entry)
    return entries.index(entry)


def _material(material: Material, look: Tree, images: Sequence[MeshImage], stem: str) -> Tree:
    """Return a material, whose textures and samplers are added to the tree."""
    base: Tree = {}
    name = plain_name(material.name) or stem
    tree: Tree = {"name": name, "pbrMetallicRoughness": base, "doubleSided": True}
    for slot, shown in material.maps.items():
        *parents, last = SLOT_PATHS[slot][0]
        wraps = {"wrapS": WRAPS[shown.wrap[0]], "wrapT": WRAPS[shown.wrap[1]]}
        sampler = _index({"magFilter": _LINEAR, "minFilter": _MIPMAPS, **wraps}, look["samplers"])
        texture = _index({"sampler": sampler, "source": images.index(shown.image)}, look["textures"])
        holder = tree
        for key in parents:
            holder = holder.setdefault(key, {})
        holder[last] = {"index": texture}
    factor = [*_linear(material.colour), material.opacity]
    if factor != [1.0] * 4:
        base["baseColorFactor"] = factor
    base["metallicFactor"] = _plain(material.metalness)
    base["roughnessFactor"] = _plain(material.roughness)
    if any(material.emission):
        tree["emissiveFactor"] = _linear(material.emission)
    if material.emission_strength != 1:
        tree["extensions"] = {EMISSIVE_STRENGTH: {"emissiveStrength": material.emission_strength}}
    if material.alpha != "opaque":
        tree["alphaMode"] = material.alpha.upper()
    if material.alpha == "mask" and material.cutoff != Material.cutoff:
        tree["alphaCutoff"] = material.cutoff
    return tree


def _linear(colour: tuple[float, ...]) -> list[float]:
    return [round(value, 6) for value in linear_colour(colour)]


def _plain(factor: float) -> float | int:
    return int(factor) if factor in (0, 1) else factor


write_glb = partial(_written, is_binary=True)
write_gltf = partial(_written, is_binary=False)
