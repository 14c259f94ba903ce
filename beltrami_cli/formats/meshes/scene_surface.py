"""The textured surface of a scene: its triangles, with the images that materials show in one slot."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from functools import partial

import numpy as np

from beltrami_cli.errors import InputError, NoColoursError, Obstacle
from beltrami_cli.formats.meshes.scene import Scene, ShownMap
from beltrami_cli.surface import tiling
from beltrami_cli.surface.polygons import triangulate_corners
from beltrami_cli.surface.records import Slot, Texture, TexturedSurface, Wrap
from beltrami_cli.surface.tiling import Tile

# Bytes from which on an image is read each time it is needed, since all images of a model may not fit into memory.
_LARGE = 1 << 20
_BARE_NOTICE = "{} triangles of textured materials have no texture coordinates."


def no_texture(
    slot: Slot, name: str, missing: Iterable[Obstacle], *, is_bare: bool, why: Obstacle | None = None
) -> InputError:
    """Return the error for a slot without a usable texture: missing images, no coordinates, or another reason."""
    for cause, remedy in missing:
        return NoColoursError(name, f"its {slot} texture cannot be read: {cause}", remedy)
    if is_bare:
        cause = f"it has a {slot} texture, but no texture coordinates for it"
        return InputError(name, cause, "export it with them")
    cause = f"it has no {slot} texture"
    if why is None:
        return NoColoursError(name, cause)
    return NoColoursError(name, f"{cause}, because {why.cause}", why.remedy)


def textured_surface(scene: Scene, slot: Slot, why: Obstacle | None = None) -> TexturedSurface:
    """Return all triangles with the images of one slot; InputError if it shows none, see `no_texture`."""
    cut, polygon = triangulate_corners(scene.positions, scene.corners, scene.offsets)
    is_whole = scene.is_whole[polygon]
    if not is_whole.all():
        cut, polygon = cut[is_whole], polygon[is_whole]
    shown, material_of, uv = _SlotImages(scene, slot), scene.material_of[polygon], scene.uv_down(slot)[cut]
    texture_of, set_of = shown.texture_of[material_of], shown.set_of[material_of]
    is_textured, bare = (texture_of >= 0) | (set_of >= 0), ~np.isfinite(uv).all(axis=(1, 2))
    lost = int(np.count_nonzero(bare & is_textured))
    if not (is_textured & ~bare).any():
        is_bare = len(shown.textures) > 0
        raise no_texture(slot, scene.name, shown.missing, is_bare=is_bare, why=why)
    texture_of[bare] = set_of[bare] = -1
    uv[bare | ~is_textured] = 0
    surface = TexturedSurface(
        positions=scene.positions,
        faces=scene.corners[cut],
        uv=uv,
        texture_of=texture_of,
        textures=tuple(shown.textures.values()),
        notices=(*scene.notices, *shown.notices(), *([_BARE_NOTICE.format(lost)] if lost else [])),
    )
    return tiling.on_tiles(surface, set_of, shown.sets, scene.name) if shown.sets else surface


class _SlotImages:
    """The images and tile sets that the materials of a scene show in a slot."""

    def __init__(self, scene: Scene, slot: Slot) -> None:
        self._scene, self._slot = scene, slot
        self.texture_of = np.full(len(scene.maps), -1, np.int32)  # image of each material, -1: none
        self.set_of = self.texture_of.copy()  # tile set of each material, -1: none
        self.textures: dict[str, Texture] = {}  # by their keys
        self.sets: list[dict[Tile, int]] = []  # numbers of textures
        self.missing: dict[Obstacle, list[str]] = {}  # materials whose image cannot be read
        self._mixed: dict[str, None] = {}  # names of images with several wrap modes
        for number in np.unique(scene.material_of).tolist():
            if (shown := scene.maps[number].get(slot)) is not None:
                self._add(number, shown)

    def _add(self, number: int, shown: ShownMap) -> None:
        material, why, tiles = self._scene.materials[number].name, shown.obstacle, shown.tiles
        numbers: dict[str, int] = {}
        for file in [*tiles.values()] or ([] if shown.path is None else [shown.path]):
            try:
                content = self._content(file, is_tile=len(tiles) > 0)
            except InputError as error:
                why = Obstacle(error.cause)
                continue
            wrap: tuple[Wrap, Wrap] = ("clamp", "clamp") if tiles else shown.wrap
            name = self._scene.name_of(file)
            numbers[file] = self._number_of(
                Texture(file, name, content, (material,), wrap, shown.alpha_hides)
            )
        if not numbers:
            named = Obstacle(f"'{shown.name}' {why.cause}", why.remedy)
            materials = self.missing.setdefault(named, [])
            materials += [material] if material not in materials else []
        elif tiles:
            there = {tile: numbers[file] for tile, file in tiles.items() if file in numbers}
            self.sets += [there] if there not in self.sets else []
            self.set_of[number] = self.sets.index(there)
        else:
            (self.texture_of[number],) = numbers.values()

    def _content(self, file: str, *, is_tile: bool) -> bytes | Callable[[], bytes]:
        if file in self.textures:
            return self.textures[file].content
        data = self._scene.read(file)
        return partial(self._scene.read, file) if is_tile or len(data) >= _LARGE else data

    def _number_of(self, texture: Texture) -> int:
        """Add an image of a material, and return its number."""
        old = self.textures.get(texture.key, texture)
        self._mixed |= {old.name: None} if old.wrap != texture.wrap else {}
        materials = tuple(dict.fromkeys([*old.materials, *texture.materials]))
        hides = old.alpha_hides or texture.alpha_hides
        self.textures[old.key] = dataclasses.replace(old, materials=materials, alpha_hides=hides)
        return [*self.textures].index(old.key)

    def notices(self) -> list[str]:
        left = [
            f"The {self._slot} texture of {', '.join(map(repr, materials))} is left as it is: {cause}."
            for (cause, _), materials in self.missing.items()
        ]
        several = "is used with several wrap modes; the first is followed."
        return left + [f"The {self._slot} image {name!r} {several}" for name in self._mixed]
