"""Triangles of glTF primitives with their materials, and the scene that they make."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from beltrami_cli.arrays import Bools, Float64s, Int64s
from beltrami_cli.formats.gltf.accessors import MAX_ROWS, Accessor
from beltrami_cli.formats.gltf.images import Images, image_key
from beltrami_cli.formats.gltf.materials import TextureUse
from beltrami_cli.formats.gltf.nodes import Placement
from beltrami_cli.formats.gltf.primitives import TRIANGLES, Primitive
from beltrami_cli.formats.model_folder import UnfitReferenceError
from beltrami_cli.formats.scene import Scene, ShownMap
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
    look: int = 0
    group: str = ""  # name of the object


class Parts:
    """Triangles of primitives, while these are taken one by one, and the scene that they make."""

    def __init__(self, name: str, images: Images) -> None:
        self._name, self._images = name, images
        self.groups: dict[Hashable, list[Part]] = {}  # by what shares vertices
        self.materials: dict[Hashable, ShownMaterial] = {}
        self._coordinates: dict[Hashable, Float64s] = {}

    def __iter__(self) -> Iterator[Part]:
        return chain(*self.groups.values())

    def add_material(
        self, key: Hashable, uses: Mapping[Slot, TextureUse], record: records.Material
    ) -> ShownMaterial:
        """Add a material unless it is known by its key."""
        if key not in self.materials:
            maps = {slot: self._map(use) for slot, use in uses.items()}
            self.materials[key] = ShownMaterial(len(self.materials), record, uses, maps)
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

    def rows_of(self, parts: Sequence[Part]) -> Bools:
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
            if rows > MAX_ROWS:
                raise first.position.entry.fault("", f"more than {MAX_ROWS} vertices")
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
        coordinates = []
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
            coordinates.append(uv.reshape(-1, 2))
        return np.concatenate(coordinates)
