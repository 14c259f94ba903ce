"""The colours of a level set's vertices: from its own file or another, on a grid or near the surface."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.access import read_source
from beltrami_cli.formats.colours import full_scale
from beltrami_cli.formats.registry import open_bytes
from beltrami_cli.formats.volume import read_colours
from beltrami_cli.surface.records import PaintedVertices
from beltrami_cli.surface.volume import (
    GridColours,
    NearColours,
    has_colour,
    interpolate_colours,
    nearest_colours,
)

if TYPE_CHECKING:
    from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int32s
    from beltrami_cli.formats.access import Access
    from beltrami_cli.surface.records import Encoding
    from beltrami_cli.surface.volume import Lattice, Volume

# Other types have no full scale of their own: it is derived from their largest value.
_FULL_SCALE = {"uint8": 255.0, "uint16": 65535.0}


@dataclass(frozen=True)
class Paint:
    """Colours at the V vertices of a level set."""

    colours: Float32s  # full scale 1, one or three channels; white where there is none
    alpha: Float32s | None  # opacity, shape (V,), where the source has it
    found: Bools  # where there is a colour, shape (V,)
    encoding: Encoding
    stored: str  # type of the source
    notices: list[str] = field(default_factory=list)

    def vertices(self, positions: Float64s, faces: Int32s) -> PaintedVertices:
        """Return the vertices to smooth; triangles with a vertex without a colour are left out."""
        names = ("red", "green", "blue") if self.colours.shape[1] == 3 else ("grey",)
        whole = np.ascontiguousarray(faces[self.found[faces].all(axis=1)])
        return PaintedVertices(positions, whole, self.colours, names, self.encoding, self.stored)


def find_colours(
    volume: Volume, path: str | None, name: str, access: Access, max_size: int
) -> tuple[GridColours | NearColours, str]:
    """Return the colours of a level set, from its file or the file at `path`, and the name of that file."""
    if path is None:
        if volume.colours is None:
            raise InputError(name, "the volume has no colours", "give a file that has them with --colours")
        return volume.colours, name
    if path == "-":
        raise InputError(path, "colours are not read from a pipe", "name a file")
    data, folder = read_source(path, access), Path(path).parent
    colours = read_colours(data, path, folder, max_size)
    if colours is None:
        painted = open_bytes(data, path, folder, access).painted()
        colours = NearColours(painted.positions, painted.colours, painted.encoding, painted.stored)
    return colours, path


def paint(
    source: GridColours | NearColours,
    where: str,
    lattice: Lattice,
    known: Bools,
    positions: Float64s,
    threads: int,
) -> Paint:
    """Return the colours of the vertices, shape (V, 3); voxels that are not `known` supply none."""
    if isinstance(source, GridColours):
        same = source.samples.shape[:3] == known.shape and _equal(source.lattice, lattice)
        stored = interpolate_colours(source, positions, known if same else None)
    else:
        voxel = float(np.linalg.norm(lattice.axes, axis=1).max())
        stored = nearest_colours(source, positions, voxel, threads)
    found = has_colour(stored)
    if not found.any():
        raise InputError(where, "none of its colours is on the surface", "check the spacings and origins")
    return _scaled(source, stored, found, where)


def _equal(one: Lattice, other: Lattice) -> bool:
    return np.array_equal(one.axes, other.axes) and np.array_equal(one.origin, other.origin)


def _scaled(source: GridColours | NearColours, stored: Float64s, found: Bools, name: str) -> Paint:
    """Scale stored numbers to full scale 1, and separate opacity from colours."""
    width = 3 if stored.shape[1] >= 3 else 1
    kind = source.samples.dtype.name
    notices: list[str] = []
    scale = 1.0 if isinstance(source, NearColours) and source.stored else _FULL_SCALE.get(kind, 0.0)
    if not scale:
        scale, notice = full_scale(stored[found, :width], name)
        notices += [notice] if notice else []
    colours = np.where(found[:, None], stored[:, :width] / scale, 1.0).astype(np.float32)
    alpha = None if stored.shape[1] == width else _opacity(stored[:, width], found, scale)
    if not found.all():
        bare = int(len(found) - np.count_nonzero(found))
        notices.append(
            f"{bare} of {len(found)} vertices have no colour nearby; they are white and lend none."
        )
    encoding = source.encoding if isinstance(source, NearColours) else "srgb"
    stored_as = source.stored if isinstance(source, NearColours) and source.stored else kind
    return Paint(colours, alpha, found, encoding, stored_as, notices)


def _opacity(stored: Array, found: Bools, scale: float) -> Float32s:
    """Return opacity of full scale 1; it is 1 at vertices without a colour, which belong to the surface."""
    scale = scale if stored[found].max() > 1 else 1.0
    return np.where(found, np.clip(stored / scale, 0, 1), 1.0).astype(np.float32)
