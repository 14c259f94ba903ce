"""Triangles of glTF primitives with their materials, and the scene that they make."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain

import numpy as np

from beltrami_cli.arrays import Bools, Float64s, Int64s
from beltrami_cli.formats.gltf.accessors import MAX_ROWS, Accessor
from beltrami_cli.formats.gltf.images import Images, image_key
from beltrami_cli.formats.gltf.materials import TextureUse
from beltrami_cli.formats.gltf.nodes import Placement
from beltrami_cli.formats.gltf.primitives import TRIANGLES, Primitive
from beltrami_cli.formats.meshes.scene import Scene, ShownMap
from beltrami_cli.formats.sidecars.model_folder import UnfitReferenceError
from beltrami_cli.surface import records
from beltrami_cli.surface.records import Slot


@dataclass(frozen=True)
class ShownMaterial:
    """A material as it is shown: its textures, and the images of these."""

    number: int
    record: records.Material  # without its maps
    uses: Mapping[Slot, TextureUse]
    maps: Mapping[Slot, ShownMap]


@dataclass(frozen=True)
class Part:
    """Triangles of a primitive at one place."""

    primitive: Primitive
    placement: Placement
    position: Accessor
    faces: Int64s  # (F, 3), indices of positions
    material: ShownMaterial


class ShownMaterials:
    """The materials of parts, numbered as they are added."""

    def __init__(self, images: Images) -> None:
        self.images = images
        self.by_key: dict[Hashable, ShownMaterial] = {}

    def add(self, key: Hashable, uses: Mapping[Slot, TextureUse], record: records.Material) -> ShownMaterial:
        """Add a material unless it is known by its key."""
        if key not in self.by_key:
            maps = {slot: self._map(use) for slot, use in uses.items()}
            self.by_key[key] = ShownMaterial(len(self.by_key), record, uses, maps)
        return self.by_key[key]

    def _map(self, use: TextureUse) -> ShownMap:
        images, name = self.images, self.images.textures[use.texture].place
        try:
            image = images.canonical(images.shown(use.texture))
            name = images.name(image)
            images.data(image)
        except UnfitReferenceError as error:
            return ShownMap(name, None, error.obstacle)
        return ShownMap(name, image_key(image), wrap=images.wrap(use.texture), alpha_hides=use.alpha_hides)


def drawn_triangles(primitive: Primitive, placement: Placement) -> tuple[Accessor, Int64s] | None:
    """Return the positions and the triangles of a primitive; None if it draws none."""
    if primitive.mode < TRIANGLES or "POSITION" not in primitive:
        return None
    position = primitive.position()
    faces = placement.facing(primitive.triangles(position.count))
    return (position, faces) if len(faces) else None


def used_positions(parts: Sequence[Part]) -> Bools:
    """Return which of the positions that some parts share they use, shape (V,)."""
    used = np.zeros(parts[0].position.count, bool)
    for part in parts:
        used[part.faces] = True
    return used


def by_triangle(parts: Sequence[Part], values: Sequence[int]) -> Int64s:
    """Return the values of parts for their triangles, shape (F,)."""
    return np.repeat(np.array(values, np.int64), [len(part.faces) for part in parts])


def make_scene(name: str, groups: Collection[Sequence[Part]], materials: ShownMaterials) -> Scene:
    """Return the triangles of groups of parts that share vertices, without vertices that none uses."""
    positions, corners, rows = [], [], 0
    for group in groups:
        used, first = used_positions(group), group[0]
        row_of = np.cumsum(used) - 1 + rows
        corners += [row_of[part.faces].ravel() for part in group]
        rows += int(np.count_nonzero(used))
        if rows > MAX_ROWS:
            raise first.position.entry.fault("", f"more than {MAX_ROWS} vertices")
        positions.append(first.placement.positions(first.position, used))
    parts, images = [*chain(*groups)], materials.images
    material_of = by_triangle(parts, [part.material.number for part in parts])
    keys = {image_key(index): index for index in range(len(images))}
    return Scene(
        name=name,
        positions=np.concatenate(positions),
        corners=np.concatenate(corners).astype(np.int32),
        offsets=3 * np.arange(len(material_of) + 1),
        material_of=material_of,
        materials=[each.record for each in materials.by_key.values()],
        maps=[each.maps for each in materials.by_key.values()],
        uv=partial(_coordinates, parts, {}),
        read=lambda key: images.data(keys[key]),
        names={key: images.name(index) for key, index in keys.items()},
        is_v_up=False,
        has_factors=True,
    )


def _coordinates(parts: Sequence[Part], known: dict[Hashable, Float64s], slot: Slot | None) -> Float64s:
    """Return texture coordinates of all corners, shape (K, 2), as a slot places them (None: as they are stored).

    `known` collects those of accessors, which parts of one large mesh may share.
    """
    coordinates = []
    for part in parts:
        use = None if slot is None else part.material.uses.get(slot)
        name = "TEXCOORD_0" if use is None else use.coordinates
        uv = np.full((len(part.faces), 3, 2), np.nan)
        if name in part.primitive and (slot is None or use is not None):
            accessor = part.primitive.fitting(name, "VEC2", part.position.count)
            key = accessor, None if use is None else use.transform
            if key not in known:
                stored = accessor.values()
                known[key] = stored if use is None else use.placed(stored)
            uv = known[key][part.faces]
        coordinates.append(uv.reshape(-1, 2))
    return np.concatenate(coordinates)
