"""The triangles of a glTF file at every place where they are shown, with all materials, for another format."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s
from beltrami_cli.errors import InputError
from beltrami_cli.formats.gltf.accessors import fractions
from beltrami_cli.formats.gltf.entries import Entry
from beltrami_cli.formats.gltf.images import Images
from beltrami_cli.formats.gltf.materials import EMISSIVE_STRENGTH, SLOT_PATHS, read_material, texture_uses
from beltrami_cli.formats.gltf.nodes import Placement, instances
from beltrami_cli.formats.gltf.parts import (
    Part,
    ShownMaterial,
    ShownMaterials,
    by_triangle,
    drawn_triangles,
    make_scene,
    used_positions,
)
from beltrami_cli.formats.gltf.primitives import OWN_COLOURS, TRIANGLES, Meshes, Primitive
from beltrami_cli.formats.meshes.scene_mesh import textured_mesh
from beltrami_cli.surface import records

# Colours of the vertices of a primitive by mesh and number, shape (n, 3) or with opacity (n, 4), linear.
PrimitiveColours = Mapping[tuple[int, int], Float32s]

_KEPT_ATTRIBUTES = ("POSITION", "NORMAL", "COLOR_0", OWN_COLOURS)


def read_textured_mesh(
    root: Entry, meshes: Meshes, images: Images, colours: PrimitiveColours, stored: str
) -> records.MeshContents:
    """Return the triangles of the default scene, at every place where a node shows them, with their materials."""
    collected = _MeshParts(root, images)
    for index, placement, name in instances(root):
        for number, primitive in enumerate(meshes[index]):
            collected.take(primitive, placement, name, colours.get((index, number)))
    parts = collected.parts
    if not parts:
        raise InputError(root.name, "its scene has no triangles, so there is nothing to show a texture")
    groups = {name: number for number, name in enumerate(dict.fromkeys(collected.groups))}
    group_of = by_triangle(parts, [groups[name] for name in collected.groups])
    normals = np.concatenate([_normals(part) for part in parts]).reshape(-1, 3)
    scene = make_scene(root.name, [[part] for part in parts], collected.materials)
    mesh = textured_mesh(scene, collected.left_out, (tuple(groups), group_of), normals)
    return dataclasses.replace(mesh, **collected.vertex_colours(stored))


class _MeshParts:
    """Each primitive at every place, with its colours, and with the textures of all slots."""

    def __init__(self, root: Entry, images: Images) -> None:
        self.materials = ShownMaterials(images)
        self.parts: list[Part] = []
        self.groups: list[str] = []  # the object of each part, by name
        self.left_out: list[str] = []
        self._colours: list[Float32s | None] = []
        self._entries = root.entries("materials")
        self._by_slot = {slot: texture_uses(root, slot) for slot in SLOT_PATHS}

    def take(self, primitive: Primitive, placement: Placement, group: str, colours: Float32s | None) -> None:
        if primitive.mode < TRIANGLES and "POSITION" in primitive:
            self.left_out.append("points and lines")
        drawn = drawn_triangles(primitive, placement)
        if drawn is None:
            return
        material = self._material(primitive.entry)
        part = Part(primitive, placement, *drawn, material)
        self.parts.append(part)
        self.groups.append(group)
        self._colours.append(self._of_part(part, colours))
        coordinates = {use.coordinates for use in material.uses.values()} or {"TEXCOORD_0"}
        for name in primitive.attributes.value:
            if name.startswith("TEXCOORD_"):
                self.left_out += () if name in coordinates else ("further texture coordinates",)
            elif name not in _KEPT_ATTRIBUTES and not name.startswith(("JOINTS_", "WEIGHTS_")):
                self.left_out.append(f"attribute {name}")

    def _material(self, primitive: Entry) -> ShownMaterial:
        """Return the material of a primitive, and note what of it is lost."""
        if "material" not in primitive:
            return self.materials.add(None, {}, records.Material(metalness=1.0))
        index = primitive.integer("material", below=len(self._entries))
        if index in self.materials.by_key:
            return self.materials.by_key[index]
        uses = {slot: found[index][0] for slot, found in self._by_slot.items() if found[index]}
        extensions = self._entries[index].entry("extensions").value
        self.left_out += [name for name in extensions if name != EMISSIVE_STRENGTH]
        for slot, use in uses.items():
            factors = [key for key in ("scale", "strength") if use.info.number(key, default=1.0) != 1]
            self.left_out += [f"the {key} of {slot} maps" for key in factors]
            self.left_out += ["sharp texels"] if self.materials.images.has_sharp_texels(use.texture) else []
        return self.materials.add(index, uses, read_material(self._entries[index]))

    def _of_part(self, part: Part, colours: Float32s | None) -> Float32s | None:
        """Return the colours of the vertices of a part, shape (n, 3) or (n, 4)."""
        if colours is not None and "baseColor" in part.material.maps and (colours[:, :3] != 1).any():
            self.left_out.append("the tint of textures by their vertex colours")
        if colours is None and OWN_COLOURS in part.primitive:
            colours = fractions(part.primitive.accessor(OWN_COLOURS).finite("colour"))
        used = used_positions([part])
        is_fitting = colours is not None and colours.shape in ((len(used), 3), (len(used), 4))
        return colours[used] if colours is not None and is_fitting else None

    def vertex_colours(self, stored: str) -> dict[str, Any]:
        """Return the colours of all vertices; white for parts without colours, as glTF has it."""
        if all(colours is None for colours in self._colours):
            return {}
        rows_of_parts = []
        for part, colours in zip(self.parts, self._colours, strict=True):
            rows = np.ones((np.count_nonzero(used_positions([part])), 4), np.float32)
            if colours is not None:
                rows[:, : colours.shape[1]] = colours
            rows_of_parts.append(rows)
        joined = np.concatenate(rows_of_parts)
        alpha = joined[:, 3] if (joined[:, 3] < 1).any() else None
        return {"colours": joined[:, :3], "encoding": "linear", "stored": stored, "alpha": alpha}


def _normals(part: Part) -> Float64s:
    """Return the normals of the corners of a part, shape (F, 3, 3); NaN if there are none."""
    if "NORMAL" not in part.primitive:
        return np.full((len(part.faces), 3, 3), np.nan)
    normals = part.primitive.fitting("NORMAL", "VEC3", part.position.count)
    return part.placement.normals(normals)[part.faces]
