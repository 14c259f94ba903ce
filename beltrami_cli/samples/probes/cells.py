"""Kernels on the cells of a canvas: texels, the pixels of an image, or the vertices of a range image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatch

import numpy as np

from beltrami_cli.arrays import Array, Int64s
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.beltrami_flow import BeltramiFlow
from beltrami_cli.flow.grid_manifold import GridManifold
from beltrami_cli.flow.records import SampledKernel
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image import Picture
from beltrami_cli.samples.probes.probe import Location, Probe, WindowView
from beltrami_cli.surface.atlas import EMPTY
from beltrami_cli.surface.records import PaintedVertices, Texture

# Cells around the window that are shown at least.
_LEAST_SURROUNDINGS = 4


@dataclass
class CellProbe(Probe):
    """Samples that are cells of a canvas."""

    flow: BeltramiFlow[GridManifold]

    def _cell_at(self, index: int, column: int, row: int, width: int, name: str) -> int:
        """Return the cell of a texel; if it has none, UsageError with the nearest texel that has one."""
        atlas = self.flow.manifold.atlas
        first, last = atlas.texture_offsets[index : index + 2]
        mine = np.flatnonzero((atlas.owned_texels >= first) & (atlas.owned_texels < last))
        if not len(mine):
            raise UsageError(f"{name} does not take part, and nor does any other")
        y, x = np.divmod(atlas.owned_texels[mine] - first, width)
        squared = (x - column) ** 2 + (y - row) ** 2
        nearest = int(squared.argmin())
        if squared[nearest]:
            raise UsageError(
                f"{name} does not take part: it is no place of the surface, or cannot be seen; "
                f"the nearest that does is --at {x[nearest]}px,{y[nearest]}px"
            )
        return int(atlas.owned_cells[mine[nearest]])

    def _texels_of(self, cells: Int64s) -> Int64s:
        """Return the texels of cells; a halo cell has that of the cell that it is nearest to."""
        atlas, own = self.flow.manifold.atlas, cells.copy()
        at = np.searchsorted(atlas.halo_cells, cells)
        halo = at < len(atlas.halo_cells)
        halo[halo] = atlas.halo_cells[at[halo]] == cells[halo]
        own[halo] = atlas.halo_nearest[at[halo]]
        return atlas.owned_texels[np.searchsorted(atlas.owned_cells, own)]

    def view(self, kernel: SampledKernel) -> WindowView:
        reach = self.flow.parameters.window // 2
        around = reach + max(reach, _LEAST_SURROUNDINGS)
        kind, planes = self.flow.manifold.atlas.kind, self.flow.manifold.colours
        row, column = divmod(int(kernel.samples[0]), kind.shape[1])
        filled = _square(kind, row, column, around) != EMPTY
        colours = _square(planes, row, column, around).reshape(len(planes), -1).T
        distances = np.full(filled.shape, np.nan, np.float32)
        weights = np.zeros(filled.shape, np.float32)
        y, x = np.divmod(kernel.samples, kind.shape[1])
        at = (y - row + around, x - column + around)
        distances[at], weights[at] = kernel.distances, kernel.weights
        shades = self.colours.shades(colours).reshape(*filled.shape, 3)
        return WindowView(shades, filled, distances, weights, (around, around))


@dataclass
class TexelProbe(CellProbe):
    """Texels of the textures of a slot, which are smoothed together."""

    document: Document
    textures: Sequence[Texture]
    pictures: Sequence[Picture]

    def find(self, location: Location) -> tuple[int, dict[str, object]]:
        index = self._texture_at(location)
        name = self.textures[index].name
        height, width = self.pictures[index].pixels.shape[:2]
        v_down = self.document.format in ("gltf", "glb")
        column, row = location.texel_of(width, height, name, v_down=v_down)
        at = f"texel {column},{row} of {name}"
        return self._cell_at(index, column, row, width, f"the {at}"), {"at": at}

    def _texture_at(self, location: Location) -> int:
        textures = [texture.name for texture in self.textures]
        glob = location.texture
        fits = [i for i, texture in enumerate(textures) if not glob or fnmatch(texture, glob)]
        if len(fits) == 1:
            return fits[0]
        which = "several textures" if fits else "no texture"
        raise UsageError(
            f"--at {location.text} names {which} of {self.document.name}; write one of {', '.join(textures)} before "
            f"it, as in {textures[0]}:{location.text.rpartition(':')[2]}"
        )

    def columns(self, samples: Int64s) -> dict[str, Array]:
        texels, offsets = self._texels_of(samples), self.flow.manifold.atlas.texture_offsets
        textures = np.searchsorted(offsets, texels, side="right") - 1
        widths = np.array([picture.pixels.shape[1] for picture in self.pictures])
        names = np.array([texture.name for texture in self.textures])
        y, x = np.divmod(texels - offsets[textures], widths[textures])
        return {"texture": names[textures], "x": x, "y": y}


@dataclass
class PixelProbe(CellProbe):
    """Pixels of an image."""

    picture: Picture
    unit: str

    def find(self, location: Location) -> tuple[int, dict[str, object]]:
        name, (height, width) = self.picture.name, self.picture.pixels.shape[:2]
        column, row = location.pixel_of(width, height, name)
        at = f"pixel {column},{row}"
        return self._cell_at(0, column, row, width, f"the {at} of {name}"), {"at": at}

    def columns(self, samples: Int64s) -> dict[str, Array]:
        y, x = np.divmod(self._texels_of(samples), self.picture.pixels.shape[1])
        return {"x": x, "y": y}


@dataclass
class RangeProbe(CellProbe):
    """Vertices of a range image, on the grid, shape (H, W), that they were measured on."""

    painted: PaintedVertices
    grid: Int64s
    name: str

    def find(self, location: Location) -> tuple[int, dict[str, object]]:
        # By its index or a position, or by column and row on the grid.
        if len(location.numbers) == 2:
            column, row = location.pixel_of(self.grid.shape[1], self.grid.shape[0], self.name)
            vertex = int(self.grid[row, column])
        else:
            vertex = location.vertex_among(self.painted.positions, self.name)
        atlas = self.flow.manifold.atlas
        (found,) = np.nonzero(self.grid.reshape(-1)[atlas.owned_texels] == vertex)
        if not len(found):
            raise UsageError(f"--at {location.text}: {self.name} has no measured vertex on its grid there")
        facts = {"at": f"vertex {vertex}", "position": self.painted.positions[vertex].tolist()}
        return int(atlas.owned_cells[found[0]]), facts

    def columns(self, samples: Int64s) -> dict[str, Array]:
        vertices = self.grid.reshape(-1)[self._texels_of(samples)]
        return {"vertex": vertices, **dict(zip("xyz", self.painted.positions[vertices].T, strict=True))}


def _square(plane: Array, row: int, column: int, around: int) -> Array:
    """Cut a square out of the last two axes, with zeros beyond the borders."""
    first = (max(0, row - around), max(0, column - around))
    part = plane[..., first[0] : row + around + 1, first[1] : column + around + 1]
    before = (first[0] - row + around, first[1] - column + around)
    missing = [(b, 2 * around + 1 - b - size) for b, size in zip(before, part.shape[-2:], strict=True)]
    return np.pad(part, [(0, 0)] * (plane.ndim - 2) + missing)
