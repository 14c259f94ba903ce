"""What writers of meshes share: losses of the target format, names of image files and materials, other images."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import PurePosixPath

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Bools, Float32s, Int32s
from beltrami_cli.formats.changes import Naming, NewImages
from beltrami_cli.formats.sidecars.new_files import NewFiles
from beltrami_cli.surface.polygons import polygons_with, triangulate_corners
from beltrami_cli.surface.records import (
    Material,
    MaterialMap,
    MeshContents,
    MeshImage,
    Slot,
    Wrap,
)
from beltrami_cli.surface.slots import COLOUR_SLOTS

MaterialMaps = Mapping[Slot, MaterialMap]
_UNNAMED = "painted"  # name of materials without one
_FALLBACK_SUFFIX = ".png"  # of images whose own type the format cannot hold


def not_converted(mesh: MeshContents, further: Iterable[str] = (), *, keeps_frame: bool = False) -> list[str]:
    """Return a notice of the losses of a conversion, if there are any."""
    left = dict.fromkeys([*mesh.left_out, *further])
    if mesh.frame.up != "Y" and not keeps_frame:
        left |= {f"the axis that is up, which is {mesh.frame.up}": None}
    if mesh.frame.unit != 1 and not keeps_frame:
        left |= {f"the unit of {mesh.frame.unit:g} m": None}
    return [f"Not converted: {'; '.join(left)}."] if left else []


def bare_polygons(mesh: MeshContents) -> Bools:
    """Return the polygons, shape (P,), that lack texture coordinates at a corner."""
    assert mesh.uv is not None
    return polygons_with(np.asarray(np.isnan(mesh.uv).any(axis=1)), mesh.offsets)


def lost_repetition(mesh: MeshContents, *kept: Wrap) -> list[str]:
    """Return the loss of wrap modes other than `kept`, if texture coordinates leave the images."""
    wraps = {shown.wrap for material in mesh.materials for shown in material.maps.values()}
    is_kept = all(u == v and u in kept for u, v in wraps)
    is_within = mesh.uv is None or not ((mesh.uv < 0) | (mesh.uv > 1)).any()
    return [] if is_within or is_kept else ["how textures are repeated"]


def normals_of_corners(mesh: MeshContents) -> tuple[Float32s | None, list[str]]:
    """Return the normals of corners, (K, 3), or None unless all have one; and a notice if only some have."""
    normals = mesh.corner_normals if mesh.normals is None else mesh.normals[mesh.corners]
    if normals is None or np.isfinite(normals).all():
        return normals, []
    lost = "Not converted: normals of parts that have them at some corners only."
    return None, [lost] if np.isfinite(normals).any() else []


def triangulated(mesh: MeshContents) -> MeshContents:
    """Cut the polygons of a mesh into triangles, and note that in `left_out`."""
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
        # References in MTL and PLY extend to the end of the line, and programs strip blanks at their ends.
        plain = plain_name(PurePosixPath(image.name).stem)
        suffix = image.file.suffix if not supported or image.file.suffix in supported else _FALLBACK_SUFFIX
        found.append(names.image(plain + suffix) if plain else names.new(suffix))
    return found


def material_names(materials: Sequence[Material]) -> list[str]:
    """Return unique names for the materials, each on one line."""
    names: dict[str, None] = {}
    for material in materials:
        plain = name = plain_name(material.name) or _UNNAMED
        while name in names:
            name = f"{plain}-{len(names) + 1}"
        names[name] = None
    return list(names)


def plain_name(name: str) -> str:
    """Return a name on one line; bytes that are not UTF-8 are decoded as Latin-1."""
    line = " ".join(name.split())
    try:
        line.encode()
    except UnicodeEncodeError:
        return line.encode(errors="surrogateescape").decode("latin-1")
    return line


def with_images(mesh: MeshContents, images: NewImages) -> MeshContents:
    """Replace images by slot and key; each replaces the image in that slot only."""

    def shown(slot: Slot, old: MaterialMap) -> MaterialMap:
        file = images.get((slot, old.image.key), old.image.file)
        return dataclasses.replace(old, image=dataclasses.replace(old.image, file=file))

    return _with_maps(mesh, lambda maps: {slot: shown(slot, old) for slot, old in maps.items()})


def with_slots(mesh: MeshContents, slots: Collection[Slot]) -> MeshContents:
    """Keep only the maps of some slots, and note the others in `left_out`."""
    lost = {slot for material in mesh.materials for slot in material.maps if slot not in slots}
    left_out = (*mesh.left_out, *(f"{slot} maps" for slot in sorted(lost)))
    mesh = _with_maps(mesh, lambda maps: {slot: each for slot, each in maps.items() if slot in slots})
    return dataclasses.replace(mesh, left_out=left_out)


def _with_maps(mesh: MeshContents, change: Callable[[MaterialMaps], MaterialMaps]) -> MeshContents:
    materials = tuple(dataclasses.replace(each, maps=change(each.maps)) for each in mesh.materials)
    return dataclasses.replace(mesh, materials=materials)


def with_suffixes(mesh: MeshContents, suffixes: Collection[str]) -> tuple[MeshContents, list[str]]:
    """Convert images with other suffixes to PNG; return also notices. No suffixes: any are kept."""
    from beltrami_cli.formats.image.reading import read_image
    from beltrami_cli.formats.image.writing import write_image

    new_of, notices = dict[MeshImage, MeshImage](), list[str]()
    maps = [each for material in mesh.materials for each in material.maps.items()]
    colours = {shown.image for slot, shown in maps if slot in COLOUR_SLOTS}
    for image in mesh.images:
        if suffixes and image.file.suffix not in suffixes:
            decoded, as_data = read_image(image.file.data, image.name), image not in colours
            file = write_image(decoded, decoded.pixels, suffix=_FALLBACK_SUFFIX, as_data=as_data)
            new_of[image] = dataclasses.replace(image, file=file)
            notices += [*decoded.notices, *file.notices]
    if new_of:
        held = ", ".join(suffix[1:] for suffix in suffixes)
        notices.append(f"Textures written as PNG, since the format holds {held} only: {len(new_of)}.")

    def shown(old: MaterialMap) -> MaterialMap:
        return dataclasses.replace(old, image=new_of.get(old.image, old.image))

    return _with_maps(mesh, lambda maps: {slot: shown(old) for slot, old in maps.items()}), notices


def shown_materials(
    materials: Sequence[Material], material_of: NDArray[np.integer]
) -> tuple[tuple[Material, ...], Int32s]:
    """Return the materials in use, and the index of each triangle's."""
    used, number_of = np.unique(material_of, return_inverse=True)
    return tuple(materials[index] for index in used), number_of.astype(np.int32)
