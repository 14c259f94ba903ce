"""What formats with textures share: names of new files, and meshes on their way to another format."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import PurePosixPath

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Int32s
from beltrami_cli.formats.document import Naming, NewImages
from beltrami_cli.formats.model_folder import NewFiles, tile_name
from beltrami_cli.surface.records import AlphaMode, ImageFile, Material, MaterialMap, Slot, TexturedMesh
from beltrami_cli.surface.tiling import Tile

TileSets = Mapping[str, Mapping[Tile, str]]  # the files of sets of tiles, by the path of the set
SlotsByPath = dict[tuple[str, tuple[tuple[str, ImageFile], ...]], "list[Slot]"]
_FIT = ".png"  # the suffix of images that a format cannot hold as they are


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
