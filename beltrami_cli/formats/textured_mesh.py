"""Meshes with textures on the way to another format: which maps it has, and names of their files and materials."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import PurePosixPath

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Bools, Float32s, Int32s
from beltrami_cli.formats.changes import Naming, NewImages
from beltrami_cli.formats.new_files import NewFiles
from beltrami_cli.surface.geometry import polygons_with, triangulate_corners
from beltrami_cli.surface.records import (
    Material,
    MaterialMap,
    MeshContents,
    MeshImage,
    Slot,
    Wrap,
)

MaterialMaps = Mapping[Slot, MaterialMap]
_FIT = ".png"  # the suffix of images that a format cannot hold as they are


def bare_polygons(mesh: MeshContents) -> Bools:
    """Return which polygons of a mesh with textures have no texture coordinates at a corner, shape (P,)."""
    assert mesh.uv is not None
    return polygons_with(np.asarray(np.isnan(mesh.uv).any(axis=1)), mesh.offsets)


def lost_repetition(mesh: MeshContents, *kept: Wrap) -> list[str]:
    """Return what a format does not say of images that are shown beyond their borders."""
    wraps = {shown.wrap for material in mesh.materials for shown in material.maps.values()}
    is_kept = all(u == v and u in kept for u, v in wraps)
    is_within = mesh.uv is None or not ((mesh.uv < 0) | (mesh.uv > 1)).any()
    return [] if is_within or is_kept else ["how textures are repeated"]


def normals_of_corners(mesh: MeshContents, notices: list[str]) -> Float32s | None:
    """Return the normals of corners, (K, 3), if all have one; a notice is added if only some have."""
    normals = mesh.corner_normals if mesh.normals is None else mesh.normals[mesh.corners]
    if normals is None or np.isfinite(normals).all():
        return normals
    if np.isfinite(normals).any():
        notices.append("Not converted: normals of parts that have them at some corners only.")
    return None


def triangulated(mesh: MeshContents) -> MeshContents:
    """Return a mesh whose polygons are cut into triangles, which `left_out` then says."""
    if (mesh.sizes == 3).all():
        return mesh
    lost = ["quads and polygons, which are cut into triangles"] if (mesh.sizes > 3).any() else []
    cut, polygon = triangulate_corners(mesh.positions, mesh.corners, mesh.offsets)
    return dataclasses.replace(
        mesh,
        corners=mesh.corners[cut].ravel(),
        offsets=3 * np.arange(len(cut) + 1),
        uv=None if mesh.uv is None else mesh.uv[cut].reshape(-1, 2),
        material_of=mesh.material_numbers[polygon],
        group_of=mesh.group_numbers[polygon],
        corner_normals=None if mesh.corner_normals is None else mesh.corner_normals[cut].reshape(-1, 3),
        left_out=(*mesh.left_out, *lost),
    )


def image_names(mesh: MeshContents, stem: str, supported: Collection[str] = ()) -> list[str]:
    """Return names for the files of the images, after the model, all different, as `with_suffixes` has them."""
    names, found = NewFiles(Naming(stem), mesh.source, (), ()), []
    for image in mesh.images:
        # A reference in MTL and PLY is the rest of a line, whose blanks at the ends programs cut off.
        plain = plain_name(PurePosixPath(image.name).stem)
        suffix = image.file.suffix if not supported or image.file.suffix in supported else _FIT
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
    """Return a name on one line, in characters: bytes that are not UTF-8 are taken for Latin-1."""
    line = " ".join(name.split())
    try:
        line.encode()
    except UnicodeEncodeError:
        return line.encode(errors="surrogateescape").decode("latin-1")
    return line


def with_images(mesh: MeshContents, images: NewImages) -> MeshContents:
    """Return a mesh with other images, by slot and key; each replaces that image in that slot alone."""

    def shown(slot: Slot, old: MaterialMap) -> MaterialMap:
        file = images.get((slot, old.image.key), old.image.file)
        return dataclasses.replace(old, image=dataclasses.replace(old.image, file=file))

    return _with_maps(mesh, lambda maps: {slot: shown(slot, old) for slot, old in maps.items()})


def with_slots(mesh: MeshContents, slots: Collection[Slot]) -> MeshContents:
    """Return a mesh with the maps of some slots only, and notices of the others."""
    lost = {slot for material in mesh.materials for slot in material.maps if slot not in slots}
    left_out = (*mesh.left_out, *(f"{slot} maps" for slot in sorted(lost)))
    mesh = _with_maps(mesh, lambda maps: {slot: each for slot, each in maps.items() if slot in slots})
    return dataclasses.replace(mesh, left_out=left_out)


def _with_maps(mesh: MeshContents, change: Callable[[MaterialMaps], MaterialMaps]) -> MeshContents:
    materials = tuple(dataclasses.replace(each, maps=change(each.maps)) for each in mesh.materials)
    return dataclasses.replace(mesh, materials=materials)


def with_suffixes(mesh: MeshContents, suffixes: Collection[str]) -> tuple[MeshContents, list[str]]:
    """Return a mesh whose images have one of some suffixes, and notices; the others are written as PNG."""
    from beltrami_cli.formats.image import losses, read_image, write_image

    new_of, notices = dict[MeshImage, MeshImage](), list[str]()
    for image in mesh.images:
        if suffixes and image.file.suffix not in suffixes:
            picture = read_image(image.file.data, image.name)
            file = write_image(picture, picture.pixels, suffix=_FIT)
            new_of[image] = dataclasses.replace(image, file=file)
            notices += losses(picture, _FIT)
    if new_of:
        held = ", ".join(suffix[1:] for suffix in suffixes)
        notices.append(f"Textures written as PNG, since the format holds {held} only: {len(new_of)}.")

    def shown(old: MaterialMap) -> MaterialMap:
        return dataclasses.replace(old, image=new_of.get(old.image, old.image))

    return _with_maps(mesh, lambda maps: {slot: shown(old) for slot, old in maps.items()}), notices


def shown_materials(
    materials: Sequence[Material], material_of: NDArray[np.integer]
) -> tuple[tuple[Material, ...], Int32s]:
    """Return the materials that triangles have, and which of these each has."""
    used, number_of = np.unique(material_of, return_inverse=True)
    return tuple(materials[index] for index in used), number_of.astype(np.int32)
