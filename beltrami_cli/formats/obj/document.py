"""OBJ files whose vertex colours and textures can be replaced, every other byte staying as it is."""

from __future__ import annotations

import codecs
import dataclasses
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s, Int32s, Int64s
from beltrami_cli.errors import InputError, Obstacle, UnpaintedError
from beltrami_cli.formats.changes import Changes, Naming, PlannedImages, Written
from beltrami_cli.formats.colours import full_scale, opacity
from beltrami_cli.formats.comparison import Fingerprint, labelled
from beltrami_cli.formats.conversion import with_vertex_colours
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image import read_image
from beltrami_cli.formats.model_folder import ModelFolder
from beltrami_cli.formats.obj.materials import ALONG, SLOTS, Map, Materials, renaming
from beltrami_cli.formats.obj.statements import (
    Scan,
    Statements,
    among,
    new_positions,
    read_normals,
    repainted_entries,
    scan_file,
    unit_normals,
)
from beltrami_cli.formats.textured_mesh import Maps, Scene, ShownMap
from beltrami_cli.formats.tokens import (
    PLACEHOLDER,
    Spans,
    exchange_spans,
    new_colours,
    renumbered,
    shifted,
    without_tokens,
    zeroed,
)
from beltrami_cli.surface.records import Material, MeshContents, Slot, Wrap

_STALE = "The vertices moved, but the normals ('vn') are as they were; make them again, or leave them out."
_BYTES_OF_POLYPAINT = 6  # behind two digits of the mask
_VALUE = re.compile(
    rb"^(?:\xef\xbb\xbf)?[ \t]*+(newmtl|kd|ke|d|tr|pm|pr)[ \t]++([^\r\n]*[^\s])", re.IGNORECASE | re.MULTILINE
)

_Placed = tuple[tuple[float, float], tuple[float, float]]  # scale and offset of texture coordinates
_AS_THEY_ARE: _Placed = ((1.0, 1.0), (0.0, 0.0))
# The maps of a material, with their files if these can be used.
_Found = dict[Slot, tuple[Map, str | None]]


class ObjDocument(Document):
    """A Wavefront OBJ file with colours behind the positions of its vertices."""

    format: ClassVar[str] = "obj"

    def _open(self, folder: Path | None) -> None:
        if self.data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            raise InputError(self.name, "it is text in UTF-16", "save it as UTF-8")
        self._folder = ModelFolder(folder, self.access)

    @cached_property
    def _mesh(self) -> MeshContents:
        colours, vertices = self._colours, self._scan.vertices
        positions = vertices.positions[vertices.coloured]
        return MeshContents(positions, *self._polygons, colours, "srgb", self._stored)

    @property
    def _stored(self) -> str:
        return "text" if self._scan.polypaint is None else "uint8"

    def has_vertex_colours(self) -> bool:
        return bool(self._scan.vertices.coloured.size)

    def slots(self) -> tuple[Slot, ...]:
        slots = self._materials.slots()
        if not slots:
            self._forget_statements()
        return slots

    @cached_property
    def _scene(self) -> Scene:
        scene = _read_scene(self._scan, self._coordinates, self._materials, self.name)
        self._forget_statements()
        return scene

    def _undefined(self) -> Obstacle | None:
        defined = set[str]().union(*(library.materials for library in self._materials.libraries))
        unknown = next((name for name in self._coordinates.names if name not in defined), None)
        if unknown is None:
            return None
        remedy = "correct the name at usemtl, or name the library that has it at mtllib"
        return Obstacle(f"no library has its material '{unknown}'", remedy)

    def _patched(self, new: Changes, naming: Naming) -> Written:
        colours, places = new.colours, new.places
        renamed = renaming(self._materials, new.images, self.name, naming)
        sidecars, spans = renamed.written(), renamed.spans
        data = exchange_spans(self.data, spans)
        known, paint = self._scan.vertices, self._scan.polypaint
        starts, ends = (shifted(tokens, spans) for tokens in (known.token_starts, known.token_ends))
        parts = []
        if colours is not None:
            if paint is not None:
                changed = colours != self._colours
                data = repainted_entries(data, shifted(paint.starts, spans), colours, changed)
            else:
                both = self._colours, colours
                parts.append(new_colours(data, starts[:, 3:], ends[:, 3:], *both, self._scale))
        if places is not None:
            changed = places.positions != known.positions[known.coloured]
            parts.append(new_positions(data, starts[:, :3], ends[:, :3], places.positions, changed))
        notices = (_STALE,) if places is not None and "normal" in self.attributes() else ()
        main = renumbered(data, parts) if parts else [data]
        return dataclasses.replace(sidecars, main=main, notices=(*sidecars.notices, *notices))

    def sidecar_names(self, images: PlannedImages, naming: Naming, **_: object) -> list[str]:
        return renaming(self._materials, images, self.name, naming).sidecar_names

    def require_movable(self) -> None:
        """Check nothing: any number can be exchanged in a text."""

    def has_normals_by_vertex(self) -> bool:
        """Return False: normals are not of vertices, but of the corners of polygons."""
        return False

    def attributes(self) -> tuple[str, ...]:
        return ("normal",) if "normals" in self._scan.dropped else ()

    def _attribute(self, name: str) -> Float64s:
        vertices = self._scan.vertices
        normals = read_normals(self._statements, self._scan.corners, len(vertices.positions))[
            vertices.coloured
        ]
        self._forget_statements()
        if np.isnan(normals).any():
            row = int(vertices.coloured[int(np.argmax(np.isnan(normals).any(axis=1)))])
            raise InputError(self.name, f"vertex {row + 1} has no normal, so normals cannot guide")
        return normals

    def references(self) -> Sequence[str]:
        return self._materials.paths

    def contents(self) -> MeshContents:
        return dataclasses.replace(self._mesh, alpha=self._alpha(), left_out=self._scan.dropped)

    def textured_mesh(self, colours: Float32s | None = None) -> MeshContents:
        return with_vertex_colours(self._converted, self, colours)

    @cached_property
    def _converted(self) -> MeshContents:
        mesh = _convert(self._scene, self._statements, self._scan, self._materials)
        self._forget_statements()
        return mesh

    def _alpha(self) -> Float32s | None:
        alpha = self._scan.vertices.alpha
        return None if alpha is None else opacity(alpha, self._scale)

    def fingerprint(self) -> Fingerprint:
        data, libraries, vertices = self.data, self._materials.libraries, self._scan.vertices
        mentions: Spans = {(a, b): PLACEHOLDER for library in libraries for _, a, b in library.mentions}
        colours = {"vertex colours": self._colours} if self.has_vertex_colours() else {}
        if self._scan.polypaint is not None:
            data = zeroed(data, self._scan.polypaint.starts + 2, _BYTES_OF_POLYPAINT)
        text = exchange_spans(data, mentions)
        if colours and self._scan.polypaint is None:
            tokens = vertices.token_starts, vertices.token_ends
            starts, ends = (np.sort(shifted(places[:, 3:].ravel(), mentions)) for places in tokens)
            text = without_tokens(text, starts, ends)
        parts, paintings, folder = {"statements": text}, dict[str, str](), self._folder
        for number, library in enumerate(libraries, 1):
            there = [found for found, path in library.maps if path is not None]
            names: Spans = {(found.start, found.end): PLACEHOLDER for found in there}
            parts[f"material library {number}"] = exchange_spans(library.data, names)
            for index, (found, path) in enumerate(library.maps, 1):
                label = f"material {found.material!r}, {found.keyword} ({number}.{index})"
                tiles = folder.tiles.get(path or "", {})
                paintings |= {f"{label}, tile {tile}": file for tile, file in tiles.items()}
                paintings |= {label: path} if path is not None and not tiles else {}
        return Fingerprint(parts, colours, labelled(paintings, folder.content))

    def facts(self) -> dict[str, object]:
        return {
            "format": self.format,
            "vertices": len(self._scan.vertices.positions),
            "coloured_vertices": len(self._scan.vertices.coloured),
            "polygons": len(self._scan.offsets) - 1,
            "material_libraries": len(self._scan.libraries),
            "other": list(self._scan.dropped),
        }

    @cached_property
    def _statements(self) -> Statements:
        """Its text in tokens, which take several times the memory of the text: until all that a run needs is read."""
        return Statements(self.data, self.name)

    def _forget_statements(self) -> None:
        self.__dict__.pop("_statements", None)

    @cached_property
    def _scan(self) -> Scan:
        scan = scan_file(self._statements)
        self.notices += scan.notices
        if not scan.libraries:
            self._forget_statements()
        return scan

    @cached_property
    def _polygons(self) -> tuple[Int32s, Int64s]:
        vertices = self._scan.vertices
        if len(vertices.coloured) == len(vertices.positions):
            return self._scan.corners, self._scan.offsets
        return among(self._scan.corners, self._scan.offsets, vertices.coloured, len(vertices.positions))

    @cached_property
    def _colours(self) -> Float32s:
        return (self._scan.vertices.colours / self._scale).astype(np.float32)

    @cached_property
    def _scale(self) -> float:
        vertices = self._scan.vertices
        if not vertices.coloured.size:
            cause = "there are no vertex colours on its 'v' lines"
            cause += ", only materials" if self._scan.libraries else ""
            raise UnpaintedError(self.name, cause, "export the mesh with vertex colours (v x y z r g b)")
        if self._scan.polypaint is not None:
            return 255.0
        scale, notice = full_scale(vertices.colours, self.name)
        self.notices += [sentence for sentence in (vertices.notice, notice) if sentence]
        return scale

    @cached_property
    def _materials(self) -> Materials:
        materials = Materials(self._folder, self._scan.libraries)
        self.notices += materials.notices
        self.obstacles += materials.obstacles
        return materials

    @cached_property
    def _coordinates(self) -> _Coordinates:
        return _read_coordinates(self._statements, self._materials)


@dataclass(frozen=True)
class _Coordinates:
    """What an OBJ file says about textures, polygon by polygon."""

    values: Float64s  # (N, 2), the `vt` statements: u to the right, v up
    corners: Int64s  # (K,) row of `values` of every corner, -1 where it has none, or none that is finite
    names: list[str]  # of materials
    material_of: Int64s  # (P,) index into `names` of every polygon, -1 where it has none


def _read_coordinates(statements: Statements, materials: Materials) -> _Coordinates:
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
    return _Coordinates(values, corners, names, material_of)


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


def _read_scene(scan: Scan, coordinates: _Coordinates, materials: Materials, name: str) -> Scene:
    """Return the polygons of a file with their materials; polygons without one have the last."""
    names, values = (*coordinates.names, ""), _read_values(materials)
    found = [materials.paintings(material) for material in names]
    unnamed, known = len(coordinates.names), coordinates.material_of
    material_of = np.where(known < 0, unnamed, known)

    def uv(slot: Slot | None) -> Float64s:
        values = np.append(coordinates.values, [[np.nan, np.nan]], axis=0)[coordinates.corners]
        shown = [maps[slot][0] if slot is not None and slot in maps else None for maps in found]
        placed = [_AS_THEY_ARE if each is None else (each.scale, each.offset) for each in shown]
        if {*placed} != {_AS_THEY_ARE}:
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
        materials=[_material(name, values.get(name, {})) for name in names],
        maps=[_shown(maps, materials) for maps in found],
        uv=uv,
        tiles=materials.folder.tiles,
        read=materials.folder.content,
        measured=scan.vertices.finite,
    )


def _shown(maps: _Found, materials: Materials) -> Maps:
    wraps: dict[bool, tuple[Wrap, Wrap]]
    wraps = {True: ("clamp", "clamp"), False: ("repeat", "repeat")}
    return {
        slot: ShownMap(each.name, path, materials.obstacle(each.name), wraps[each.clamped])
        for slot, (each, path) in maps.items()
    }


def _convert(scene: Scene, statements: Statements, scan: Scan, materials: Materials) -> MeshContents:
    """Return a scene with groups, normals and the maps that other formats can have."""
    groups, group_of, lost = _groups(statements)
    lost += ["lines and points"] if "lines and points" in scan.dropped else []
    maps = [_shown(_converted_maps(materials, each.name, lost), materials) for each in scene.materials]
    normals = None
    if "normals" in scan.dropped:
        rows, _, _ = statements.corners(b"vn")
        normals = np.append(unit_normals(statements), [[np.nan] * 3], axis=0)[rows]
    return dataclasses.replace(scene, maps=maps).mesh(lost, (groups, group_of), normals)


def _converted_maps(materials: Materials, name: str, left_out: list[str]) -> _Found:
    """Return the maps of a material that other formats can have, and note the others."""
    found = materials.paintings(name)
    normal, path = found.get("normal", (None, None))
    if normal is not None and path is not None and normal.keyword != "norm" and _is_grey(materials, path):
        left_out.append("bump maps, which are heights and no normals")
        del found["normal"]
    known = (each for library in materials.libraries for each in library.maps)
    maps = {
        shown.keyword: (shown, path) for shown, path in known if shown.material == name and path is not None
    }
    rough, metal = maps.pop("map_pr", None), maps.pop("map_pm", None)
    base = maps.get("map_kd", (None, None))[1]
    left_out += [
        f"{keyword} maps"
        for keyword, (_, path) in maps.items()
        if keyword not in SLOTS and not (keyword in ALONG and path == base)
    ]
    # One image has both metalness and roughness; other maps are left out.
    if rough and metal and rough[1] == metal[1] and (rough[0].channel, metal[0].channel) == ("g", "b"):
        return found | {"metallicRoughness": rough}
    lost = {"map_pr": rough, "map_pm": metal}
    left_out += [f"{keyword} maps in images of their own" for keyword, each in lost.items() if each]
    return found


def _is_grey(materials: Materials, path: str) -> bool:
    file = materials.folder.files(path)[0]
    picture = read_image(materials.folder.content(file), file, finite=False)
    colours = picture.pixels[..., list(picture.colour)]
    return bool((colours == colours[..., :1]).all())


def _material(name: str, values: dict[str, list[float]]) -> Material:
    dark = [0.0, 0.0, 0.0]
    transparency = values.get("tr", [0.0])[0]
    # Some exporters write "Tr 1" for opaque materials; fully transparent ones are not exported.
    opacity = min(max(values.get("d", [1 - transparency])[0], 0.0), 1.0) or 1.0
    return Material(
        name=name,
        colour=_colour(values.get("kd", [1.0, 1.0, 1.0])),
        emission=_colour(values.get("ke", dark)),
        opacity=opacity,
        metalness=values.get("pm", [0.0])[0],
        roughness=values.get("pr", [1.0])[0],
        alpha="blend" if opacity < 1 else "opaque",
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


def _groups(statements: Statements) -> tuple[tuple[str, ...], Int64s, list[str]]:
    """Return the names of objects, or else of groups, which of them each polygon is in, and notices of losses."""
    polygons = statements.select(b"f")
    given = {keyword: statements.select(keyword) for keyword in (b"o", b"g")}
    chosen = given[b"o"] if given[b"o"].size else given[b"g"]
    names = ["", *(os.fsdecode(statements.rest(each)[0]) for each in chosen.tolist())]
    known = {name: number for number, name in enumerate(dict.fromkeys(names))}
    numbers = np.array([known[name] for name in names])
    lost = ["groups within objects"] if given[b"o"].size and len(given[b"g"]) > len(given[b"o"]) else []
    return tuple(known), numbers[np.searchsorted(chosen, polygons)], lost
