"""The triangles of an OBJ file with their texture coordinates: under the images of one slot, and with all materials."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s, Int32s, Int64s
from beltrami_cli.errors import InputError
from beltrami_cli.formats import textured_mesh
from beltrami_cli.formats.image import read_image
from beltrami_cli.formats.obj.materials import ALONG, PAINTED, SLOTS, Map, Materials
from beltrami_cli.formats.obj.statements import Scan, Statements, unit_normals
from beltrami_cli.surface import records, tiling
from beltrami_cli.surface.geometry import triangulate_corners


@dataclass(frozen=True)
class Coordinates:
    """What an OBJ file says about textures, polygon by polygon."""

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
    """Return all names behind `usemtl`, and which of them holds for each polygon."""
    switches, polygons = statements.select(b"usemtl"), statements.select(b"f")
    texts = [statements.rest(switch)[0] for switch in switches]
    known = {os.fsencode(name) for library in materials.libraries for name in library.materials}
    # Names may hold a "#", and a comment may follow them.
    meant = {text: text if text in known else text.split(b"#")[0].strip() for text in set(texts)}
    numbers = {name: number for number, name in enumerate(sorted(set(meant.values())))}
    numbered = np.array([numbers[meant[text]] for text in texts] or [-1], np.int64)
    last = np.searchsorted(switches, polygons) - 1
    return [os.fsdecode(name) for name in numbers], np.where(last < 0, -1, numbered[np.maximum(last, 0)])


def gather_textured(
    scan: Scan, coordinates: Coordinates, materials: Materials, slot: records.Slot, name: str
) -> tuple[records.TexturedSurface, list[str]]:
    """Return all triangles, the images of one slot of their materials, and notices."""
    positions, corners = scan.vertices.positions, scan.corners
    palette = _Palette(materials, slot, len(coordinates.names))
    for material in np.unique(coordinates.material_of).tolist():
        palette.take(material, coordinates.names[material] if material >= 0 else "")
    cut, polygon = _triangles(scan)
    material_of = coordinates.material_of[polygon]
    bare = (coordinates.corners[cut] < 0).any(axis=1)
    texture_of = np.where(bare, -1, palette.texture_of[material_of])
    if (texture_of == -1).all():
        raise palette.shown.refusal(name, is_bare=len(palette.shown) > 0, why=palette.undefined)
    uv = np.append(coordinates.values, [[0.0, 0.0]], axis=0)[coordinates.corners[cut]]
    with np.errstate(over="ignore", invalid="ignore"):
        uv = uv * palette.scale[material_of][:, None, :] + palette.offset[material_of][:, None, :]
    uv[:, :, 1] = 1 - uv[:, :, 1]
    if not np.isfinite(uv[texture_of != -1]).all():
        raise InputError(name, "the options of a texture map move texture coordinates to infinity")
    notices = palette.shown.notices()
    lost = int(np.count_nonzero(bare & (palette.texture_of[material_of] != -1)))
    if lost:
        notices.append(f"{lost} triangles of textured materials have no texture coordinates.")
    texture_of, textures = texture_of.astype(np.int32), palette.shown.textures()
    surface = records.TexturedSurface(positions, corners[cut], uv, texture_of, textures)
    if palette.shown.sets:
        surface = tiling.on_tiles(surface, palette.shown.sets, name)
    return surface, notices


def _triangles(scan: Scan) -> tuple[Int32s, Int64s]:
    """Return indices into corners, and polygons, of the triangles whose vertices all have a position."""
    cut, polygon = triangulate_corners(scan.vertices.positions, scan.corners, scan.offsets)
    kept = scan.vertices.finite[scan.corners[cut]].all(axis=1)
    return (cut, polygon) if kept.all() else (cut[kept], polygon[kept])


class _Palette:
    """The images of one slot by material; arrays are indexed by material, -1 being the last row."""

    def __init__(self, materials: Materials, slot: records.Slot, count: int) -> None:
        self._materials, self._slot = materials, slot
        self.shown = textured_mesh.SlotImages(slot)
        self.texture_of = np.full(count + 1, -1, np.int64)
        self.undefined = ""  # why a material is not known
        self.scale, self.offset = np.ones((count + 1, 2)), np.zeros((count + 1, 2))

    def take(self, number: int, material: str) -> None:
        """Take up what a material has in the slot."""
        painting = self._materials.painting(material, self._slot)
        if painting is None:
            if material and not any(material in library.materials for library in self._materials.libraries):
                self.undefined = f"no library has its material '{material}'"
            return
        found, path = painting
        folder, shown = self._materials.folder, None
        if path is not None:
            known = path, folder.tiles, material, _wrap(found), folder.content
            shown = self.shown.show_files(*known, left_out=(InputError,))
        if shown is None:
            self.shown.miss(f"'{found.name}' {self._materials.reason(found.name)}", material)
            return
        self.texture_of[number] = shown
        self.scale[number], self.offset[number] = found.scale, found.offset


_VALUE = re.compile(
    rb"^(?:\xef\xbb\xbf)?[ \t]*+(newmtl|kd|ke|d|tr|pm|pr)[ \t]++([^\r\n]*[^\s])", re.IGNORECASE | re.MULTILINE
)
_Placed = tuple[tuple[float, float], tuple[float, float]]  # scale and offset of texture coordinates


def read_textured_mesh(
    statements: Statements, scan: Scan, coordinates: Coordinates, materials: Materials, source: str
) -> records.TexturedMesh:
    """Return all triangles of a file, with their materials, groups, normals and texture coordinates."""
    cut, polygon = _triangles(scan)
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
        uv = textured_mesh.usable_coordinates(uv * scale[:, None] + offset[:, None])
    uv[..., 1] = 1 - uv[..., 1]
    shown, material_of = textured_mesh.shown_materials(reading.materials, numbers)
    groups, group_of, lost = _groups(statements, polygon)
    lost += ["lines and points"] if "lines and points" in scan.dropped else []
    mesh = records.TexturedMesh(
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
    return textured_mesh.on_tiles(mesh, reading.shown.sets)


class _Reading:
    """Materials and images while they are taken one by one."""

    def __init__(self, materials: Materials) -> None:
        self._materials = materials
        self._values = _read_values(materials)
        self.materials: list[records.Material] = []
        self.placed: list[_Placed] = []
        self.shown = textured_mesh.MeshImages()
        self.left_out: list[str] = []

    def take(self, name: str) -> None:
        """Take a material, and the images that it shows."""
        found = {slot: painting for slot in PAINTED if (painting := self._materials.painting(name, slot))}
        maps: dict[records.Slot, records.MaterialMap] = {}
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
                maps[slot] = records.MaterialMap(self._image(path), _wrap(shown))
        maps |= self._metal(name)
        base = maps.get("baseColor")
        image = None if base is None else self.shown.images[base.image]
        alpha = "opaque" if image is None else textured_mesh.alpha_mode(image.file.data, image.name)
        self.materials.append(_material(name, self._values.get(name, {}), maps, alpha))
        self.placed.append(placed or ((1.0, 1.0), (0.0, 0.0)))

    def _metal(self, name: str) -> dict[records.Slot, records.MaterialMap]:
        # One image has both metalness and roughness; other maps are left out.
        known = ((shown, path) for library in self._materials.libraries for shown, path in library.maps)
        maps = {
            shown.keyword: (shown, path)
            for shown, path in known
            if shown.material == name and path is not None
        }
        rough, metal = maps.pop("map_pr", None), maps.pop("map_pm", None)
        base = maps.get("map_kd", (None, None))[1]
        self.left_out += [
            f"{keyword} maps"
            for keyword, (_, path) in maps.items()
            if keyword not in SLOTS and not (keyword in ALONG and path == base)
        ]
        if rough and metal and rough[1] == metal[1] and (rough[0].channel, metal[0].channel) == ("g", "b"):
            return {"metallicRoughness": records.MaterialMap(self._image(rough[1]), _wrap(rough[0]))}
        lost = {"map_pr": rough, "map_pm": metal}
        self.left_out += [f"{keyword} maps in images of their own" for keyword, each in lost.items() if each]
        return {}

    def _image(self, path: str) -> int:
        return self.shown.take_file(path, self._materials.folder.tiles, self._materials.folder.content)

    def _is_grey(self, path: str) -> bool:
        file = self._materials.folder.files(path)[0]
        picture = read_image(self._materials.folder.content(file), file, finite=False)
        colours = picture.pixels[..., list(picture.colour)]
        return bool((colours == colours[..., :1]).all())


def _wrap(shown: Map) -> tuple[records.Wrap, records.Wrap]:
    return ("clamp", "clamp") if shown.clamped else ("repeat", "repeat")


def _material(
    name: str,
    values: dict[str, list[float]],
    maps: dict[records.Slot, records.MaterialMap],
    alpha: records.AlphaMode,
) -> records.Material:
    """Return a material; with a map its colour counts as white, as in other programs."""
    dark = [0.0, 0.0, 0.0]
    transparency = values.get("tr", [0.0])[0]
    # Some exporters write "Tr 1" for opaque materials; fully transparent ones are not exported.
    opacity = min(max(values.get("d", [1 - transparency])[0], 0.0), 1.0) or 1.0
    return records.Material(
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
    rows, _, _ = statements.corners(b"vn")
    values = np.append(unit_normals(statements), [[np.nan] * 3], axis=0)
    return values[rows].astype(np.float32)


def _groups(statements: Statements, polygon: Int64s) -> tuple[tuple[str, ...], Int32s, list[str]]:
    """Return the names of objects, or else of groups, which of them each triangle is in, and notices of losses."""
    polygons = statements.select(b"f")
    given = {keyword: statements.select(keyword) for keyword in (b"o", b"g")}
    chosen = given[b"o"] if given[b"o"].size else given[b"g"]
    names = ["", *(os.fsdecode(statements.rest(each)[0]) for each in chosen.tolist())]
    known = {name: number for number, name in enumerate(dict.fromkeys(names))}
    numbers = np.array([known[name] for name in names], np.int32)
    lost = ["groups within objects"] if given[b"o"].size and len(given[b"g"]) > len(given[b"o"]) else []
    return tuple(known), numbers[np.searchsorted(chosen, polygons)][polygon], lost
