"""The triangles of a glTF file with the texture coordinates of one slot, and the images of that slot."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field

import numpy as np

from beltrami_cli.arrays import Float64s, Int32s, Int64s
from beltrami_cli.formats.gltf import geometry
from beltrami_cli.formats.gltf.accessors import Accessors
from beltrami_cli.formats.gltf.json_tree import Entry
from beltrami_cli.formats.gltf.textures import Images, TextureUse, looks, texture_uses
from beltrami_cli.formats.model_folder import UnfitReferenceError
from beltrami_cli.formats.textured_mesh import SlotImages
from beltrami_cli.surface.records import Slot, TexturedSurface

_MOST_ROWS = np.iinfo(np.int32).max


def gather_textured(
    root: Entry, accessors: Accessors, places: Sequence[geometry.Placement], images: Images, slot: Slot
) -> tuple[TexturedSurface, list[str]]:
    """Gather all triangles of a file and the images that one slot shows on them, with notices for the user."""
    gathering = _Gathering(accessors, images, slot, texture_uses(root, slot))
    for mesh, placement in zip(root.entries("meshes"), places, strict=True):
        for primitive in mesh.entries("primitives"):
            gathering.take(primitive, placement)
    if not len(gathering.shown):
        raise gathering.shown.refusal(root.name, is_bare=gathering.counts["bare"] > 0)
    sentences = {
        "instanced": "{} textured part(s) are shown at several places; each is smoothed once, at its first place.",
        "bare": f"{{}} primitive(s) have no texture coordinates for their {slot} texture.",
    }
    counted = [sentence.format(n) for key, sentence in sentences.items() if (n := gathering.counts[key])]
    return gathering.surface(), gathering.shown.notices() + counted


def image_key(image: int) -> str:
    """Return the key of an image's texture, under which a new image is handed back."""
    return f"image {image}"


@dataclass
class _Part:
    """Triangles over one accessor of positions in one place and one look."""

    position: int
    placement: geometry.Placement
    look: int
    faces: list[Int64s] = field(default_factory=list)
    uv: list[Float64s] = field(default_factory=list)
    texture: list[Int32s] = field(default_factory=list)

    def add(self, faces: Int64s, uv: Float64s, texture: int) -> None:
        """Add triangles with the texture coordinates of their corners and the number of their texture."""
        self.faces.append(faces)
        self.uv.append(uv)
        self.texture.append(np.full(len(uv), texture, np.int32))


class _Gathering:
    """Parts while primitives are being taken one by one."""

    def __init__(
        self, accessors: Accessors, images: Images, slot: Slot, materials: Sequence[Sequence[TextureUse]]
    ) -> None:
        self.accessors, self.images, self.materials = accessors, images, materials
        self.shown = SlotImages(slot)
        self.parts: dict[Hashable, _Part] = {}
        self.counts = dict.fromkeys(("instanced", "bare"), 0)
        self._seen: set[Hashable] = set()
        self._decoded: dict[int, Float64s] = {}

    def take(self, primitive: Entry, placement: geometry.Placement) -> None:
        """Take one primitive: its triangles where they stand first, with all textures that they can have."""
        if geometry.drawing_mode(primitive) < geometry.TRIANGLES:
            return
        if "POSITION" not in primitive.entry("attributes"):
            return  # it draws nothing
        position = geometry.position_accessor(primitive, self.accessors)
        count = self.accessors[position].count
        faces = geometry.drawn(primitive, self.accessors, count, placement)
        if not len(faces):
            return
        for look, use in looks(primitive, self.materials):
            image = self._image(primitive, use)
            if look and image is None:
                continue
            place = self.accessors.identity(position), placement.matrix.tobytes(), placement.space, look
            repeated = self._repeated(primitive, position, use)
            self.counts["instanced"] += not look and image is not None and (placement.nodes > 1 or repeated)
            if repeated:
                continue
            part = self.parts.setdefault(place, _Part(position, placement, look))
            if use is None or image is None:
                part.add(faces, np.zeros((len(faces), 3, 2)), -1)
            else:
                uv = self._coordinates(primitive, use, count)[faces]
                wrap = self.images.wrap(use.texture)
                part.add(faces, uv, self.shown.show(image, use.material, wrap, alpha_hides=use.alpha_hides))

    def _repeated(self, primitive: Entry, position: int, use: TextureUse | None) -> bool:
        """Return whether the same triangles were taken with the same texture before, there or elsewhere."""
        key: list[Hashable] = [self.accessors.identity(position), geometry.drawing(primitive, self.accessors)]
        if use is not None:
            key += [use.texture, use.transform]
            if use.coordinates in primitive.entry("attributes"):
                coordinates = geometry.attribute_accessor(primitive, use.coordinates, self.accessors)
                key.append(self.accessors.identity(coordinates))
        repeated = tuple(key) in self._seen
        self._seen.add(tuple(key))
        return repeated

    def _image(self, primitive: Entry, use: TextureUse | None) -> str | None:
        """Return the key of the image that a texture shows on a primitive; None if it shows none."""
        if use is None:
            return None
        if use.coordinates not in primitive.entry("attributes"):
            self.counts["bare"] += 1
            return None
        place = self.images.textures[use.texture].place
        try:
            image = self.images.canonical(self.images.shown(use.texture))
            if image_key(image) not in self.shown:
                place = self.images.entries[image].place
                self.shown.take(image_key(image), self.images.name(image), self.images.data(image))
        except UnfitReferenceError as error:
            self.shown.miss(f"{place}: {error}", use.material)
            return None
        return image_key(image)

    def _coordinates(self, primitive: Entry, use: TextureUse, count: int) -> Float64s:
        """Return the texture coordinates of all vertices, shape (count, 2), transform applied."""
        index = geometry.fitting_accessor(primitive, use.coordinates, self.accessors, "VEC2", count)
        uv = use.placed(self._values(index))
        if not np.isfinite(uv).all():
            raise use.info.fault("extensions", "its transform moves texture coordinates to infinity")
        return uv

    def _values(self, index: int) -> Float64s:
        if index not in self._decoded:
            self._decoded[index] = self.accessors.values(index)
        return self._decoded[index]

    def surface(self) -> TexturedSurface:
        """Return what was gathered, without vertices that no triangle uses."""
        positions, faces, spaces, rows = [], [], [], 0
        # Triangles of different looks or spaces do not meet.
        looks_in_spaces = dict.fromkeys((part.placement.space, part.look) for part in self.parts.values())
        space_of = {key: number for number, key in enumerate(looks_in_spaces)}
        for part in self.parts.values():
            corners = np.concatenate(part.faces)
            used = np.zeros(self.accessors[part.position].count, bool)
            used[corners] = True
            faces.append((np.cumsum(used) - 1 + rows)[corners])
            rows += int(np.count_nonzero(used))
            if rows > _MOST_ROWS:
                raise self.accessors[part.position].entry.fault("", f"more than {_MOST_ROWS} vertices")
            values = self._values(part.position)[used]
            positions.append(geometry.in_world(values, part.placement, self.accessors, part.position))
            spaces.append(np.full(len(values), space_of[part.placement.space, part.look], np.int32))
        return TexturedSurface(
            positions=np.concatenate(positions),
            faces=np.concatenate(faces).astype(np.int32),
            uv=np.concatenate([uv for part in self.parts.values() for uv in part.uv]),
            texture_of=np.concatenate([number for part in self.parts.values() for number in part.texture]),
            textures=self.shown.textures(),
            space_of=np.concatenate(spaces) if len(space_of) > 1 else None,
        )
