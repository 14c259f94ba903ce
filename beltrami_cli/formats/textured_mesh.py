"""What formats with textures share: their triangles, materials and images, and meshes on their way to other formats.

A format describes its polygons as a `Scene`: one slot is painted, or the whole is converted.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import PurePosixPath
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Array, Bools, Float64s, Int32s, Int64s
from beltrami_cli.errors import InputError, UnpaintedError
from beltrami_cli.formats.access import LARGE
from beltrami_cli.formats.document import Naming, NewImages
from beltrami_cli.formats.image.picture import suffix_for
from beltrami_cli.formats.model_folder import NewFiles, remedy_for, tile_name
from beltrami_cli.surface import tiling
from beltrami_cli.surface.geometry import triangulate_corners
from beltrami_cli.surface.records import (
    AlphaMode,
    ImageFile,
    Material,
    MaterialMap,
    MeshImage,
    Slot,
    Texture,
    TexturedMesh,
    TexturedSurface,
    Wrap,
)
from beltrami_cli.surface.tiling import Tile

SLOTS: tuple[Slot, ...] = get_args(Slot)
TileSets = Mapping[str, Mapping[Tile, str]]  # the files of sets of tiles, by the path of the set
SlotsByPath = dict[tuple[str, tuple[tuple[str, ImageFile], ...]], "list[Slot]"]
_LARGEST = 1e30  # texture coordinate that single precision holds with room for computing
_POLYGONS_CUT = "quads and polygons, which are cut into triangles"
_FIT = ".png"  # the suffix of images that a format cannot hold as they are


@dataclass
class _Shown:
    """An image that is shown in a slot: the number of its texture, and which materials show it how."""

    number: int
    name: str
    content: bytes | Callable[[], bytes]  # as in `Texture`
    materials: dict[str, None] = field(default_factory=dict)
    wraps: list[tuple[Wrap, Wrap]] = field(default_factory=list)
    alpha_hides: bool = False


class SlotImages:
    """The images that are shown in one slot while its materials are read; by keys, as in `Texture`."""

    # A set of tiles has the number -2 minus its index in `sets`, which have the images of its tiles.

    def __init__(self, slot: Slot) -> None:
        self._slot = slot
        self._shown: dict[str, _Shown] = {}
        self._missing: dict[str, dict[str, None]] = {}  # materials by the reason why they show no image
        self.sets: list[dict[Tile, int]] = []

    def __len__(self) -> int:
        return len(self._shown)

    def __contains__(self, key: str) -> bool:
        return key in self._shown

    def take(self, key: str, name: str, content: bytes | Callable[[], bytes]) -> None:
        """Take an image that is not known yet."""
        self._shown[key] = _Shown(len(self._shown), name, content)

    def set_of(self, tiles: dict[Tile, int]) -> int:
        """Return the number that stands for the textures of a set of tiles."""
        if tiles not in self.sets:
            self.sets.append(tiles)
        return -2 - self.sets.index(tiles)

    def show(self, key: str, material: str, wrap: tuple[Wrap, Wrap], *, alpha_hides: bool = True) -> int:
        """Note that a material shows an image; return the number of its texture."""
        shown = self._shown[key]
        shown.wraps.append(wrap)
        shown.alpha_hides |= alpha_hides
        shown.materials[material] = None
        return shown.number

    def miss(self, reason: str, material: str) -> None:
        """Note why a material shows no image; the reason names that."""
        self._missing.setdefault(reason, {})[material] = None

    def textures(self) -> tuple[Texture, ...]:
        return tuple(
            Texture(key, each.name, each.content, tuple(each.materials), each.wraps[0], each.alpha_hides)
            for key, each in self._shown.items()
        )

    def notices(self) -> list[str]:
        """Return a sentence for each image that cannot be shown, and each that is repeated in several ways."""
        left = [
            f"The {self._slot} texture of {', '.join(map(repr, materials))} is left as it is: {reason}."
            for reason, materials in self._missing.items()
        ]
        mixed = [each.name for each in self._shown.values() if len(set(each.wraps)) > 1]
        several = "is used with several wrap modes; the first is followed."
        return left + [f"The {self._slot} image {name!r} {several}" for name in mixed]

    def refusal(self, name: str, *, is_bare: bool, why: str = "") -> InputError:
        """Return the error that nothing shows an image: `is_bare` for lack of texture coordinates, or `why` else."""
        if self._missing:
            reason = next(iter(self._missing))
            cause = f"its {self._slot} texture cannot be read: {reason}"
            return UnpaintedError(name, cause, remedy_for(reason))
        if is_bare:
            cause = f"it has a {self._slot} texture, but no texture coordinates for it"
            return InputError(name, cause, "export it with them")
        reason = f", because {why}" if why else ""
        return UnpaintedError(name, f"it has no {self._slot} texture{reason}", remedy_for(reason))


class MeshImages:
    """The images of a mesh while its materials are read; one that stands for a set of tiles is in `sets`."""

    def __init__(self, names: Mapping[str, str]) -> None:
        self._names = names  # of images by key, where they are not files with names
        self.images: list[MeshImage] = []
        self.sets: dict[int, dict[Tile, int]] = {}
        self._index_of: dict[str, int] = {}

    def take_file(self, path: str, sets: TileSets, read: Callable[[str], bytes]) -> int:
        """Take the file of a path, or the files of one of some sets of tiles; return the number of either."""
        if path in self._index_of:
            return self._index_of[path]
        if path not in sets:
            data, name = read(path), self._names.get(path, path.rpartition("/")[2])
            self._index_of[path] = len(self.images)
            self.images.append(MeshImage(ImageFile(data, suffix_for(data, name) or ".png"), name, path))
            return self._index_of[path]
        tiles = {tile: self.take_file(file, sets, read) for tile, file in sets[path].items()}
        self._index_of[path] = len(self.images)
        self.sets[len(self.images)] = tiles
        self.images.append(self.images[next(iter(tiles.values()))])
        return self._index_of[path]


def usable_coordinates(uv: Float64s) -> Float64s:
    """Return texture coordinates, NaN where single precision does not hold them."""
    return np.where(np.abs(uv) < _LARGEST, uv, np.nan)


@dataclass(frozen=True)
class ShownMap:
    """The image that a material shows in a slot."""

    name: str  # as the file spells it
    path: str | None  # of an image, or of a set of tiles; None: it is not read
    reason: str = ""  # then: why, to be put behind the name
    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")
    alpha_hides: bool = True  # as in `Texture`


Maps = Mapping[Slot, ShownMap]


@dataclass(frozen=True)
class Scene:
    """The polygons of a file and their materials."""

    name: str  # of the file, for messages
    positions: Float64s  # (V, 3)
    corners: Int32s  # (K,): vertices of the corners of all polygons
    offsets: Int64s  # (P + 1,): where each polygon starts
    material_of: Int64s  # (P,): index into `materials`
    materials: Sequence[str]  # their names
    maps: Sequence[Maps]  # of each material
    # Texture coordinates of all corners, (K, 2), for a slot (None: of polygons without an image); NaN: none.
    uv: Callable[[Slot | None], Float64s]
    tiles: TileSets
    read: Callable[[str], bytes]
    measured: Bools | None = None  # (V,): which vertices have a position; None: all
    names: Mapping[str, str] = field(default_factory=dict)  # of images, where they are not files with names
    is_v_up: bool = True

    @cached_property
    def triangles(self) -> tuple[Int32s, Int64s]:
        """Corners (F, 3) of the triangles whose vertices all have a position, and the polygon of each."""
        cut, polygon = triangulate_corners(self.positions, self.corners, self.offsets)
        if self.measured is None or self.measured.all():
            return cut, polygon
        kept = self.measured[self.corners[cut]].all(axis=1)
        return cut[kept], polygon[kept]

    def _coordinates(self, slot: Slot | None) -> Float64s:
        uv = self.uv(slot)[self.triangles[0]]
        if self.is_v_up:
            uv[..., 1] = 1 - uv[..., 1]
        return uv

    def surface(self, slot: Slot, undefined: str = "") -> tuple[TexturedSurface, list[str]]:
        """Return all triangles, the images of one slot, and notices; `undefined`: why a material is not known."""
        (cut, polygon), shown = self.triangles, SlotImages(slot)
        texture_of_material = np.full(len(self.maps), -1, np.int32)
        for number in np.unique(self.material_of).tolist():
            texture_of_material[number] = self._shown(number, slot, shown)
        texture_of, uv = texture_of_material[self.material_of[polygon]], self._coordinates(slot)
        bare = ~np.isfinite(uv).all(axis=(1, 2))
        lost = int(np.count_nonzero(bare & (texture_of != -1)))
        texture_of[bare] = -1
        if (texture_of == -1).all():
            raise shown.refusal(self.name, is_bare=len(shown) > 0, why=undefined)
        uv[texture_of == -1] = 0
        surface = TexturedSurface(self.positions, self.corners[cut], uv, texture_of, shown.textures())
        if shown.sets:
            surface = tiling.on_tiles(surface, shown.sets, self.name)
        bare_notice = f"{lost} triangles of textured materials have no texture coordinates."
        return surface, shown.notices() + ([bare_notice] if lost else [])

    def _shown(self, number: int, slot: Slot, shown: SlotImages) -> int:
        """Return the texture that a material shows in a slot; -1 if there is none."""
        found, material = self.maps[number].get(slot), self.materials[number]
        if found is None:
            return -1
        tiles, number_of, cause = self.tiles.get(found.path or "", {}), {}, found.reason
        for file in [*tiles.values()] or ([] if found.path is None else [found.path]):
            try:
                if file not in shown:
                    data = self.read(file)
                    content = partial(self.read, file) if tiles or len(data) >= LARGE else data
                    shown.take(file, self.names.get(file, file.rpartition("/")[2]), content)
                wrap: tuple[Wrap, Wrap] = ("clamp", "clamp") if tiles else found.wrap
                number_of[file] = shown.show(file, material, wrap, alpha_hides=found.alpha_hides)
            except InputError as error:
                cause = error.cause
        if not number_of:
            shown.miss(f"'{found.name}' {cause}", material)
            return -1
        own = {tile: number_of[file] for tile, file in tiles.items() if file in number_of}
        return shown.set_of(own) if tiles else number_of[file]

    def mesh(
        self,
        material: Callable[[int, Mapping[Slot, MaterialMap], MeshImages], Material],
        left_out: Sequence[str],
        groups: tuple[tuple[str, ...], Int64s] = (("",), np.zeros(1, np.int64)),
        normals: Array | None = None,
        source: str = "",
    ) -> TexturedMesh:
        """Return all triangles with materials, which `material` makes of their maps, groups and normals of corners."""
        cut, polygon = self.triangles
        if not len(cut):
            raise InputError(self.name, "it has no faces, so there is nothing to show a texture")
        used, material_of = np.unique(self.material_of[polygon], return_inverse=True)
        uv, elsewhere = self._common_coordinates()
        images, materials, lost = MeshImages(self.names), [], [*left_out]
        for number in used.tolist():
            maps: dict[Slot, MaterialMap] = {}
            for slot, found in self.maps[number].items():
                if found.path is None:
                    lost.append(f"the {slot} map '{found.name}', which cannot be read")
                elif (number, slot) in elsewhere:
                    lost.append(f"{slot} maps that are placed otherwise than the base colour")
                else:
                    image = images.take_file(found.path, self.tiles, self.read)
                    maps[slot] = MaterialMap(image, found.wrap)
            materials.append(material(number, maps, images))
        lost += [_POLYGONS_CUT] if (np.diff(self.offsets) > 3).any() else []
        corner_normals = None if normals is None else normals[cut].astype(np.float32)
        mesh = TexturedMesh(
            positions=self.positions,
            faces=self.corners[cut],
            uv=uv,
            materials=tuple(materials),
            images=tuple(images.images),
            source=source,
            material_of=material_of.astype(np.int32),
            groups=groups[0],
            group_of=np.broadcast_to(groups[1], len(self.offsets) - 1)[polygon].astype(np.int32),
            normals=None if corner_normals is None or np.isnan(corner_normals).all() else corner_normals,
            left_out=tuple(lost),
        )
        return on_tiles(mesh, images.sets)

    def _common_coordinates(self) -> tuple[Float64s, set[tuple[int, Slot]]]:
        """Return one set of texture coordinates, (F, 3, 2), and materials and slots that need another one."""
        material_of = self.material_of[self.triangles[1]]
        uv, elsewhere = np.full((len(material_of), 3, 2), np.nan), set[tuple[int, Slot]]()
        for slot in (*(slot for slot in SLOTS if any(slot in maps for maps in self.maps)), None):
            fresh = np.isnan(uv).any(axis=(1, 2))
            if slot is None and not fresh.any():
                break
            own = usable_coordinates(self._coordinates(slot))
            has_map = np.array([slot is None or slot in maps for maps in self.maps])[material_of]
            given = has_map & ~np.isnan(own).any(axis=(1, 2))
            if slot is not None:
                differs = given & ~fresh & (own != uv).any(axis=(1, 2))
                elsewhere |= {(number, slot) for number in np.unique(material_of[differs]).tolist()}
            np.copyto(uv, own, where=(given & fresh)[:, None, None])
        return uv, elsewhere


def on_tiles(mesh: TexturedMesh, sets: Mapping[int, Mapping[Tile, int]]) -> TexturedMesh:
    """Return a mesh with a material for each tile; `sets` are the images of tiles, by one image that stands for all."""
    if not sets:
        return mesh
    tiled = [any(shown.image in sets for shown in each.maps.values()) for each in mesh.materials]
    material_of = mesh.material_numbers.copy()
    faces = np.flatnonzero(np.array(tiled)[material_of] & np.isfinite(mesh.uv).all(axis=(1, 2)))
    tiles = tiling.tiles_under(mesh.uv[faces])
    uv, materials = mesh.uv.copy(), list(mesh.materials)
    uv[faces] += np.column_stack([-tiles[:, 0], tiles[:, 1]])[:, None]
    pairs = np.column_stack([material_of[faces], tiles]).astype(np.int64)
    rows, number_of = np.unique(pairs, axis=0, return_inverse=True)
    for old, *place in rows.tolist():
        tile, material = (place[0], place[1]), mesh.materials[old]
        maps = {
            slot: dataclasses.replace(shown, image=image)
            for slot, shown in material.maps.items()
            if (image := sets.get(shown.image, {tile: shown.image}).get(tile)) is not None
        }
        name = tile_name(f"{material.name or 'tile'}_<UDIM>", tile)
        materials.append(dataclasses.replace(material, name=name, maps=maps))
    material_of[faces] = len(mesh.materials) + number_of.reshape(-1)
    shown, material_of = shown_materials(materials, material_of)
    return dataclasses.replace(mesh, uv=uv, materials=shown, material_of=material_of)


def slots_by_path(images: NewImages, paths_of: Callable[[Slot, str], Iterable[str]]) -> SlotsByPath:
    """Return the slots in which a path, of an image or a set of tiles, gets the same new files; these go with it."""
    files: dict[tuple[str, Slot], list[tuple[str, ImageFile]]] = {}
    for (slot, file), image in images.items():
        for path in paths_of(slot, file):
            files.setdefault((path, slot), []).append((file, image))
    slots: SlotsByPath = {}
    for (path, slot), new in files.items():
        slots.setdefault((path, tuple(new)), []).append(slot)
    return slots


def new_files(path: str, new: str, sets: TileSets) -> dict[str, str]:
    """Return the new file of each file of a path, which is an image or one of some sets of tiles."""
    tiles = sets[path].items() if path in sets else ()
    return {file: file if path == new else tile_name(new, tile) for tile, file in tiles} or {path: new}


def common_suffix(suffixes: Iterable[str]) -> str | None:
    """Return the suffix that all tiles of a set have; None if they differ, so that their name cannot have it."""
    distinct = set(suffixes)
    return distinct.pop() if len(distinct) == 1 else None


def image_names(mesh: TexturedMesh, stem: str, held: Collection[str] = ()) -> list[str]:
    """Return names for the files of the images, after the model, all different, as `with_suffixes` has them."""
    names, found = NewFiles(Naming(stem), mesh.source, (), ()), []
    for image in mesh.images:
        # A reference in MTL and PLY is the rest of a line, whose blanks at the ends programs cut off.
        plain = plain_name(PurePosixPath(image.name).stem)
        suffix = image.file.suffix if not held or image.file.suffix in held else _FIT
        found.append(names.image(plain + suffix) if plain else names.new(suffix))
    return found


def material_names(materials: Sequence[Material], default: str) -> list[str]:
    """Return names for the materials, all different, on one line each; `default` where there is none."""
    names: dict[str, None] = {}
    for material in materials:
        plain = name = plain_name(material.name) or default
        while name in names:
            name = f"{plain}-{len(names) + 1}"
        names[name] = None
    return list(names)


def plain_name(name: str) -> str:
    """Return a name on one line, in characters: bytes that are no UTF-8 are taken for Latin-1."""
    line = " ".join(name.split())
    try:
        line.encode()
    except UnicodeEncodeError:
        return line.encode(errors="surrogateescape").decode("latin-1")
    return line


def with_images(mesh: TexturedMesh, images: NewImages) -> TexturedMesh:
    """Return a mesh with other images, by slot and key; each replaces that image in that slot alone."""
    known = list(mesh.images)
    index_of: dict[tuple[Slot, str], int] = {}
    materials = []
    for material in mesh.materials:
        maps = dict(material.maps)
        for slot, shown in material.maps.items():
            old = mesh.images[shown.image]
            place = slot, old.key
            if place in images and place not in index_of:
                index_of[place] = len(known)
                known.append(dataclasses.replace(old, file=images[place]))
            if place in index_of:
                maps[slot] = dataclasses.replace(shown, image=index_of[place])
        materials.append(dataclasses.replace(material, maps=maps))
    return _without_unused(dataclasses.replace(mesh, materials=tuple(materials), images=tuple(known)))


def with_slots(mesh: TexturedMesh, slots: Collection[Slot]) -> TexturedMesh:
    """Return a mesh with the maps of some slots only, and notices of the others."""
    lost = {slot for material in mesh.materials for slot in material.maps if slot not in slots}
    materials = tuple(
        dataclasses.replace(each, maps={slot: shown for slot, shown in each.maps.items() if slot in slots})
        for each in mesh.materials
    )
    left_out = (*mesh.left_out, *(f"{slot} maps" for slot in sorted(lost)))
    return _without_unused(dataclasses.replace(mesh, materials=materials, left_out=left_out))


def with_suffixes(mesh: TexturedMesh, suffixes: Collection[str]) -> tuple[TexturedMesh, list[str]]:
    """Return a mesh whose images have one of some suffixes, and notices; the others are written as PNG."""
    from beltrami_cli.formats.image import losses, read_image, write_image

    images, notices, changed = list(mesh.images), list[str](), 0
    for number, image in enumerate(images):
        if suffixes and image.file.suffix not in suffixes:
            picture = read_image(image.file.data, image.name)
            file = write_image(picture, picture.pixels, suffix=_FIT)
            images[number] = dataclasses.replace(image, file=file)
            notices += losses(picture, _FIT)
            changed += 1
    if changed:
        held = ", ".join(suffix[1:] for suffix in suffixes)
        notices.append(f"Textures written as PNG, since the format holds {held} only: {changed}.")
    return dataclasses.replace(mesh, images=tuple(images)), notices


def _without_unused(mesh: TexturedMesh) -> TexturedMesh:
    used = sorted({shown.image for material in mesh.materials for shown in material.maps.values()})
    materials = []
    for each in mesh.materials:
        maps = {slot: MaterialMap(used.index(shown.image), shown.wrap) for slot, shown in each.maps.items()}
        materials.append(dataclasses.replace(each, maps=maps))
    images = tuple(mesh.images[old] for old in used)
    return dataclasses.replace(mesh, materials=tuple(materials), images=images)


def alpha_mode(data: bytes, name: str) -> AlphaMode:
    """Return how an image is seen through, in formats whose materials do not say it."""
    from beltrami_cli.formats.image.reading import measure_image, read_image

    size = measure_image(data)
    if size is None or size.channels not in (2, 4):
        return "opaque"
    picture = read_image(data, name, finite=False)
    opacity = picture.pixels[..., picture.alpha or 0]
    most = np.iinfo(opacity.dtype).max if opacity.dtype.kind == "u" else 1
    if picture.alpha is None or not (opacity < most).any():
        return "opaque"
    return "mask" if np.isin(opacity, (0, most)).all() else "blend"


def shown_materials(
    materials: Sequence[Material], material_of: NDArray[np.integer]
) -> tuple[tuple[Material, ...], Int32s]:
    """Return the materials that triangles have, and which of these each has."""
    used, number_of = np.unique(material_of, return_inverse=True)
    return tuple(materials[index] for index in used), number_of.astype(np.int32)
