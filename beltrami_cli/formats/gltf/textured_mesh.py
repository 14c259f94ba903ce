"""A whole glTF file with its materials, for writing it in another format."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import get_args

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s, Int64s
from beltrami_cli.errors import InputError
from beltrami_cli.formats.colours import display_colour
from beltrami_cli.formats.gltf import geometry
from beltrami_cli.formats.gltf.accessors import Accessors, fractions
from beltrami_cli.formats.gltf.json_tree import Entry
from beltrami_cli.formats.gltf.textured_surface import image_key
from beltrami_cli.formats.gltf.textures import Images, TextureUse, texture_uses
from beltrami_cli.formats.gltf.writer import OWN_COLOURS
from beltrami_cli.formats.model_folder import UnfitReferenceError
from beltrami_cli.formats.textured_mesh import MeshImages, shown_materials, usable_coordinates
from beltrami_cli.surface.records import AlphaMode, Material, MaterialMap, Slot, TexturedMesh, VertexColours

# Colours of the vertices of a primitive by mesh and number, shape (n, 3) or with opacity (n, 4), linear.
PrimitiveColours = Mapping[tuple[int, int], Float32s]

_MOST_ROWS = np.iinfo(np.int32).max
_ALPHA: dict[str, AlphaMode] = {"MASK": "mask", "BLEND": "blend"}
_KNOWN = ("POSITION", "NORMAL", "COLOR_0", OWN_COLOURS)


def read_textured_mesh(
    root: Entry, accessors: Accessors, images: Images, colours: PrimitiveColours, stored: str, source: str
) -> TexturedMesh:
    """Return the triangles of the default scene, at every place where a node shows them, with their materials."""
    reading = _Reading(accessors, _Materials(root, images), colours)
    for mesh, placement, name in geometry.instances(root):
        for number, primitive in enumerate(root.entries("meshes")[mesh].entries("primitives")):
            reading.take(primitive, placement, name, (mesh, number))
    if not reading.parts:
        raise InputError(root.name, "its scene has no triangles, so there is nothing to show a texture")
    return reading.mesh(stored, source)


@dataclass
class _Materials:
    """The materials of a file, and the images that they show."""

    root: Entry
    images: Images
    left_out: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.shown = MeshImages()
        slots: tuple[Slot, ...] = get_args(Slot)
        uses = {slot: texture_uses(self.root, slot) for slot in slots}
        entries = self.root.entries("materials")
        self.placed: list[TextureUse | None] = []
        self.materials = [
            self._material(entry, {slot: uses[slot][index][0] for slot in slots if uses[slot][index]})
            for index, entry in enumerate(entries)
        ]
        self.materials.append(Material(metalness=1.0))
        self.placed.append(None)

    def _material(self, entry: Entry, uses: Mapping[Slot, TextureUse]) -> Material:
        maps: dict[Slot, MaterialMap] = {}
        first: TextureUse | None = None
        for slot, use in uses.items():
            if first is not None and (use.coordinates, use.transform) != (first.coordinates, first.transform):
                self.left_out.append(f"{slot} maps with texture coordinates of their own")
                continue
            try:
                image = self.images.canonical(self.images.shown(use.texture))
                name, read = self.images.name(image), partial(self.images.data, image)
                number = self.shown.take(image_key(image), name, read)
                maps[slot] = MaterialMap(number, self.images.wrap(use.texture))
                first = first or use
            except UnfitReferenceError as error:
                self.left_out.append(f"a {slot} image, which {error}")
        self.placed.append(first)
        base = entry.entry("pbrMetallicRoughness")
        factor = base.numbers("baseColorFactor", 4) or [1.0] * 4
        self.left_out += entry.entry("extensions").value
        return Material(
            name=entry.text("name") or "",
            maps=maps,
            colour=display_colour(factor[:3]),
            emission=display_colour(entry.numbers("emissiveFactor", 3) or [0.0] * 3),
            opacity=min(max(factor[3], 0.0), 1.0),
            metalness=base.number("metallicFactor", default=1.0),
            roughness=base.number("roughnessFactor", default=1.0),
            alpha=_ALPHA.get(entry.text("alphaMode") or "", "opaque"),
        )


@dataclass(frozen=True)
class _Part:
    """The triangles of a primitive at one place; arrays have a row for each vertex, or for each corner."""

    positions: Float64s
    faces: Int64s
    uv: Float64s
    normals: Float64s
    colours: Float32s | None
    material: int
    group: str


class _Reading:
    """Parts while primitives are being taken one by one."""

    def __init__(self, accessors: Accessors, materials: _Materials, colours: PrimitiveColours) -> None:
        self._accessors, self._materials, self._colours = accessors, materials, colours
        self.parts: list[_Part] = []
        self._rows = 0
        self._left_out: list[str] = []

    def take(
        self, primitive: Entry, placement: geometry.Placement, group: str, number: tuple[int, int]
    ) -> None:
        """Take the triangles of a primitive."""
        attributes = primitive.entry("attributes")
        if geometry.drawing_mode(primitive) < geometry.TRIANGLES or "POSITION" not in attributes:
            self._left_out += ["points and lines"] if "POSITION" in attributes else []
            return
        index = geometry.position_accessor(primitive, self._accessors)
        count = self._accessors[index].count
        faces = geometry.drawn(primitive, self._accessors, count, placement)
        if not len(faces):
            return
        self._rows += count
        if self._rows > _MOST_ROWS:
            raise self._accessors[index].entry.fault("", f"more than {_MOST_ROWS} vertices")
        last = len(self._materials.materials) - 1
        material = primitive.integer("material", below=last) if "material" in primitive else last
        use = self._materials.placed[material]
        self._note_others(attributes, use)
        positions = geometry.in_world(self._accessors.values(index), placement, self._accessors, index)
        uv = self._coordinates(primitive, use, count)
        given = self._values(primitive, "NORMAL", "VEC3", count)
        normals = np.full((count, 3), np.nan) if given is None else geometry.turned(given, placement.matrix)
        colours = self._own_colours(primitive, number, count)
        self.parts.append(_Part(positions, faces, uv[faces], normals[faces], colours, material, group))

    def _note_others(self, attributes: Entry, use: TextureUse | None) -> None:
        coordinates = "TEXCOORD_0" if use is None else use.coordinates
        for name in attributes.value:
            if name.startswith("TEXCOORD_") and name != coordinates:
                self._left_out.append("further texture coordinates")
            elif name not in _KNOWN and name != coordinates and not name.startswith(("JOINTS_", "WEIGHTS_")):
                self._left_out.append(f"attribute {name}")

    def _values(self, primitive: Entry, name: str, shape: str, count: int) -> Float64s | None:
        """Return an attribute of the vertices, None if there is none."""
        if name not in primitive.entry("attributes"):
            return None
        index = geometry.fitting_accessor(primitive, name, self._accessors, shape, count)
        return self._accessors.values(index)

    def _coordinates(self, primitive: Entry, use: TextureUse | None, count: int) -> Float64s:
        uv = self._values(primitive, "TEXCOORD_0" if use is None else use.coordinates, "VEC2", count)
        if uv is None:
            return np.full((count, 2), np.nan)
        return usable_coordinates(uv if use is None else use.placed(uv))

    def _own_colours(self, primitive: Entry, number: tuple[int, int], count: int) -> Float32s | None:
        if number in self._colours:
            material = primitive.value.get("material", len(self._materials.materials) - 1)
            is_white = (self._colours[number][:, :3] == 1).all()
            if "baseColor" in self._materials.materials[material].maps and not is_white:
                self._left_out.append("the tint of textures by their vertex colours")
            return self._colours[number]
        if OWN_COLOURS not in primitive.entry("attributes"):
            return None
        index = geometry.attribute_accessor(primitive, OWN_COLOURS, self._accessors)
        colours = fractions(self._accessors.finite(index, "colour"))
        return colours if colours.shape in ((count, 3), (count, 4)) else None

    def mesh(self, stored: str, source: str) -> TexturedMesh:
        starts = np.cumsum([0, *(len(part.positions) for part in self.parts)])[:-1]
        placed = zip(self.parts, starts.tolist(), strict=True)
        uv = np.concatenate([part.uv for part in self.parts])
        normals = np.concatenate([part.normals for part in self.parts]).astype(np.float32)
        counts = [len(part.faces) for part in self.parts]
        groups = tuple(dict.fromkeys(part.group for part in self.parts))
        group_of = np.repeat([groups.index(part.group) for part in self.parts], counts)
        numbers = np.repeat([part.material for part in self.parts], counts)
        materials, material_of = shown_materials(self._materials.materials, numbers)
        return TexturedMesh(
            positions=np.concatenate([part.positions for part in self.parts]),
            faces=np.concatenate([part.faces + start for part, start in placed]).astype(np.int32),
            uv=uv,
            materials=materials,
            images=tuple(self._materials.shown.images),
            source=source,
            material_of=material_of,
            groups=groups,
            group_of=group_of.astype(np.int32),
            normals=None if np.isnan(normals).all() else normals,
            colours=self._vertex_colours(stored),
            left_out=(*self._materials.left_out, *self._left_out),
        )

    def _vertex_colours(self, stored: str) -> VertexColours | None:
        """Return the colours of all vertices; those of parts without any are white, as glTF has it."""
        if all(part.colours is None for part in self.parts):
            return None
        rows = np.ones((self._rows, 4), np.float32)
        row = 0
        for part in self.parts:
            count = len(part.positions)
            if part.colours is not None:
                rows[row : row + count, : part.colours.shape[1]] = part.colours
            row += count
        alpha = rows[:, 3] if (rows[:, 3] < 1).any() else None
        return VertexColours(rows[:, :3], "linear", stored, alpha)
