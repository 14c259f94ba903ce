"""A whole OBJ file with its materials, for writing it in another format."""

from __future__ import annotations

import os
import re
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.image import read_image
from beltrami_cli.formats.obj.vertices import unit_normals
from beltrami_cli.formats.textured_mesh import (
    MeshImages,
    alpha_mode,
    on_tiles,
    shown_materials,
    usable_coordinates,
)
from beltrami_cli.surface.polygons import triangulate_corners
from beltrami_cli.surface.records import Material, MaterialMap, TexturedMesh

if TYPE_CHECKING:
    from beltrami_cli.arrays import Float32s, Int32s, Int64s
    from beltrami_cli.formats.obj.materials import Map, Materials
    from beltrami_cli.formats.obj.statements import Statements
    from beltrami_cli.formats.obj.texturing import Coordinates
    from beltrami_cli.formats.obj.vertices import Scan
    from beltrami_cli.surface.records import AlphaMode, Slot, Wrap

_SLOTS: tuple[Slot, ...] = ("baseColor", "emissive", "normal")
_VALUE = re.compile(rb"^[ \t]*+(newmtl|kd|ke|d|tr|pm|pr)[ \t]++([^\r\n]*[^\s])", re.IGNORECASE | re.MULTILINE)
_ALONG = ("map_ka", "map_d")  # which show the image of the base colour
_Placed = tuple[tuple[float, float], tuple[float, float]]  # scale and offset of texture coordinates


def read_textured_mesh(
    statements: Statements, scan: Scan, coordinates: Coordinates, materials: Materials, source: str
) -> TexturedMesh:
    """Return all triangles of a file, with their materials, groups, normals and texture coordinates."""
    cut, polygon = triangulate_corners(scan.vertices.positions, scan.corners, scan.offsets)
    if not len(cut):
        raise InputError(source, "it has no faces, so there is nothing to show a texture")
    reading = _Reading(materials)
    unnamed = len(coordinates.names)
    for name in [*coordinates.names, ""]:
        reading.take(name)
    numbers = np.where(coordinates.material_of < 0, unnamed, coordinates.material_of)[polygon]
    uv = np.append(coordinates.values, [[np.nan, np.nan]], axis=0)[coordinates.corners[cut]]
    scale, offset = (np.array(values)[numbers] for values in zip(*reading.placed, strict=True))
    with np.errstate(over="ignore", invalid="ignore"):
        uv = usable_coordinates(uv * scale[:, None] + offset[:, None])
    uv[..., 1] = 1 - uv[..., 1]
    shown, material_of = shown_materials(reading.materials, numbers)
    groups, group_of, lost = _groups(statements, polygon)
    lost += ["lines and points"] if "lines and points" in scan.dropped else []
    mesh = TexturedMesh(
        positions=scan.vertices.positions,
        faces=scan.corners[cut],
        uv=uv,
        materials=shown,
        images=tuple(reading.shown.images),
        source=source,
        material_of=material_of,
        groups=groups,
        group_of=group_of,
        normals=_normals(statements)[cut] if "normals" in scan.dropped else None,
        left_out=(*lost, *reading.left_out),
    )
    return on_tiles(mesh, reading.shown.sets)


class _Reading:
    """Materials and images while they are taken one by one."""

    def __init__(self, materials: Materials) -> None:
        self._materials = materials
        self._values = _read_values(materials)
        self.materials: list[Material] = []
        self.placed: list[_Placed] = []
        self.shown = MeshImages()
        self.left_out: list[str] = []

    def take(self, name: str) -> None:
        """Take a material, and the images that it shows."""
        found = {slot: painting for slot in _SLOTS if (painting := self._materials.painting(name, slot))}
        maps: dict[Slot, MaterialMap] = {}
        placed: _Placed | None = None
        for slot, (shown, path) in found.items():
            if path is None:
                self.left_out.append(f"the {slot} map '{shown.name}', which cannot be read")
            elif placed not in (None, (shown.scale, shown.offset)):
                self.left_out.append(f"{slot} maps that are placed otherwise than the base colour")
            elif slot == "normal" and shown.keyword != "norm" and self._is_grey(path):
                self.left_out.append("bump maps, which are heights and no normals")
            else:
                placed = shown.scale, shown.offset
                maps[slot] = MaterialMap(self._image(path), _wrap(shown))
        maps |= self._metal(name)
        base = maps.get("baseColor")
        image = None if base is None else self.shown.images[base.image]
        alpha = "opaque" if image is None else alpha_mode(image.file.data, image.name)
        self.materials.append(_material(name, self._values.get(name, {}), maps, alpha))
        self.placed.append(placed or ((1.0, 1.0), (0.0, 0.0)))

    def _maps(self, name: str) -> dict[str, tuple[Map, str]]:
        """Return the maps of a material with a file, by keyword."""
        return {
            shown.keyword: (shown, path)
            for library in self._materials.libraries
            for shown, path in library.maps
            if shown.material == name and path is not None
        }

    def _metal(self, name: str) -> dict[Slot, MaterialMap]:
        """Return the map of metalness and roughness, if one image has both; other maps are left out."""
        maps = self._maps(name)
        rough, metal = maps.pop("map_pr", None), maps.pop("map_pm", None)
        base = maps.get("map_kd", (None, None))[1]
        known = ("map_kd", "map_ke", "norm", "map_bump", "bump")
        self.left_out += [
            f"{keyword} maps"
            for keyword, (_, path) in maps.items()
            if keyword not in known and not (keyword in _ALONG and path == base)
        ]
        if rough and metal and rough[1] == metal[1] and (rough[0].channel, metal[0].channel) == ("g", "b"):
            return {"metallicRoughness": MaterialMap(self._image(rough[1]), _wrap(rough[0]))}
        lost = {"map_pr": rough, "map_pm": metal}
        self.left_out += [f"{keyword} maps in images of their own" for keyword, each in lost.items() if each]
        return {}

    def _image(self, path: str) -> int:
        if path in self._materials.tiles:
            tiles = {tile: self._image(file) for tile, file in self._materials.tiles[path].items()}
            return self.shown.take_set(path, tiles)
        return self.shown.take(path, path.rpartition("/")[2], lambda: self._materials.read(path))

    def _is_grey(self, path: str) -> bool:
        path = self._materials.files(path)[0]
        picture = read_image(self._materials.read(path), path, finite=False)
        colours = picture.pixels[..., list(picture.colour)]
        return bool((colours == colours[..., :1]).all())


def _wrap(shown: Map) -> tuple[Wrap, Wrap]:
    return ("clamp", "clamp") if shown.clamped else ("repeat", "repeat")


def _material(
    name: str, values: dict[str, list[float]], maps: dict[Slot, MaterialMap], alpha: AlphaMode
) -> Material:
    """Return a material; beside a map its colour counts as white, as programs have it whatever exporters write."""
    dark = [0.0, 0.0, 0.0]
    transparency = values.get("tr", [0.0])[0]
    # Some exporters write "Tr 1" for what is opaque; nobody exports what cannot be seen.
    opacity = min(max(values.get("d", [1 - transparency])[0], 0.0), 1.0) or 1.0
    return Material(
        name=name,
        maps=maps,
        colour=(1.0, 1.0, 1.0) if "baseColor" in maps else _colour(values.get("kd", [1.0, 1.0, 1.0])),
        emission=(1.0, 1.0, 1.0) if "emissive" in maps else _colour(values.get("ke", dark)),
        opacity=opacity,
        metalness=values.get("pm", [0.0])[0],
        roughness=values.get("pr", [1.0])[0],
        alpha="blend" if opacity < 1 else alpha,
    )


def _colour(numbers: list[float]) -> tuple[float, ...]:
    whole = numbers if len(numbers) >= 3 else [numbers[0]] * 3  # one number stands for three
    return tuple(min(max(value, 0.0), 1.0) for value in whole[:3])


def _read_values(materials: Materials) -> dict[str, dict[str, list[float]]]:
    """Read the numbers of all materials by their keywords; of two libraries the first that has a material counts."""
    found: dict[str, dict[str, list[float]]] = {}
    for library in reversed(materials.libraries):
        own: dict[str, list[float]] = {}
        for match in _VALUE.finditer(library.data):
            if match[1].lower() == b"newmtl":
                own = found[os.fsdecode(match[2])] = {}
            elif numbers := _numbers(match[2]):
                own[match[1].lower().decode("ascii")] = numbers
    return found


def _numbers(text: bytes) -> list[float]:
    try:
        values = [float(word) for word in text.split(b"#")[0].split()]
    except ValueError:  # a spectrum in a file, or another space of colours
        return []
    return values if np.isfinite(values).all() else []


def _normals(statements: Statements) -> Float32s:
    """Return the normals of all corners of polygons, NaN where there is none."""
    rows, _, _ = statements.corners(b"vn")
    values = np.append(unit_normals(statements), [[np.nan] * 3], axis=0)
    return values[rows].astype(np.float32)


def _groups(statements: Statements, polygon: Int64s) -> tuple[tuple[str, ...], Int32s, list[str]]:
    """Return the names of objects, or else of groups, which of them each triangle is in, and what is left out."""
    polygons = statements.select(b"f")
    given = {keyword: statements.select(keyword) for keyword in (b"o", b"g")}
    chosen = given[b"o"] if given[b"o"].size else given[b"g"]
    names = ["", *(os.fsdecode(statements.rest(each)[0]) for each in chosen.tolist())]
    known = {name: number for number, name in enumerate(dict.fromkeys(names))}
    numbers = np.array([known[name] for name in names], np.int32)
    lost = ["groups within objects"] if given[b"o"].size and len(given[b"g"]) > len(given[b"o"]) else []
    return tuple(known), numbers[np.searchsorted(chosen, polygons)][polygon], lost
