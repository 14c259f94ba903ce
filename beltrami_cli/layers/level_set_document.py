"""A level set with colours as a document, which is triangulated, then smoothed and written like a mesh."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int32s
from beltrami_cli.errors import InputError
from beltrami_cli.formats.changes import Changes, Naming, Written
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.files.access import Access, read_source
from beltrami_cli.formats.full_scale import full_scale, integer_scale
from beltrami_cli.formats.registry import open_bytes
from beltrami_cli.formats.sidecars.model_folder import ModelFolder
from beltrami_cli.formats.volume import read_colours, read_volume
from beltrami_cli.formats.volume.extra import require_package
from beltrami_cli.layers.settings import Inside, LevelSetSettings
from beltrami_cli.surface import level_sets
from beltrami_cli.surface.precision import require_single
from beltrami_cli.surface.records import ColouredVertices, Encoding, MeshContents

Source = level_sets.GridColours | level_sets.NearColours

# More crossed grid edges are due to noise or a wrong level; marching cubes counts in 32 bits.
MAX_CROSSINGS = 1 << 26
_BYTES_OF_VOXEL = 16  # value in double precision, colour, and memory of marching cubes


class LevelSetDocument(Document):
    """The triangulated surface of a volume; vertices of unknown colour are white and are not changed."""

    format = "level set"
    kind = "volume"

    def __init__(
        self, name: str, folder: Path | None, access: Access, *,
        vertices: ColouredVertices, contents: MeshContents, facts: dict[str, object],
    ) -> None:  # fmt: skip
        super().__init__(b"", name, folder, access)
        self._coloured_vertices, self._contents, self._facts = vertices, contents, facts

    def contents(self) -> MeshContents:
        return self._contents

    def facts(self) -> dict[str, object]:
        return self._facts

    def _patched(self, new: Changes, naming: Naming) -> Written:
        cause = "a level set is not written"
        raise InputError(self.name, cause, "name an output in .ply, .obj, .glb or .gltf")


def read_level_set(
    data: bytes, name: str, folder: Path | None, settings: LevelSetSettings, access: Access, threads: int
) -> LevelSetDocument:
    """Triangulate a volume, and colour its surface."""
    require_package("skimage.measure", "scikit-image", name, "to triangulate level sets")
    max_voxels = settings.max_voxels
    if access.memory is not None:
        max_voxels = min(max_voxels, access.memory // _BYTES_OF_VOXEL)
    volume = read_volume(data, name, ModelFolder(folder, access), max_voxels)
    level = settings.iso if settings.iso is not None else volume.level or 0.0
    known = np.isfinite(volume.values)
    if volume.known is not None:
        known &= volume.known
    facts = {
        "grid": list(volume.values.shape),
        "spacing": np.linalg.norm(volume.lattice.axes, axis=1).tolist(),
        "origin": volume.lattice.origin.tolist(),
        "values": list(_range(volume.values, known)),
        "level": level,
        "unknown_voxels": int(known.size - np.count_nonzero(known)),
    }
    corners, faces = _triangulated(volume, known, level, settings.inside, name)
    positions = volume.lattice.in_space(corners)
    source, where = _find_colours(volume, settings.colours, name, access, max_voxels)
    values = _colours_at(source, volume.lattice, known, positions, threads)
    is_coloured = level_sets.has_colour(values)
    if not is_coloured.any():
        raise InputError(where, "none of its colours is on the surface", "check the spacings and origins")
    colours, alpha, notices = _scaled(source, values, is_coloured, where)
    names = ("red", "green", "blue") if colours.shape[1] == 3 else ("grey",)
    encoding: Encoding = "srgb"
    stored = source.samples.dtype.name
    if isinstance(source, level_sets.NearColours):
        encoding, stored = source.encoding, source.stored or stored
    # Triangles whose corners have colours.
    whole = np.ascontiguousarray(faces[is_coloured[faces].all(axis=1)])
    offsets = np.arange(0, faces.size + 1, 3, dtype=np.int64)
    vertices = ColouredVertices(
        positions, whole, colours, names, encoding, stored, needs_triangles=True, notices=notices
    )
    contents = MeshContents(
        positions, faces.ravel(), offsets, colours, encoding, stored, alpha, notices=notices
    )
    return LevelSetDocument(name, folder, access, vertices=vertices, contents=contents, facts=facts)


def _triangulated(
    volume: level_sets.Volume, known: Bools, level: float, inside: Inside, name: str
) -> tuple[Float64s, Int32s]:
    """Return the surface in units of the grid, facing outwards in space."""
    values = volume.values
    if (
        4 * values.shape[1] * values.shape[2] > np.iinfo(np.int32).max
    ):  # marching cubes counts four per sample
        raise InputError(name, f"the grid of {values.shape} is too large in y and z", "cut it in pieces")
    crossings = level_sets.find_crossings(values, level, known)
    if crossings.count > MAX_CROSSINGS:
        cause = f"the surface at level {level:g} cuts {crossings.count} edges of the grid, as noise does"
        raise InputError(name, cause, "choose another --iso, or smooth the values first")
    vertices, faces = np.empty((0, 3)), np.empty((0, 3), np.int32)
    if crossings.count:
        vertices, faces = level_sets.triangulate_level_set(values, level, crossings, known)
    if not len(faces):
        low, high = _range(values, known)
        cause = f"there is no surface at level {level:g}; the values go from {low:g} to {high:g}"
        raise InputError(name, cause, "choose another --iso")
    # Triangles face larger values if the axes of the grid are right-handed.
    mirrored = np.linalg.det(volume.lattice.axes) < 0
    return vertices, faces[:, ::-1] if (inside == "above") != mirrored else faces


def _find_colours(
    volume: level_sets.Volume, path: str | None, name: str, access: Access, max_size: int
) -> tuple[Source, str]:
    """Return the colours of a level set, from its file or the file at `path`, and the name of that file."""
    if path is None:
        if volume.colours is None:
            raise InputError(name, "the volume has no colours", "give a file that has them with --colours")
        return volume.colours, name
    if path == "-":
        raise InputError(path, "colours are not read from a pipe", "name a file")
    data, folder = read_source(path, access), Path(path).parent
    colours = read_colours(data, path, ModelFolder(folder, access), max_size)
    if colours is None:
        vertices = open_bytes(data, path, folder, access).coloured_vertices()
        colours = level_sets.NearColours.of(vertices)
    return colours, path


def _colours_at(
    source: Source, lattice: level_sets.Lattice, known: Bools, positions: Float64s, threads: int
) -> Float64s:
    """Return the stored colours of vertices, shape (V, C); voxels that are not `known` supply none."""
    if isinstance(source, level_sets.GridColours):
        grid = source.lattice
        same = source.samples.shape[:3] == known.shape
        same &= np.array_equal(grid.axes, lattice.axes) and np.array_equal(grid.origin, lattice.origin)
        return level_sets.interpolate_colours(source, positions, known if same else None)
    voxel = float(np.linalg.norm(lattice.axes, axis=1).max())
    return level_sets.nearest_colours(source, positions, voxel, threads)


def _scaled(
    source: Source, stored: Float64s, is_coloured: Bools, name: str
) -> tuple[Float32s, Float32s | None, tuple[str, ...]]:
    """Return colours and opacity of full scale 1, white where there are none, and notices."""
    width = 3 if stored.shape[1] >= 3 else 1
    samples = source.samples.reshape(-1, source.samples.shape[-1])
    require_single(samples, name, "the colour of sample", holes=True)
    kind = source.samples.dtype.name
    notices: list[str] = []
    if isinstance(source, level_sets.NearColours) and source.stored:
        scale, notice = 1.0, ""
    elif kind in ("uint8", "uint16"):
        scale, notice = integer_scale(int(source.samples.max(initial=0)), kind)
    else:  # for other types full scale is derived from usual values
        scale, notice = full_scale(stored[is_coloured, :width], name)
    notices += [notice] if notice else []
    colours = np.where(is_coloured[:, None], stored[:, :width] / scale, 1.0).astype(np.float32)
    alpha = None
    if stored.shape[1] > width:
        opacity = stored[:, width] / (scale if stored[is_coloured, width].max() > 1 else 1.0)
        # Vertices without a colour are still part of the surface.
        alpha = np.where(is_coloured, np.clip(opacity, 0, 1), 1.0).astype(np.float32)
    if not is_coloured.all():
        bare = int(len(is_coloured) - np.count_nonzero(is_coloured))
        far = f"{bare} of {len(is_coloured)} vertices have no colour nearby"
        notices.append(f"{far}; they are white and lend none.")
    return colours, alpha, tuple(notices)


def _range(values: Array, known: Bools) -> tuple[float, float]:
    """Return the least and the largest known value; NaN if there is none."""
    first = int(np.argmax(known))
    if not known.flat[first]:
        return np.nan, np.nan
    some = values.flat[first]
    return float(values.min(initial=some, where=known)), float(values.max(initial=some, where=known))
