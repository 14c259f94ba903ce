"""The triangles of an OBJ file with their texture coordinates, and the images of one slot."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.access import LARGE
from beltrami_cli.formats.model_folder import remedy_for
from beltrami_cli.formats.textured_mesh import SlotImages
from beltrami_cli.surface.polygons import triangulate_corners
from beltrami_cli.surface.records import TexturedSurface
from beltrami_cli.surface.tiling import TilingError, on_tiles

if TYPE_CHECKING:
    from beltrami_cli.arrays import Float64s, Int32s, Int64s
    from beltrami_cli.formats.model_folder import ModelFolder
    from beltrami_cli.formats.obj.materials import Materials
    from beltrami_cli.formats.obj.statements import Statements
    from beltrami_cli.surface.records import Slot, Wrap


@dataclass(frozen=True)
class Coordinates:
    """What an OBJ file says about textures, polygon by polygon."""

    values: Float64s  # (N, 2), the `vt` statements: u to the right, v up
    corners: Int64s  # (K,) row of `values` of every corner, -1 where it has none
    names: list[str]  # of materials
    material_of: Int64s  # (P,) index into `names` of every polygon, -1 where it has none


def read_coordinates(statements: Statements, materials: Materials) -> Coordinates:
    """Read texture coordinates and the materials of polygons."""
    given = statements.select(b"vt")
    tokens, offsets = statements.arguments(given)
    numbers = np.append(statements.finite_numbers(tokens), 0.0)
    sizes = np.diff(offsets)
    if (sizes == 0).any():
        bad = given[int(np.argmin(sizes))]
        raise statements.error(statements.heads[bad], "has no numbers behind it")
    values = np.column_stack([numbers[offsets[:-1]], numbers[np.where(sizes > 1, offsets[:-1] + 1, -1)]])
    corners, _, _ = statements.corners(b"vt")
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
    mesh: tuple[Float64s, Int32s, Int64s],
    coordinates: Coordinates,
    materials: Materials,
    folder: ModelFolder,
    slot: Slot,
    name: str,
) -> tuple[TexturedSurface, list[str]]:
    """Return all triangles, the images of one slot of their materials, and notices."""
    positions, corners, offsets = mesh
    palette = _Palette(materials, folder, slot, len(coordinates.names))
    for material in np.unique(coordinates.material_of).tolist():
        palette.take(material, coordinates.names[material] if material >= 0 else "")
    cut, polygon = triangulate_corners(positions, corners, offsets)
    material_of = coordinates.material_of[polygon]
    bare = (coordinates.corners[cut] < 0).any(axis=1)
    texture_of = np.where(bare, -1, palette.texture_of[material_of])
    if (texture_of == -1).all():
        raise InputError(name, *palette.excuse())
    uv = np.append(coordinates.values, [[0.0, 0.0]], axis=0)[coordinates.corners[cut]]
    with np.errstate(over="ignore", invalid="ignore"):
        uv = uv * palette.scale[material_of][:, None, :] + palette.offset[material_of][:, None, :]
    uv[:, :, 1] = 1 - uv[:, :, 1]
    if not np.isfinite(uv[texture_of != -1]).all():
        raise InputError(name, "the options of a texture map move texture coordinates to infinity")
    notices = palette.notices()
    lost = int(np.count_nonzero(bare & (palette.texture_of[material_of] != -1)))
    if lost:
        notices.append(f"{lost} triangles of textured materials have no texture coordinates.")
    surface = TexturedSurface(
        positions, corners[cut], uv, texture_of.astype(np.int32), palette.shown.textures()
    )
    try:
        return on_tiles(surface, palette.shown.sets), notices
    except TilingError as error:
        raise InputError(name, str(error), "check its texture coordinates") from error


class _Palette:
    """The images of one slot by material; arrays are indexed by material, -1 being the last row."""

    def __init__(self, materials: Materials, folder: ModelFolder, slot: Slot, count: int) -> None:
        self._materials, self._folder, self.slot = materials, folder, slot
        self.shown = SlotImages()
        self._missing: dict[str, list[str]] = {}
        self.texture_of = np.full(count + 1, -1, np.int64)
        self.scale, self.offset = np.ones((count + 1, 2)), np.zeros((count + 1, 2))

    def take(self, number: int, material: str) -> None:
        """Take up what a material has in the slot."""
        painting = self._materials.painting(material, self.slot)
        if painting is None:
            return
        found, path = painting
        is_tiled = path in self._materials.tiles
        files = [] if path is None else self._materials.files(path)
        files = [file for file in files if self._loaded(file, in_tiles=is_tiled)]
        if not files:
            self._missing.setdefault(found.name, []).append(material)
            return
        tiles = self._materials.tiles.get(path or "")
        wrap: Wrap = "clamp" if found.clamped or tiles else "repeat"
        number_of = {file: self.shown.show(file, material, (wrap, wrap)) for file in files}
        self.texture_of[number] = number_of[files[0]]
        if tiles:
            own = {tile: number_of[file] for tile, file in tiles.items() if file in number_of}
            self.texture_of[number] = self.shown.show_set(own)
        self.scale[number], self.offset[number] = found.scale, found.offset

    def _loaded(self, path: str, *, in_tiles: bool) -> bool:
        if path not in self.shown:
            try:
                data = self._folder.read(path)
            except OSError:
                return False
            content = partial(self._materials.read, path) if in_tiles or len(data) >= LARGE else data
            self.shown.take(path, path.rpartition("/")[2], content)
        return True

    def excuse(self) -> tuple[str, str]:
        """Return why no texture of the slot can be shown, and what can be done about it."""
        if len(self.shown):
            return f"it has a {self.slot} texture, but no texture coordinates for it", "export it with them"
        if self._missing:
            name = next(iter(self._missing))
            reason = self._materials.reason(name)
            return f"its {self.slot} texture '{name}' {reason}", remedy_for(reason)
        return f"it has no {self.slot} texture", ""

    def notices(self) -> list[str]:
        found = [
            f"The {self.slot} texture of {', '.join(map(repr, materials))} is left as it is: '{name}' "
            f"{self._materials.reason(name)}."
            for name, materials in self._missing.items()
        ]
        found += [
            f"'{path}' is used with several wrap modes; the first is followed."
            for path, _ in self.shown.mixed()
        ]
        return found
