"""A level set with colours as a document: triangulated first, then smoothed and written like any mesh."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.volume import read_volume
from beltrami_cli.formats.volume.arrays import require_package
from beltrami_cli.samples.voxel_colours import find_colours, paint
from beltrami_cli.surface.records import MeshContents
from beltrami_cli.surface.volume import places

if TYPE_CHECKING:
    from pathlib import Path

    from beltrami_cli.arrays import Array, Bools, Float64s, Int32s
    from beltrami_cli.formats.access import Access
    from beltrami_cli.formats.document import Changes, Naming, Written
    from beltrami_cli.samples.settings import Inside, LevelSetSettings
    from beltrami_cli.surface.records import PaintedVertices
    from beltrami_cli.surface.volume import Volume

# More crossed grid edges are due to noise or a wrong level; and marching cubes counts in 32 bits.
MAX_CROSSINGS = 1 << 26
_BYTES_OF_VOXEL = 16  # its value in double precision, its colour, and what marching cubes takes
_LARGEST_PLANE = 1 << 29  # samples in a layer, four to each counted in 32 bits


class LevelSetDocument(Document):
    """The triangulated surface of a volume; vertices without a known colour are white and stay as they are."""

    format: ClassVar[str] = "level set"

    def __init__(
        self,
        data: bytes,
        name: str,
        folder: Path | None,
        settings: LevelSetSettings,
        access: Access,
        threads: int,
    ) -> None:
        super().__init__(b"", name, folder, access)
        require_package("skimage.measure", "scikit-image", name, "to triangulate level sets")
        max_voxels = _allowed(settings, access)
        volume = read_volume(data, name, folder, max_voxels)
        level = settings.level if settings.level is not None else volume.level or 0.0
        known = np.isfinite(volume.values)
        if volume.known is not None:
            known &= volume.known
        self._facts = _facts_of(volume, known, level)
        vertices, faces = _triangulated(volume, known, level, settings.inside, name)
        positions = places(volume.lattice, vertices)
        source, where = find_colours(volume, settings.colours, name, access, max_voxels)
        painted = paint(source, where, volume.lattice, known, positions, threads)
        self.notices += painted.notices
        self._vertices = painted.vertices(positions, faces)
        self._contents = MeshContents(
            positions,
            faces.ravel(),
            np.arange(0, faces.size + 1, 3, dtype=np.int64),
            self._vertices.colours,
            self._vertices.encoding,
            self._vertices.stored,
            painted.alpha,
        )

    @property
    def _painted(self) -> PaintedVertices:
        """Vertices with all triangles whose corners have colours; the others are isolated."""
        return self._vertices

    def contents(self) -> MeshContents:
        return self._contents

    def facts(self) -> dict[str, object]:
        return self._facts

    def _patched(self, new: Changes, naming: Naming) -> Written:
        raise InputError(
            self.name, "a level set is not written", "name an output in .ply, .obj, .glb or .gltf"
        )


def _allowed(settings: LevelSetSettings, access: Access) -> int:
    """Return the largest number of voxels of a grid."""
    if access.memory is None:
        return settings.max_voxels
    return min(settings.max_voxels, access.memory // _BYTES_OF_VOXEL)


def _triangulated(
    volume: Volume, known: Bools, level: float, inside: Inside, name: str
) -> tuple[Float64s, Int32s]:
    """Return the surface, in units of the grid, facing outwards in space."""
    from beltrami_cli.surface.level_set import find_crossings, triangulate_level_set

    values = volume.values
    if values.shape[1] * values.shape[2] >= _LARGEST_PLANE:
        raise InputError(name, f"the grid of {values.shape} is too large in y and z", "cut it in pieces")
    crossings = find_crossings(values, level, known)
    if crossings.count > MAX_CROSSINGS:
        cause = f"the surface at level {level:g} cuts {crossings.count} edges of the grid, as noise does"
        raise InputError(name, cause, "choose another --level, or smooth the values first")
    vertices, faces = np.empty((0, 3)), np.empty((0, 3), np.int32)
    if crossings.count:
        vertices, faces = triangulate_level_set(values, level, crossings, known)
    if not len(faces):
        low, high = _range(values, known)
        cause = f"there is no surface at level {level:g}; the values go from {low:g} to {high:g}"
        raise InputError(name, cause, "choose another --level")
    # Triangles face larger values where the grid is right-handed in space.
    mirrored = np.linalg.det(volume.lattice.axes) < 0
    return vertices, faces[:, ::-1] if (inside == "above") != mirrored else faces


def _facts_of(volume: Volume, known: Bools, level: float) -> dict[str, object]:
    return {
        "grid": list(volume.values.shape),
        "spacing": np.linalg.norm(volume.lattice.axes, axis=1).tolist(),
        "origin": volume.lattice.origin.tolist(),
        "values": list(_range(volume.values, known)),
        "level": level,
        "unknown_voxels": int(known.size - np.count_nonzero(known)),
    }


def _range(values: Array, known: Bools) -> tuple[float, float]:
    """Return the smallest and the largest known value; NaN if there is none."""
    first = int(np.argmax(known))
    if not known.flat[first]:
        return np.nan, np.nan
    some = values.flat[first]
    return float(values.min(initial=some, where=known)), float(values.max(initial=some, where=known))
