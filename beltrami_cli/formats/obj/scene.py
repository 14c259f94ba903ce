"""The polygons of an OBJ file with their texture coordinates, normals and materials."""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Float64s, Int32s, Int64s
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.meshes.scene import Maps, Scene, ShownMap
from beltrami_cli.formats.meshes.scene_mesh import textured_mesh
from beltrami_cli.formats.obj.materials import BASE_COLOUR_ALIASES, SLOTS, Map, Materials
from beltrami_cli.formats.obj.statements import Statements
from beltrami_cli.formats.obj.vertices import Scan
from beltrami_cli.surface.geometry import unit_vectors
from beltrami_cli.surface.records import MeshContents, Slot, Wrap

_Transform = tuple[tuple[float, float], tuple[float, float]]  # scale and offset of texture coordinates
_IDENTITY: _Transform = ((1.0, 1.0), (0.0, 0.0))
# The maps of a material, with their files if these can be used.
_MaterialMaps = dict[Slot, tuple[Map, str | None]]


@dataclass(frozen=True)
class Coordinates:
    """Texture coordinates and materials of the polygons of an OBJ file."""

    values: Float64s  # (N, 2), the `vt` statements: u to the right, v up
    corners: Int64s  # (K,) row of `values` of every corner, -1 where it has none, or none that is finite
    names: list[str]  # of materials
    material_of: Int64s  # (P,) index into `names` of every polygon, -1 where it has none


def read_coordinates(statements: Statements, materials: Materials) -> Coordinates:
    """Read texture coordinates and the materials of polygons."""
    given = statements.select(b"vt")
    tokens, offsets = statements.arguments(given)
    numbers = np.append(statements.numbers(tokens), 0.0)
    sizes = np.diff(offsets)
    if (sizes == 0).any():
        bad = given[int(np.argmin(sizes))]
        raise statements.error(statements.heads[bad], "has no numbers behind it")
    values = np.column_stack([numbers[offsets[:-1]], numbers[np.where(sizes > 1, offsets[:-1] + 1, -1)]])
    corners, _, _ = statements.corners(b"vt")
    unknown = ~np.isfinite(values).all(axis=1)
    corners[np.append(unknown, False)[corners]] = -1
    values[unknown] = 0
    names, material_of = _materials_of(statements, materials)
    return Coordinates(values, corners, names, material_of)


def _materials_of(statements: Statements, materials: Materials) -> tuple[list[str], Int64s]:
    """Return the names of `usemtl` statements, and the index of each polygon's name."""
    switches, polygons = statements.select(b"usemtl"), statements.select(b"f")
    texts = [statements.rest(switch)[0] for switch in switches]
    defined = {os.fsencode(name) for library in materials.libraries for name in library.materials}
    # Names may hold a "#", and a comment may follow them.
    meant = {text: text if text in defined else text.split(b"#")[0].strip() for text in set(texts)}
    numbers = {name: number for number, name in enumerate(sorted(set(meant.values())))}
    numbered = np.array([numbers[meant[text]] for text in texts] or [-1], np.int64)
    last = np.searchsorted(switches, polygons) - 1
    return [os.fsdecode(name) for name in numbers], np.where(last < 0, -1, numbered[np.maximum(last, 0)])


def read_scene(scan: Scan, coordinates: Coordinates, materials: Materials, name: str) -> Scene:
    """Return the polygons of a file with their materials; polygons without one have the last."""
    names = (*coordinates.names, "")
    maps_of = [materials.maps_of(material) for material in names]
    unnamed, numbers = len(coordinates.names), coordinates.material_of
    material_of = np.where(numbers < 0, unnamed, numbers)

    def uv(slot: Slot | None) -> Float64s:
        values = np.append(coordinates.values, [[np.nan, np.nan]], axis=0)[coordinates.corners]
        shown = [maps[slot][0] if slot is not None and slot in maps else None for maps in maps_of]
        placed = [_IDENTITY if each is None else (each.scale, each.offset) for each in shown]
        if {*placed} != {_IDENTITY}:
            of_corner = np.repeat(material_of, np.diff(scan.offsets))
            scale, offset = (np.array(each)[of_corner] for each in zip(*placed, strict=True))
            with np.errstate(over="ignore", invalid="ignore"):
                values = values * scale + offset
        return values

    return Scene(
        name=name,
        positions=scan.vertices.positions,
        corners=scan.corners,
        offsets=scan.offsets,
        material_of=material_of,
        materials=[materials.material(name) for name in names],
        maps=[_shown(maps, materials) for maps in maps_of],
        uv=uv,
        read=materials.folder.content,
        measured=scan.vertices.finite,
    )


def _shown(maps: _MaterialMaps, materials: Materials) -> Maps:
    wraps: dict[bool, tuple[Wrap, Wrap]]
    wraps = {True: ("clamp", "clamp"), False: ("repeat", "repeat")}
    return {
        slot: ShownMap(
            each.name,
            path,
            materials.obstacle(each.name),
            wraps[each.clamped],
            tiles=materials.folder.tiles_of(path),
        )
        for slot, (each, path) in maps.items()
    }


def convert(scene: Scene, statements: Statements, scan: Scan, materials: Materials) -> MeshContents:
    """Return a scene with groups, normals and the maps that other formats support."""
    groups, group_of, lost = _groups(statements)
    lost += ["lines and points"] if "lines and points" in scan.dropped else []
    maps = [_shown(_converted_maps(materials, each.name, lost), materials) for each in scene.materials]
    normals = None
    if "normals" in scan.dropped:
        rows, _, _ = statements.corners(b"vn")
        normals = np.append(_unit_normals(statements), [[np.nan] * 3], axis=0)[rows]
    return textured_mesh(dataclasses.replace(scene, maps=maps), lost, (groups, group_of), normals)


def _converted_maps(materials: Materials, name: str, left_out: list[str]) -> _MaterialMaps:
    """Return the maps of a material that other formats support, and record the others."""
    kept = materials.maps_of(name)
    normal, path = kept.get("normal", (None, None))
    if normal is not None and path is not None and normal.keyword != "norm" and _is_grey(materials, path):
        left_out.append("bump maps, which are heights and no normals")
        del kept["normal"]
    entries = (each for library in materials.libraries for each in library.maps)
    maps = {
        shown.keyword: (shown, path) for shown, path in entries if shown.material == name and path is not None
    }
    rough, metal = maps.pop("map_pr", None), maps.pop("map_pm", None)
    base = maps.get("map_kd", (None, None))[1]
    left_out += [
        f"{keyword} maps"
        for keyword, (_, path) in maps.items()
        if keyword not in SLOTS and not (keyword in BASE_COLOUR_ALIASES and path == base)
    ]
    # One image has both metalness and roughness; other maps are left out.
    if rough and metal and rough[1] == metal[1] and (rough[0].channel, metal[0].channel) == ("g", "b"):
        return kept | {"metallicRoughness": rough}
    lost = {"map_pr": rough, "map_pm": metal}
    left_out += [f"{keyword} maps in images of their own" for keyword, each in lost.items() if each]
    return kept


def _is_grey(materials: Materials, path: str) -> bool:
    file = materials.folder.files(path)[0]
    image = read_image(materials.folder.content(file), file, finite=False)
    colours = image.pixels[..., list(image.colour)]
    return bool((colours == colours[..., :1]).all())


def _groups(statements: Statements) -> tuple[tuple[str, ...], Int64s, list[str]]:
    """Return the names of objects, or else of groups, which of them each polygon is in, and notices of losses."""
    polygons = statements.select(b"f")
    given = {keyword: statements.select(keyword) for keyword in (b"o", b"g")}
    chosen = given[b"o"] if given[b"o"].size else given[b"g"]
    names = ["", *(os.fsdecode(statements.rest(each)[0]) for each in chosen.tolist())]
    number_of = {name: number for number, name in enumerate(dict.fromkeys(names))}
    numbers = np.array([number_of[name] for name in names])
    lost = ["groups within objects"] if given[b"o"].size and len(given[b"g"]) > len(given[b"o"]) else []
    return tuple(number_of), numbers[np.searchsorted(chosen, polygons)], lost


def read_normals(statements: Statements, corners: Int32s, count: int) -> Float64s:
    """Read the unit normals of all vertices, shape (count, 3); NaN where no corner of a vertex has one."""
    values = _unit_normals(statements)
    rows, tokens, _ = statements.corners(b"vn")
    given = rows >= 0
    normals = np.full((count, 3), np.nan)
    vertices, directions = corners[given], values[rows[given]]
    normals[vertices[::-1]] = directions[::-1]  # in reverse, so that the first normal of a vertex is kept
    differs = (normals[vertices] != directions).any(axis=1)
    if differs.any():
        token = tokens[given][int(np.argmax(differs))]
        raise statements.error(token, "has another normal than an earlier corner of the same vertex")
    return normals


def _unit_normals(statements: Statements) -> Float64s:
    """Return all `vn` statements as unit vectors, shape (N, 3)."""
    chosen = statements.select(b"vn")
    tokens, offsets = statements.arguments(chosen)
    wrong = np.diff(offsets) != 3
    if wrong.any():
        head = statements.heads[chosen[int(np.argmax(wrong))]]
        raise statements.error(head, "has not three numbers behind it")
    values = statements.numbers(tokens)
    statements.require_finite(tokens, values, np.arange(len(tokens)))
    return unit_vectors(values.reshape(-1, 3))
