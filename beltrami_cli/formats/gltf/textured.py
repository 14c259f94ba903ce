"""The triangles of a glTF file with texture coordinates: under the images of one slot, and with all materials."""

from __future__ import annotations

import dataclasses
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s, Int64s
from beltrami_cli.errors import InputError
from beltrami_cli.formats.gltf.accessors import Accessor, fractions
from beltrami_cli.formats.gltf.entries import Entry
from beltrami_cli.formats.gltf.images import Images, image_key
from beltrami_cli.formats.gltf.materials import SLOT_PATHS, TextureUse, looks, read_material, texture_uses
from beltrami_cli.formats.gltf.nodes import Placement, instances
from beltrami_cli.formats.gltf.primitives import TRIANGLES, Meshes, Primitive
from beltrami_cli.formats.gltf.writer import OWN_COLOURS
from beltrami_cli.formats.model_folder import UnfitReferenceError
from beltrami_cli.formats.scene import Scene, ShownMap, no_texture
from beltrami_cli.surface import records
from beltrami_cli.surface.records import Slot

_MAX_ROWS = np.iinfo(np.int32).max
# Colours of the vertices of a primitive by mesh and number, shape (n, 3) or with opacity (n, 4), linear.
PrimitiveColours = Mapping[tuple[int, int], Float32s]

_KEPT_ATTRIBUTES = ("POSITION", "NORMAL", "COLOR_0", OWN_COLOURS)


@dataclass(frozen=True)
class _Material:
    """A material as it is shown: its textures, and the images of these."""

    number: int
    record: records.Material  # without its maps
    uses: Mapping[Slot, TextureUse]
    maps: Mapping[Slot, ShownMap]


@dataclass(frozen=True)
class _Part:
    """Triangles of a primitive at one place."""

    primitive: Primitive
    placement: Placement
    position: Accessor
    faces: Int64s  # (F, 3), indices of positions
    material: _Material
    look: int = 0
    group: str = ""  # name of the object


class _Parts:
    """Triangles of primitives, while these are taken one by one, and the scene that they make."""

    def __init__(self, name: str, images: Images) -> None:
        self._name, self._images = name, images
        self.groups: dict[Hashable, list[_Part]] = {}  # by what shares vertices
        self.materials: dict[Hashable, _Material] = {}
        self._coordinates: dict[Hashable, Float64s] = {}

    def __iter__(self) -> Iterator[_Part]:
        return chain(*self.groups.values())

    def add_material(
        self, key: Hashable, uses: Mapping[Slot, TextureUse], record: records.Material
    ) -> _Material:
        """Add a material unless it is known by its key."""
        if key not in self.materials:
            maps = {slot: self._map(use) for slot, use in uses.items()}
            self.materials[key] = _Material(len(self.materials), record, uses, maps)
        return self.materials[key]

    def _map(self, use: TextureUse) -> ShownMap:
        name = self._images.textures[use.texture].place
        try:
            image = self._images.canonical(self._images.shown(use.texture))
            name = self._images.name(image)
            self._images.data(image)
        except UnfitReferenceError as error:
            return ShownMap(name, None, error.obstacle)
        wrap = self._images.wrap(use.texture)
        return ShownMap(name, image_key(image), wrap=wrap, alpha_hides=use.alpha_hides)

    def drawn(self, primitive: Primitive, placement: Placement) -> tuple[Accessor, Int64s] | None:
        """Return the positions and the triangles of a primitive; None if it draws none."""
        if primitive.mode < TRIANGLES or "POSITION" not in primitive:
            return None
        position = primitive.position()
        faces = placement.facing(primitive.triangles(position.count))
        return (position, faces) if len(faces) else None

    def rows_of(self, parts: Sequence[_Part]) -> Bools:
        """Return which positions the parts of one group use."""
        used = np.zeros(parts[0].position.count, bool)
        for part in parts:
            used[part.faces] = True
        return used

    def of_triangles(self, values: Sequence[int]) -> Int64s:
        """Return the values of all parts for their triangles, shape (F,)."""
        return np.repeat(np.array(values, np.int64), [len(part.faces) for part in self])

    def scene(self) -> Scene:
        """Return the triangles, without vertices that none uses."""
        positions, corners, rows = [], [], 0
        for parts in self.groups.values():
            used, first = self.rows_of(parts), parts[0]
            row_of = np.cumsum(used) - 1 + rows
            corners += [row_of[part.faces].ravel() for part in parts]
            rows += int(np.count_nonzero(used))
            if rows > _MAX_ROWS:
                raise first.position.entry.fault("", f"more than {_MAX_ROWS} vertices")
            positions.append(first.placement.positions(first.position, used))
        material_of = self.of_triangles([part.material.number for part in self])
        keys = {image_key(index): index for index in range(len(self._images))}
        return Scene(
            name=self._name,
            positions=np.concatenate(positions),
            corners=np.concatenate(corners).astype(np.int32),
            offsets=3 * np.arange(len(material_of) + 1),
            material_of=material_of,
            materials=[each.record for each in self.materials.values()],
            maps=[each.maps for each in self.materials.values()],
            uv=self._uv,
            tiles={},
            read=lambda key: self._images.data(keys[key]),
            names={key: self._images.name(index) for key, index in keys.items()},
            is_v_up=False,
            has_factors=True,
        )

    def _uv(self, slot: Slot | None) -> Float64s:
        """Return texture coordinates of all corners, shape (K, 2), as a slot places them (None: as they are stored)."""
        found = []
        for part in self:
            use = None if slot is None else part.material.uses.get(slot)
            name = "TEXCOORD_0" if use is None else use.coordinates
            uv = np.full((len(part.faces), 3, 2), np.nan)
            if name in part.primitive and (slot is None or use is not None):
                accessor = part.primitive.fitting(name, "VEC2", part.position.count)
                key = accessor, None if use is None else use.transform
                if key not in self._coordinates:  # parts of one large mesh may share them
                    stored = accessor.values()
                    self._coordinates[key] = stored if use is None else use.placed(stored)
                uv = self._coordinates[key][part.faces]
            found.append(uv.reshape(-1, 2))
        return np.concatenate(found)


def gather_textured(
    root: Entry, meshes: Meshes, places: Sequence[Placement], images: Images, slot: Slot
) -> tuple[records.TexturedSurface, list[str]]:
    """Gather all triangles of a file and the images that one slot shows on them, with notices for the user."""
    parts = _SurfaceParts(root, images, slot)
    for mesh, placement in zip(meshes, places, strict=True):
        for primitive in mesh:
            parts.take(primitive, placement)
    if not any(part.material.maps for part in parts):
        raise no_texture(slot, root.name, (), is_bare=parts.counts["bare"] > 0)
    surface, notices = parts.scene().surface(slot)
    # Triangles of different looks or spaces do not meet.
    spaces = [(members[0].placement.space, members[0].look) for members in parts.groups.values()]
    number_of = {space: number for number, space in enumerate(dict.fromkeys(spaces))}
    if len(number_of) > 1:
        rows = [np.count_nonzero(parts.rows_of(members)) for members in parts.groups.values()]
        numbers = np.array([number_of[space] for space in spaces], np.int32)
        surface = dataclasses.replace(surface, space_of=np.repeat(numbers, rows))
    sentences = {
        "instanced": "{} textured part(s) are shown at several places; each is smoothed once, at its first place.",
        "bare": f"{{}} primitive(s) have no texture coordinates for their {slot} texture.",
    }
    counted = [sentence.format(n) for key, sentence in sentences.items() if (n := parts.counts[key])]
    return surface, [*notices, *parts.missing, *counted]


class _SurfaceParts(_Parts):
    """Each primitive where it stands first, with all textures that it can have in one slot."""

    def __init__(self, root: Entry, images: Images, slot: Slot) -> None:
        super().__init__(root.name, images)
        self._slot, self._uses = slot, texture_uses(root, slot)
        self.counts = dict.fromkeys(("instanced", "bare"), 0)
        self.missing: dict[str, None] = {}  # notices
        self._seen: set[Hashable] = set()

    def take(self, primitive: Primitive, placement: Placement) -> None:
        found = self.drawn(primitive, placement)
        if found is None:
            return
        place = found[0].identity
        for look, use in looks(primitive.entry, self._uses):
            key: tuple[Hashable, ...] = place, primitive.drawing_key()
            if use is not None and use.coordinates not in primitive:
                self.counts["bare"] += 1
                use = None
            if use is not None:
                key += use.texture, use.transform, primitive.accessor(use.coordinates).identity
            material = self._material(use)
            shown = material.maps.get(self._slot)
            is_shown = shown is not None and shown.path is not None
            if look and not is_shown:
                if shown is not None:
                    left = f"The {self._slot} texture of {material.record.name!r} is left as it is"
                    self.missing[f"{left}: '{shown.name}' {shown.obstacle.cause}."] = None
                continue
            self.counts["instanced"] += not look and is_shown and (placement.nodes > 1 or key in self._seen)
            if key not in self._seen:
                self._seen.add(key)
                group = place, placement.matrix.tobytes(), placement.space, look
                part = _Part(primitive, placement, *found, material, look)
                self.groups.setdefault(group, []).append(part)

    def _material(self, use: TextureUse | None) -> _Material:
        if use is None:
            return self.add_material(None, {}, records.Material())
        return self.add_material(use.info.place, {self._slot: use}, records.Material(use.material))


def read_textured_mesh(
    root: Entry, meshes: Meshes, images: Images, colours: PrimitiveColours, stored: str
) -> records.MeshContents:
    """Return the triangles of the default scene, at every place where a node shows them, with their materials."""
    parts = _MeshParts(root, images)
    for index, placement, name in instances(root):
        for number, primitive in enumerate(meshes[index]):
            parts.take(primitive, placement, name, colours.get((index, number)))
    if not parts.groups:
        raise InputError(root.name, "its scene has no triangles, so there is nothing to show a texture")
    groups = {name: number for number, name in enumerate(dict.fromkeys(part.group for part in parts))}
    group_of = parts.of_triangles([groups[part.group] for part in parts])
    normals = np.concatenate([parts.normals(part) for part in parts])
    mesh = parts.scene().mesh(parts.left_out, (tuple(groups), group_of), normals.reshape(-1, 3))
    return dataclasses.replace(mesh, **parts.vertex_colours(stored))


class _MeshParts(_Parts):
    """Each primitive at every place, with its colours, and with the textures of all slots."""

    def __init__(self, root: Entry, images: Images) -> None:
        super().__init__(root.name, images)
        self.left_out: list[str] = []
        self._colours: list[Float32s | None] = []
        self._entries = root.entries("materials")
        self._by_slot = {slot: texture_uses(root, slot) for slot in SLOT_PATHS}

    def take(self, primitive: Primitive, placement: Placement, group: str, colours: Float32s | None) -> None:
        if primitive.mode < TRIANGLES and "POSITION" in primitive:
            self.left_out.append("points and lines")
        found = self.drawn(primitive, placement)
        if found is None:
            return
        material = self._material(primitive.entry)
        part = _Part(primitive, placement, *found, material, group=group)
        self.groups[len(self.groups)] = [part]
        self._colours.append(self._of_part(part, colours))
        coordinates = {use.coordinates for use in material.uses.values()} or {"TEXCOORD_0"}
        for name in primitive.attributes.value:
            if name.startswith("TEXCOORD_"):
                self.left_out += () if name in coordinates else ("further texture coordinates",)
            elif name not in _KEPT_ATTRIBUTES and not name.startswith(("JOINTS_", "WEIGHTS_")):
                self.left_out.append(f"attribute {name}")

    def _material(self, primitive: Entry) -> _Material:
        """Return the material of a primitive, and note what of it is lost."""
        if "material" not in primitive:
            return self.add_material(None, {}, records.Material(metalness=1.0))
        index = primitive.integer("material", below=len(self._entries))
        if index in self.materials:
            return self.materials[index]
        uses = {slot: found[index][0] for slot, found in self._by_slot.items() if found[index]}
        self.left_out += self._entries[index].entry("extensions").value
        for slot, use in uses.items():
            factors = [key for key in ("scale", "strength") if use.info.number(key, default=1.0) != 1]
            self.left_out += [f"the {key} of {slot} maps" for key in factors]
            self.left_out += ["sharp texels"] if self._images.has_sharp_texels(use.texture) else []
        return self.add_material(index, uses, read_material(self._entries[index]))

    def _of_part(self, part: _Part, colours: Float32s | None) -> Float32s | None:
        """Return the colours of the vertices of a part, shape (n, 3) or (n, 4)."""
        if colours is not None and "baseColor" in part.material.maps and (colours[:, :3] != 1).any():
            self.left_out.append("the tint of textures by their vertex colours")
        if colours is None and OWN_COLOURS in part.primitive:
            colours = fractions(part.primitive.accessor(OWN_COLOURS).finite("colour"))
        used = self.rows_of([part])
        is_fitting = colours is not None and colours.shape in ((len(used), 3), (len(used), 4))
        return colours[used] if colours is not None and is_fitting else None

    def normals(self, part: _Part) -> Float64s:
        """Return the normals of the corners of a part, shape (F, 3, 3); NaN if there are none."""
        if "NORMAL" not in part.primitive:
            return np.full((len(part.faces), 3, 3), np.nan)
        normals = part.primitive.fitting("NORMAL", "VEC3", part.position.count)
        return part.placement.normals(normals)[part.faces]

    def vertex_colours(self, stored: str) -> dict[str, Any]:
        """Return the colours of all vertices; white for parts without colours, as glTF has it."""
        if all(colours is None for colours in self._colours):
            return {}
        found = []
        for parts, colours in zip(self.groups.values(), self._colours, strict=True):
            rows = np.ones((np.count_nonzero(self.rows_of(parts)), 4), np.float32)
            if colours is not None:
                rows[:, : colours.shape[1]] = colours
            found.append(rows)
        joined = np.concatenate(found)
        alpha = joined[:, 3] if (joined[:, 3] < 1).any() else None
        return {"colours": joined[:, :3], "encoding": "linear", "stored": stored, "alpha": alpha}
