"""The triangles of an OBJ file with their texture coordinates, and the images of one slot."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.model_folder import remedy_for
from beltrami_cli.surface.polygons import triangulate_corners
from beltrami_cli.surface.records import Texture, TexturedSurface

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.model_folder import ModelFolder
    from beltrami_cli.formats.obj.materials import Materials
    from beltrami_cli.formats.obj.statements import Statements
    from beltrami_cli.surface.records import Slot, Wrap


@dataclass(frozen=True)
class Coordinates:
    """What an OBJ file says about textures, polygon by polygon.

    Attributes
    ----------
    values : ndarray of float64, shape (N, 2)
        The `vt` statements: u to the right, v up.
    corners : ndarray of int64, shape (K,)
        Row of `values` of every corner, -1 where it has none.
    names : list of str
        Materials.
    material_of : ndarray of int64, shape (P,)
        Index into `names` for every polygon, -1 where it has none.
    """

    values: NDArray[np.float64]
    corners: NDArray[np.int64]
    names: list[str]
    material_of: NDArray[np.int64]


def read_coordinates(statements: Statements, materials: Materials) -> Coordinates:
    """Read texture coordinates and the materials of polygons.

    Raises
    ------
    InputError
        If an index is none or out of range, or a coordinate is not a finite number, with the line.
    """
    given, polygons = statements.select(b"vt"), statements.select(b"f")
    tokens, offsets = statements.arguments(given)
    numbers = np.append(statements.numbers(tokens), 0.0)
    sizes = np.diff(offsets)
    if (sizes == 0).any():
        bad = given[int(np.argmin(sizes))]
        raise statements.error(statements.heads[bad], "has no numbers behind it")
    if not np.isfinite(numbers).all():
        raise statements.error(tokens[int(np.argmin(np.isfinite(numbers)))], "is not a finite number")
    values = np.column_stack([numbers[offsets[:-1]], numbers[np.where(sizes > 1, offsets[:-1] + 1, -1)]])
    corner_tokens, corner_offsets = statements.arguments(polygons)
    before = np.repeat(np.searchsorted(given, polygons), np.diff(corner_offsets))
    index = statements.second_indices(corner_tokens)
    corners = np.where(index < 0, before + index, index - 1)
    outside = (index != 0) & ((corners < 0) | (corners >= len(given)))
    if outside.any():
        cause = f"refers to no texture coordinates, of which there are {len(given)}"
        raise statements.error(corner_tokens[int(np.argmax(outside))], cause)
    names, material_of = _materials_of(statements, polygons, materials)
    return Coordinates(values, np.where(index == 0, -1, corners), names, material_of)


def _materials_of(
    statements: Statements, polygons: NDArray[np.int64], materials: Materials
) -> tuple[list[str], NDArray[np.int64]]:
    """Return all names behind `usemtl`, and which of them holds for each polygon."""
    switches = statements.select(b"usemtl")
    texts = [statements.rest(switch)[0] for switch in switches]
    known = {os.fsencode(name) for library in materials.libraries for name in library.materials}
    # Names may hold a "#", and a comment may follow them.
    meant = {text: text if text in known else text.split(b"#")[0].strip() for text in set(texts)}
    numbers = {name: number for number, name in enumerate(sorted(set(meant.values())))}
    numbered = np.array([numbers[meant[text]] for text in texts] or [-1], np.int64)
    last = np.searchsorted(switches, polygons) - 1
    return [os.fsdecode(name) for name in numbers], np.where(last < 0, -1, numbered[np.maximum(last, 0)])


@dataclass
class _Painted:
    """An image while the materials that show it are being found."""

    number: int
    data: bytes
    materials: list[str] = field(default_factory=list)
    wraps: list[Wrap] = field(default_factory=list)


def gather_textured(
    mesh: tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.int64]],
    coordinates: Coordinates,
    materials: Materials,
    beside: ModelFolder,
    slot: Slot,
    name: str,
) -> tuple[TexturedSurface, list[str]]:
    """Gather all triangles, and the images that one slot of their materials shows.

    Parameters
    ----------
    mesh : tuple of ndarray
        Positions of all vertices, shape (V, 3), and corners and offsets of all polygons as for `triangulate`.
    coordinates : Coordinates
        From the same file.
    materials : Materials
        Its materials.
    beside : ModelFolder
        Where its files lie.
    slot : Slot
        Which maps of the materials.
    name : str
        The file's name for messages.

    Returns
    -------
    surface : TexturedSurface
    notices : list of str
        What the user should be told.

    Raises
    ------
    InputError
        If no polygon shows a texture in this slot.
    """
    positions, corners, offsets = mesh
    palette = _Palette(materials, beside, slot, len(coordinates.names))
    for material in np.unique(coordinates.material_of).tolist():
        palette.take(material, coordinates.names[material] if material >= 0 else "")
    cut, polygon = triangulate_corners(positions, corners, offsets)
    material_of = coordinates.material_of[polygon]
    bare = (coordinates.corners[cut] < 0).any(axis=1)
    texture_of = np.where(bare, -1, palette.texture_of[material_of])
    if not (texture_of >= 0).any():
        raise InputError(name, *palette.excuse())
    uv = np.append(coordinates.values, [[0.0, 0.0]], axis=0)[coordinates.corners[cut]]
    uv = uv * palette.scale[material_of][:, None, :] + palette.offset[material_of][:, None, :]
    uv[:, :, 1] = 1 - uv[:, :, 1]
    if not np.isfinite(uv[texture_of >= 0]).all():
        raise InputError(name, "the options of a texture map move texture coordinates to infinity")
    notices = palette.notices()
    lost = int(np.count_nonzero(bare & (palette.texture_of[material_of] >= 0)))
    if lost:
        notices.append(f"{lost} triangles of textured materials have no texture coordinates.")
    surface = TexturedSurface(positions, corners[cut], uv, texture_of.astype(np.int32), palette.textures())
    return surface, notices


class _Palette:
    """The images of one slot by material; arrays are indexed by material, -1 being the last row."""

    def __init__(self, materials: Materials, beside: ModelFolder, slot: Slot, count: int) -> None:
        self._materials, self._beside, self.slot = materials, beside, slot
        self._painted: dict[str, _Painted] = {}
        self._missing: dict[str, list[str]] = {}
        self.texture_of = np.full(count + 1, -1, np.int64)
        self.scale, self.offset = np.ones((count + 1, 2)), np.zeros((count + 1, 2))

    def take(self, number: int, material: str) -> None:
        """Take up what a material has in the slot."""
        painting = self._materials.painting(material, self.slot)
        if painting is None:
            return
        found, path = painting
        if path is None or not self._loaded(path):
            self._missing.setdefault(found.name, []).append(material)
            return
        painted = self._painted[path]
        painted.materials.append(material)
        painted.wraps.append("clamp" if found.clamped else "repeat")
        self.texture_of[number] = painted.number
        self.scale[number], self.offset[number] = found.scale, found.offset

    def _loaded(self, path: str) -> bool:
        if path not in self._painted:
            try:
                data = self._beside.read(path)
            except OSError:
                return False
            self._painted[path] = _Painted(len(self._painted), data)
        return True

    def textures(self) -> tuple[Texture, ...]:
        """Return the images."""
        return tuple(
            Texture(path, path.rpartition("/")[2], p.data, tuple(p.materials), (p.wraps[0], p.wraps[0]))
            for path, p in self._painted.items()
        )

    def excuse(self) -> tuple[str, str]:
        """Return why no texture of the slot can be shown, and what can be done about it."""
        if self._painted:
            return f"it has a {self.slot} texture, but no texture coordinates for it", "export it with them"
        if self._missing:
            name = next(iter(self._missing))
            reason = self._materials.reason(name)
            return f"its {self.slot} texture '{name}' {reason}", remedy_for(reason)
        return f"it has no {self.slot} texture", ""

    def notices(self) -> list[str]:
        """Return what the user should know."""
        found = [
            f"The {self.slot} texture of {', '.join(map(repr, materials))} is left as it is: '{name}' "
            f"{self._materials.reason(name)}."
            for name, materials in self._missing.items()
        ]
        found += [
            f"'{path}' is used with several wrap modes; the first is followed."
            for path, painted in self._painted.items()
            if len(set(painted.wraps)) > 1
        ]
        return found
