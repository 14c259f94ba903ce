"""A scene of polygons with materials, as readers fill it, and its conversion to textured surfaces and to meshes."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import PurePath
from typing import Any, get_args

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float64s, Int32s, Int64s
from beltrami_cli.errors import InputError, NoColoursError, Obstacle
from beltrami_cli.formats.access import LARGE
from beltrami_cli.formats.image.file_formats import suffix_for
from beltrami_cli.formats.mesh_contents import MaterialMaps, with_material_per_tile
from beltrami_cli.formats.new_files import TileSets
from beltrami_cli.surface import tiling
from beltrami_cli.surface.polygons import polygons_of, polygons_with, triangulate_corners
from beltrami_cli.surface.records import (
    AlphaMode,
    ImageFile,
    Material,
    MaterialMap,
    MeshContents,
    MeshImage,
    Slot,
    Texture,
    TexturedSurface,
    Wrap,
)
from beltrami_cli.surface.tiling import Tile

SLOTS: tuple[Slot, ...] = get_args(Slot)
_MAX_COORDINATE = 1e30  # texture coordinate that single precision holds with room for computing
_UNREAD = Obstacle("cannot be read")


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


@dataclass
class _SlotImages:
    """The images that materials show in a slot."""

    texture_of: Int32s  # of each material; -1: none, -2 - n: the tile set `sets[n]`
    textures: dict[str, Texture] = field(default_factory=dict)  # by their keys
    sets: list[dict[Tile, int]] = field(default_factory=list)  # indices of textures
    missing: dict[Obstacle, list[str]] = field(default_factory=dict)  # materials whose image cannot be read
    mixed: dict[str, None] = field(default_factory=dict)  # names of images with several wrap modes

    def add(self, texture: Texture) -> int:
        """Add an image of a material, and return its index."""
        old = self.textures.get(texture.key, texture)
        self.mixed |= {old.name: None} if old.wrap != texture.wrap else {}
        materials = tuple(dict.fromkeys([*old.materials, *texture.materials]))
        hides = old.alpha_hides or texture.alpha_hides
        self.textures[old.key] = dataclasses.replace(old, materials=materials, alpha_hides=hides)
        return [*self.textures].index(old.key)

    def notices(self, slot: Slot) -> list[str]:
        left = [
            f"The {slot} texture of {', '.join(map(repr, materials))} is left as it is: {cause}."
            for (cause, _), materials in self.missing.items()
        ]
        several = "is used with several wrap modes; the first is followed."
        return left + [f"The {slot} image {name!r} {several}" for name in self.mixed]


@dataclass(frozen=True)
class ShownMap:
    """The image that a material shows in a slot."""

    name: str  # as the file spells it
    path: str | None  # of an image or tile set; None: it is not read
    obstacle: Obstacle = _UNREAD  # why it is not read; follows the name in a message
    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")
    alpha_hides: bool = True  # as in `Texture`


Maps = Mapping[Slot, ShownMap]


@dataclass(frozen=True)
class Scene:
    """The polygons of a file and their materials."""

    name: str  # of the file, for messages
    positions: Float64s  # (V, 3)
    corners: Int32s  # (K,): vertices of the corners of all polygons
    offsets: Int64s  # (P + 1,): first corner of each polygon
    material_of: Int64s  # (P,): index into `materials`
    materials: Sequence[Material]  # without their maps
    maps: Sequence[Maps]  # of each material
    # Texture coordinates of all corners, (K, 2), for a slot (None: for polygons without an image); NaN: none.
    uv: Callable[[Slot | None], Float64s]
    tiles: TileSets
    read: Callable[[str], bytes]
    measured: Bools | None = None  # (V,): which vertices have a finite position; None: all
    # Whether materials have factors for their maps and an alpha mode; otherwise these follow from the maps.
    has_factors: bool = False
    names: Mapping[str, str] = field(default_factory=dict)  # of images that are not files, by path
    is_v_up: bool = True

    def surface(self, slot: Slot, undefined: Obstacle | None = None) -> tuple[TexturedSurface, list[str]]:
        """Return all triangles with the images of one slot, and notices; `undefined`: why a material is unknown."""
        cut, polygon = triangulate_corners(self.positions, self.corners, self.offsets)
        if not self._is_whole.all():
            kept = self._is_whole[polygon]
            cut, polygon = cut[kept], polygon[kept]
        shown = self._shown(slot)
        texture_of, uv = shown.texture_of[self.material_of[polygon]], self._uv(slot)[cut]
        bare = ~np.isfinite(uv).all(axis=(1, 2))
        lost = int(np.count_nonzero(bare & (texture_of != -1)))
        texture_of[bare] = -1
        if (texture_of == -1).all():
            is_bare = len(shown.textures) > 0
            raise no_texture(slot, self.name, shown.missing, is_bare=is_bare, why=undefined)
        uv[texture_of == -1] = 0
        textures = tuple(shown.textures.values())
        surface = TexturedSurface(self.positions, self.corners[cut], uv, texture_of, textures)
        if shown.sets:
            surface = tiling.on_tiles(surface, shown.sets, self.name)
        bare_notice = f"{lost} triangles of textured materials have no texture coordinates."
        return surface, shown.notices(slot) + ([bare_notice] if lost else [])

    def _shown(self, slot: Slot) -> _SlotImages:
        """Read the images of one slot."""
        shown = _SlotImages(np.full(len(self.maps), -1, np.int32))
        for number in np.unique(self.material_of).tolist():
            found, material = self.maps[number].get(slot), self.materials[number].name
            if found is None:
                continue
            tiles, numbers, why = self.tiles.get(found.path or "", {}), dict[str, int](), found.obstacle
            wrap: tuple[Wrap, Wrap] = ("clamp", "clamp") if tiles else found.wrap
            for file in [*tiles.values()] or ([] if found.path is None else [found.path]):
                try:
                    content = self._content(file, shown.textures.get(file), is_tile=len(tiles) > 0)
                except InputError as error:
                    why = Obstacle(error.cause)
                    continue
                name = self._name_of(file)
                numbers[file] = shown.add(Texture(file, name, content, (material,), wrap, found.alpha_hides))
            if not numbers:
                named = Obstacle(f"'{found.name}' {why.cause}", why.remedy)
                materials = shown.missing.setdefault(named, [])
                materials += [material] if material not in materials else []
            elif not tiles:
                (shown.texture_of[number],) = numbers.values()
            else:
                own = {tile: numbers[file] for tile, file in tiles.items() if file in numbers}
                shown.sets += [own] if own not in shown.sets else []
                shown.texture_of[number] = -2 - shown.sets.index(own)
        return shown

    def _content(self, file: str, known: Texture | None, *, is_tile: bool) -> bytes | Callable[[], bytes]:
        if known is not None:
            return known.content
        data = self.read(file)
        return partial(self.read, file) if is_tile or len(data) >= LARGE else data

    def mesh(
        self,
        left_out: Sequence[str],
        groups: tuple[tuple[str, ...], Int64s] = (("",), np.zeros(1, np.int64)),
        normals: Array | None = None,
    ) -> MeshContents:
        """Return the polygons with all materials; `groups`: names, and the index of the group of each polygon."""
        uv, elsewhere = self._common_coordinates()
        images, materials, lost = dict[str, MeshImage](), [*self.materials], [*left_out]
        kept = np.flatnonzero(self._is_whole)
        if not len(kept):
            raise InputError(self.name, "it has no faces, so there is nothing to show a texture")
        for number in np.unique(self.material_of[kept]).tolist():
            maps: dict[Slot, MaterialMap] = {}
            for slot, found in self.maps[number].items():
                if found.path is None:
                    lost.append(f"the {slot} map '{found.name}', which cannot be read")
                elif (number, slot) in elsewhere:
                    lost.append(f"{slot} maps that are placed otherwise than the base colour")
                else:
                    maps[slot] = MaterialMap(self._image(found.path, images), found.wrap)
            materials[number] = self._with_maps(materials[number], maps)
        corner_normals = None if normals is None or np.isnan(normals).all() else normals.astype(np.float32)
        mesh = MeshContents(
            positions=self.positions,
            corners=self.corners,
            offsets=self.offsets,
            colours=np.empty((len(self.positions), 0), np.float32),
            left_out=tuple(lost),
            uv=uv,
            materials=tuple(materials),
            material_of=self.material_of.astype(np.int32),
            groups=groups[0],
            group_of=np.broadcast_to(groups[1], len(self.offsets) - 1).astype(np.int32),
            corner_normals=corner_normals,
            source=PurePath(self.name).stem,
        )
        return with_material_per_tile(mesh.polygons(kept))

    def _image(self, path: str, known: dict[str, MeshImage]) -> MeshImage:
        """Return the image of a file or tile set."""
        if path in self.tiles:
            tiles = tuple((tile, self._image(file, known)) for tile, file in self.tiles[path].items())
            return dataclasses.replace(tiles[0][1], tiles=tiles)
        if path not in known:
            data, name = self.read(path), self._name_of(path)
            known[path] = MeshImage(ImageFile(data, suffix_for(data, name) or ".png"), name, path)
        return known[path]

    def _name_of(self, path: str) -> str:
        return self.names.get(path, path.rpartition("/")[2])

    def _uv(self, slot: Slot | None) -> Float64s:
        """Return texture coordinates of all corners, v down."""
        return self.uv(slot) * [1, -1] + [0, 1] if self.is_v_up else self.uv(slot)

    def _with_maps(self, material: Material, maps: MaterialMaps) -> Material:
        """Return a material with maps; the factors of these are white and 1 unless the scene has factors."""
        white, base = (1.0, 1.0, 1.0), maps.get("baseColor")
        new: dict[str, Any] = {"maps": maps}
        if not self.has_factors:
            new |= {"colour": white} if base is not None else {}
            new |= {"emission": white} if "emissive" in maps else {}
            new |= {"metalness": 1.0, "roughness": 1.0} if "metallicRoughness" in maps else {}
            if material.alpha == "opaque" and base is not None:
                new["alpha"] = _alpha_mode(base.image.file.data, base.image.name)
        return dataclasses.replace(material, **new)

    @property
    def _is_whole(self) -> Bools:
        """Polygons with at least three corners, all of them at finite positions."""
        is_whole = np.diff(self.offsets) >= 3
        if self.measured is not None:
            is_whole &= ~polygons_with(~self.measured[self.corners], self.offsets)
        return np.asarray(is_whole)

    def _common_coordinates(self) -> tuple[Float64s, set[tuple[int, Slot]]]:
        """Return one set of texture coordinates, (K, 2), v down, and the materials and slots that need another set."""
        uv, elsewhere = np.full((len(self.corners), 2), np.nan), set[tuple[int, Slot]]()
        material_of = self.material_of[polygons_of(self.offsets)]
        for slot in (*(slot for slot in SLOTS if any(slot in maps for maps in self.maps)), None):
            fresh = np.isnan(uv).any(axis=1)
            if slot is None and not fresh.any():
                break
            own = self._uv(slot)
            own = np.where(np.abs(own) < _MAX_COORDINATE, own, np.nan)
            has_map = np.array([slot is None or slot in maps for maps in self.maps])[material_of]
            given = has_map & ~np.isnan(own).any(axis=1)
            if slot is not None:
                differs = given & ~fresh & (own != uv).any(axis=1)
                elsewhere |= {(number, slot) for number in np.unique(material_of[differs]).tolist()}
            np.copyto(uv, own, where=(given & fresh)[:, None])
        return uv, elsewhere


def _alpha_mode(data: bytes, name: str) -> AlphaMode:
    """Return the alpha mode of an image, for formats whose materials have none."""
    from beltrami_cli.formats.image.reading import read_image
    from beltrami_cli.formats.image.sizes import measure_image

    size = measure_image(data)
    if size is None or size.channels not in (2, 4):
        return "opaque"
    image = read_image(data, name, finite=False)
    opacity = image.pixels[..., image.alpha or 0]
    most = np.iinfo(opacity.dtype).max if opacity.dtype.kind == "u" else 1
    if image.alpha is None or not (opacity < most).any():
        return "opaque"
    return "mask" if np.isin(opacity, (0, most)).all() else "blend"
