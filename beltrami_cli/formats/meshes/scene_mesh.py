"""The textured mesh of a scene, for writers of other formats."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array, Float64s, Int64s
from beltrami_cli.errors import InputError
from beltrami_cli.formats.colours import clipped_factor
from beltrami_cli.formats.image.file_formats import suffix_for
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.image.sizes import measure_image
from beltrami_cli.formats.meshes.scene import Scene
from beltrami_cli.formats.meshes.writing import MaterialMaps, bare_polygons, shown_materials
from beltrami_cli.formats.sidecars.tile_names import tile_name
from beltrami_cli.surface import tiling
from beltrami_cli.surface.polygons import polygons_of
from beltrami_cli.surface.records import AlphaMode, ImageFile, Material, MaterialMap, MeshContents, MeshImage
from beltrami_cli.surface.slots import SLOTS, Slot
from beltrami_cli.surface.tiling import Tile

_MAX_COORDINATE = 1e30  # texture coordinate that single precision holds with room for computing


def textured_mesh(
    scene: Scene,
    left_out: Sequence[str],
    groups: tuple[tuple[str, ...], Int64s] = (("",), np.zeros(1, np.int64)),
    normals: Array | None = None,
) -> MeshContents:
    """Return the polygons with all materials; `groups`: names, and the index of the group of each polygon."""
    uv, elsewhere = _common_coordinates(scene)
    images, materials, lost = dict[str, MeshImage](), [*scene.materials], [*left_out]
    kept = np.flatnonzero(scene.is_whole)
    if not len(kept):
        raise InputError(scene.name, "it has no faces, so there is nothing to show a texture")
    for number in np.unique(scene.material_of[kept]).tolist():
        maps: dict[Slot, MaterialMap] = {}
        for slot, found in scene.maps[number].items():
            if found.path is None:
                lost.append(f"the {slot} map '{found.name}', which cannot be read")
            elif (number, slot) in elsewhere:
                lost.append(f"{slot} maps that are placed otherwise than the base colour")
            else:
                maps[slot] = MaterialMap(_tiled_image(scene, found.path, found.tiles, images), found.wrap)
        materials[number], clipped = _within_range(_with_maps(scene, materials[number], maps))
        lost += clipped
    corner_normals = None if normals is None or np.isnan(normals).all() else normals.astype(np.float32)
    mesh = MeshContents(
        positions=scene.positions,
        corners=scene.corners,
        offsets=scene.offsets,
        colours=np.empty((len(scene.positions), 0), np.float32),
        left_out=tuple(lost),
        uv=uv,
        materials=tuple(materials),
        material_of=scene.material_of.astype(np.int32),
        groups=groups[0],
        group_of=np.broadcast_to(groups[1], len(scene.offsets) - 1).astype(np.int32),
        corner_normals=corner_normals,
        source=PurePath(scene.name).stem,
        notices=scene.notices,
    )
    return _with_material_per_tile(mesh.polygons(kept))


def _with_material_per_tile(mesh: MeshContents) -> MeshContents:
    """Give each tile of a tile set a material of its own, and leave out unused materials."""
    assert mesh.uv is not None
    is_tiled = np.array([any(shown.image.tiles for shown in each.maps.values()) for each in mesh.materials])
    material_of, uv, materials = mesh.material_numbers.copy(), mesh.uv.copy(), list(mesh.materials)
    chosen = np.flatnonzero(is_tiled[material_of] & ~bare_polygons(mesh))
    polygon_of = polygons_of(mesh.offsets)
    sums = [np.bincount(polygon_of, column, len(mesh.sizes)) for column in uv.T]
    centres = (np.column_stack(sums) / mesh.sizes[:, None])[chosen]
    tiles = tiling.tiles_under(centres[:, None])
    moved = np.zeros((len(mesh.sizes), 2))
    moved[chosen] = np.column_stack([-tiles[:, 0], tiles[:, 1]])
    pairs = np.column_stack([material_of[chosen], tiles]).astype(np.int64)
    rows, number_of = np.unique(pairs, axis=0, return_inverse=True)
    for old, *place in rows.tolist():
        tile, material = (place[0], place[1]), mesh.materials[old]
        maps = {
            slot: dataclasses.replace(shown, image=image)
            for slot, shown in material.maps.items()
            if (image := dict(shown.image.tiles).get(tile) if shown.image.tiles else shown.image) is not None
        }
        name = tile_name(f"{material.name or 'tile'}_<UDIM>", tile)
        materials.append(dataclasses.replace(material, name=name, maps=maps))
    material_of[chosen] = len(mesh.materials) + number_of.reshape(-1)
    shown, material_of = shown_materials(materials, material_of)
    return dataclasses.replace(mesh, uv=uv + moved[polygon_of], materials=shown, material_of=material_of)


def _tiled_image(
    scene: Scene, path: str, of_tiles: Mapping[Tile, str], known: dict[str, MeshImage]
) -> MeshImage:
    """Return the image of a file or tile set."""
    if not of_tiles:
        return _image(scene, path, known)
    tiles = tuple((tile, _image(scene, file, known)) for tile, file in of_tiles.items())
    return dataclasses.replace(tiles[0][1], tiles=tiles)


def _image(scene: Scene, path: str, known: dict[str, MeshImage]) -> MeshImage:
    if path not in known:
        data, name = scene.read(path), scene.name_of(path)
        known[path] = MeshImage(ImageFile(data, suffix_for(data, name) or ".png"), name, path)
    return known[path]


def _with_maps(scene: Scene, material: Material, maps: MaterialMaps) -> Material:
    """Return a material with maps; the factors of these are white and 1 unless the scene has factors."""
    white, base = (1.0, 1.0, 1.0), maps.get("baseColor")
    new: dict[str, Any] = {"maps": maps}
    if not scene.has_factors:
        new |= {"colour": white} if base is not None else {}
        new |= {"emission": white} if "emissive" in maps else {}
        new |= {"metalness": 1.0, "roughness": 1.0} if "metallicRoughness" in maps else {}
        if material.alpha == "opaque" and base is not None:
            new["alpha"] = _alpha_mode(base.image.file.data, base.image.name)
    return dataclasses.replace(material, **new)


def _within_range(material: Material) -> tuple[Material, list[str]]:
    """Clip the factors of a material to the range that all formats give them; return also what that loses."""
    clipped: dict[str, Any] = {
        "colour": tuple(map(clipped_factor, material.colour)),
        "emission": tuple(map(clipped_factor, material.emission)),
        "opacity": clipped_factor(material.opacity),
        "metalness": clipped_factor(material.metalness),
        "roughness": clipped_factor(material.roughness),
    }
    lost = [
        f"{name} of materials outside 0 to 1"
        for name, value in clipped.items()
        if not np.allclose(value, getattr(material, name))
    ]
    return dataclasses.replace(material, **clipped), lost


def _common_coordinates(scene: Scene) -> tuple[Float64s, set[tuple[int, Slot]]]:
    """Return one set of texture coordinates, (K, 2), v down, and the materials and slots that need another set."""
    uv, elsewhere = np.full((len(scene.corners), 2), np.nan), set[tuple[int, Slot]]()
    material_of = scene.material_of[polygons_of(scene.offsets)]
    for slot in (*(slot for slot in SLOTS if any(slot in maps for maps in scene.maps)), None):
        fresh = np.isnan(uv).any(axis=1)
        if slot is None and not fresh.any():
            break
        own = scene.uv_down(slot)
        own = np.where(np.abs(own) < _MAX_COORDINATE, own, np.nan)
        has_map = np.array([slot is None or slot in maps for maps in scene.maps])[material_of]
        given = has_map & ~np.isnan(own).any(axis=1)
        if slot is not None:
            differs = given & ~fresh & (own != uv).any(axis=1)
            elsewhere |= {(number, slot) for number in np.unique(material_of[differs]).tolist()}
        np.copyto(uv, own, where=(given & fresh)[:, None])
    return uv, elsewhere


def _alpha_mode(data: bytes, name: str) -> AlphaMode:
    """Return the alpha mode of an image, for formats whose materials have none."""
    size = measure_image(data)
    if size is None or size.channels not in (2, 4):
        return "opaque"
    image = read_image(data, name, finite=False)
    opacity = image.pixels[..., image.alpha or 0]
    most = np.iinfo(opacity.dtype).max if opacity.dtype.kind == "u" else 1
    if image.alpha is None or not (opacity < most).any():
        return "opaque"
    return "mask" if np.isin(opacity, (0, most)).all() else "blend"
