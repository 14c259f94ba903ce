"""The triangles of a glTF file under the images of one slot, each where it stands first."""

from __future__ import annotations

import dataclasses
from collections.abc import Hashable, Sequence

import numpy as np

from beltrami_cli.formats.gltf.entries import Entry
from beltrami_cli.formats.gltf.images import Images
from beltrami_cli.formats.gltf.materials import TextureUse, looks, texture_uses
from beltrami_cli.formats.gltf.nodes import Placement
from beltrami_cli.formats.gltf.parts import (
    Part,
    ShownMaterial,
    ShownMaterials,
    drawn_triangles,
    make_scene,
    used_positions,
)
from beltrami_cli.formats.gltf.primitives import Meshes, Primitive
from beltrami_cli.formats.meshes.scene_surface import no_texture, textured_surface
from beltrami_cli.surface import records
from beltrami_cli.surface.records import Slot


def read_textured_surface(
    root: Entry, meshes: Meshes, places: Sequence[Placement], images: Images, slot: Slot
) -> records.TexturedSurface:
    """Return all triangles of a file and the images that one slot shows on them."""
    collected = _SurfaceParts(root, images, slot)
    for mesh, placement in zip(meshes, places, strict=True):
        for primitive in mesh:
            collected.take(primitive, placement)
    groups = collected.groups.values()
    if not any(part.material.maps for group in groups for part in group):
        raise no_texture(slot, root.name, (), is_bare=collected.counts["bare"] > 0)
    surface = textured_surface(make_scene(root.name, groups, collected.materials), slot)
    # Triangles of different spaces or looks do not meet.
    spaces = [(space, look) for _, _, space, look in collected.groups]
    number_of = {space: number for number, space in enumerate(dict.fromkeys(spaces))}
    if len(number_of) > 1:
        rows = [np.count_nonzero(used_positions(group)) for group in groups]
        numbers = np.array([number_of[space] for space in spaces], np.int32)
        surface = dataclasses.replace(surface, space_of=np.repeat(numbers, rows))
    sentences = {
        "instanced": "{} textured part(s) are shown at several places; each is smoothed once, at its first place.",
        "bare": f"{{}} primitive(s) have no texture coordinates for their {slot} texture.",
    }
    counted = [sentence.format(n) for key, sentence in sentences.items() if (n := collected.counts[key])]
    return dataclasses.replace(surface, notices=(*surface.notices, *collected.missing, *counted))


class _SurfaceParts:
    """Each primitive where it stands first, with all textures that it can have in one slot."""

    def __init__(self, root: Entry, images: Images, slot: Slot) -> None:
        self.materials = ShownMaterials(images)
        # By accessor of positions, matrix, space and look: parts that share vertices.
        self.groups: dict[tuple[Hashable, bytes, int, int], list[Part]] = {}
        self._slot, self._uses = slot, texture_uses(root, slot)
        self.counts = dict.fromkeys(("instanced", "bare"), 0)
        self.missing: dict[str, None] = {}  # notices
        self._seen: set[Hashable] = set()

    def take(self, primitive: Primitive, placement: Placement) -> None:
        drawn = drawn_triangles(primitive, placement)
        if drawn is None:
            return
        place = drawn[0].identity
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
                part = Part(primitive, placement, *drawn, material)
                self.groups.setdefault(group, []).append(part)

    def _material(self, use: TextureUse | None) -> ShownMaterial:
        if use is None:
            return self.materials.add(None, {}, records.Material())
        return self.materials.add(use.info.place, {self._slot: use}, records.Material(use.material))
