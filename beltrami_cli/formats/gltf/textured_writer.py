"""A mesh with materials and textures written as a new glTF file."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.gltf.image_storage import MEDIA
from beltrami_cli.formats.gltf.textures import SLOT_PATHS, WRAPS
from beltrami_cli.formats.gltf.uris import as_uri
from beltrami_cli.formats.gltf.writer import (
    Arrays,
    binary_file,
    single_precision,
    stored_colours,
    text_file,
    unit_normals,
)
from beltrami_cli.formats.textured_mesh import image_names, not_converted, plain_name, shown_materials
from beltrami_cli.surface.colour_values import srgb_to_linear
from beltrami_cli.surface.grouping import distinct_corners

if TYPE_CHECKING:
    from collections.abc import Iterator

    from beltrami_cli.arrays import Array, Int64s
    from beltrami_cli.formats.document import Written
    from beltrami_cli.formats.gltf.json_text import Tree
    from beltrami_cli.surface.records import Material, TexturedMesh, Wrap

OWN_COLOURS = "_COLOR_0"
"""The attribute of vertex colours beside a texture: COLOR_0 would be multiplied with it."""

_LINEAR, _MIPMAPS = 9729, 9987
_MODES = {"mask": "MASK", "blend": "BLEND"}
_BESIDE = (
    f"Vertex colours of textured parts are kept as {OWN_COLOURS}: as COLOR_0 they would tint the texture."
)


def write_textured_glb(mesh: TexturedMesh, stem: str) -> Written:
    """Write a mesh with its textures as one binary file; vertices are split where their corners differ."""
    notices: list[str] = []
    tree, arrays = _textured(mesh, stem, notices)
    tree["images"] = []
    for image, name in zip(mesh.images, _names(mesh, stem), strict=True):
        view = arrays.add_bytes(image.file.data)
        tree["images"].append({"bufferView": view, "mimeType": MEDIA[image.file.suffix], "name": name})
    return binary_file(_without_empty(tree), arrays, notices)


def write_textured_gltf(mesh: TexturedMesh, stem: str) -> Written:
    """Write a mesh as JSON text, with its numbers and its images in files beside it; else as `write_textured_glb`."""
    notices: list[str] = []
    tree, arrays = _textured(mesh, stem, notices)
    files = image_names(mesh, stem)
    named = zip(files, _names(mesh, stem), strict=True)
    tree["images"] = [{"uri": as_uri(file), "name": name} for file, name in named]
    images = {file: image.file.data for file, image in zip(files, mesh.images, strict=True)}
    return text_file(_without_empty(tree), arrays, stem, images, notices)


def _names(mesh: TexturedMesh, stem: str) -> list[str]:
    return [name.rpartition(".")[0] for name in image_names(mesh, stem)]


def _without_empty(tree: Tree) -> Tree:
    return {key: value for key, value in tree.items() if value != []}


def _textured(mesh: TexturedMesh, stem: str, notices: list[str]) -> tuple[Tree, Arrays]:
    mesh = _with_bare_materials(mesh)
    parts = _Parts(mesh, stem, notices)
    meshes = [
        {"primitives": parts.primitives(faces), "name": plain_name(name) or stem}
        for name, faces in _groups(mesh)
    ]
    textures = _Textures()
    materials = [_material(material, textures, stem) for material in mesh.materials]
    tree: Tree = {
        "asset": {"version": "2.0", "generator": "beltrami"},
        "scene": 0,
        "scenes": [{"nodes": list(range(len(meshes)))}],
        "nodes": [{"mesh": number, "name": each["name"]} for number, each in enumerate(meshes)],
        "meshes": meshes,
        "materials": materials,
        "textures": textures.textures,
        "samplers": textures.samplers,
        "accessors": parts.arrays.accessors,
        "bufferViews": parts.arrays.views,
    }
    notices += not_converted(mesh)
    return tree, parts.arrays


def _with_bare_materials(mesh: TexturedMesh) -> TexturedMesh:
    """Give triangles without texture coordinates copies of their materials that have no maps, as glTF demands."""
    bare = np.isnan(mesh.uv).any(axis=(1, 2))
    material_of = mesh.material_numbers
    materials, numbers = list(mesh.materials), material_of.copy()
    for index in np.unique(material_of[bare]).tolist():
        if materials[index].maps:
            numbers[bare & (material_of == index)] = len(materials)
            materials.append(dataclasses.replace(materials[index], maps={}))
    shown, numbers = shown_materials(materials, numbers)
    return dataclasses.replace(mesh, materials=shown, material_of=numbers)


def _groups(mesh: TexturedMesh) -> Iterator[tuple[str, Int64s]]:
    """Give the names of the groups that have triangles, and these."""
    for number, name in enumerate(mesh.groups):
        faces = np.flatnonzero(mesh.group_numbers == number)
        if len(faces):
            yield name, faces


class _Parts:
    """The primitives of a mesh, and the arrays behind them."""

    def __init__(self, mesh: TexturedMesh, stem: str, notices: list[str]) -> None:
        self.arrays = Arrays()
        self._mesh, self._notices = mesh, notices
        self._positions = single_precision(mesh.positions, stem, notices)
        self._colours = None if mesh.colours is None else stored_colours(mesh.colours, notices)

    def primitives(self, faces: Int64s) -> list[Tree]:
        """Return a primitive for each material of some triangles."""
        material_of = self._mesh.material_numbers[faces]
        return [
            self._primitive(faces[material_of == material], material)
            for material in np.unique(material_of).tolist()
        ]

    def _primitive(self, faces: Int64s, material: int) -> Tree:
        mesh, arrays = self._mesh, self.arrays
        corners = mesh.faces[faces].ravel()
        uv = mesh.uv[faces].reshape(-1, 2).astype("<f4")
        normals = None if mesh.normals is None else mesh.normals[faces].reshape(-1, 3)
        columns: list[Array] = [corners]
        if np.isfinite(uv).all():
            columns += [*uv.T]
        if normals is not None and np.isfinite(normals).all():
            columns += [*normals.T]
        first, vertex_of = distinct_corners(*columns)
        attributes = {"POSITION": arrays.add(self._positions[corners[first]], bounds=True)}
        if np.isfinite(uv).all():
            attributes["TEXCOORD_0"] = arrays.add(uv[first])
        if normals is not None and np.isfinite(normals).all():
            attributes["NORMAL"] = arrays.add(unit_normals(normals[first]))
        elif normals is not None and np.isfinite(normals).any():
            self._note("Not converted: normals of parts that have them at some corners only.")
        if self._colours is not None:
            attributes[self._colour_attribute(material)] = arrays.add(self._colours[corners[first]])
        indices = arrays.add_faces(vertex_of.reshape(-1, 3), len(first))
        return {"attributes": attributes, "indices": indices, "material": material}

    def _colour_attribute(self, material: int) -> str:
        if "baseColor" not in self._mesh.materials[material].maps:
            return "COLOR_0"
        self._note(_BESIDE)
        return OWN_COLOURS

    def _note(self, notice: str) -> None:
        if notice not in self._notices:
            self._notices.append(notice)


class _Textures:
    """Textures and samplers, each once."""

    def __init__(self) -> None:
        self.textures: list[Tree] = []
        self.samplers: list[Tree] = []

    def add(self, image: int, wrap: tuple[Wrap, Wrap]) -> int:
        sides = dict(zip(("wrapS", "wrapT"), (WRAPS[kind] for kind in wrap), strict=True))
        sampler = _index({"magFilter": _LINEAR, "minFilter": _MIPMAPS, **sides}, self.samplers)
        return _index({"sampler": sampler, "source": image}, self.textures)


def _index(entry: Tree, entries: list[Tree]) -> int:
    if entry not in entries:
        entries.append(entry)
    return entries.index(entry)


def _material(material: Material, textures: _Textures, stem: str) -> Tree:
    has_metal = "metallicRoughness" in material.maps
    base: Tree = {}
    tree: Tree = {
        "name": plain_name(material.name) or stem,
        "pbrMetallicRoughness": base,
        "doubleSided": True,
    }
    for slot, shown in material.maps.items():
        *parents, last = SLOT_PATHS[slot][0]
        holder = base if parents else tree
        holder[last] = {"index": textures.add(shown.image, shown.wrap)}
    factor = [*_linear(material.colour), material.opacity]
    if factor != [1.0] * 4:
        base["baseColorFactor"] = factor
    base["metallicFactor"] = 1 if has_metal else _plain(material.metalness)
    base["roughnessFactor"] = _plain(material.roughness)
    if any(material.emission):
        tree["emissiveFactor"] = _linear(material.emission)
    if material.alpha in _MODES:
        tree["alphaMode"] = _MODES[material.alpha]
    return tree


def _linear(colour: tuple[float, ...]) -> list[float]:
    values = srgb_to_linear(np.clip(np.array(colour, np.float64), 0, 1))
    return [round(float(value), 6) for value in values]


def _plain(value: float) -> float | int:
    clipped = min(max(value, 0.0), 1.0)
    return int(clipped) if clipped in (0, 1) else clipped
