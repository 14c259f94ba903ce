"""An atlas as a manifold: the charts of textures on one canvas, continued over their seams.

Charts lie on one canvas of R x C cells, so that cells next to each other are neighbours on the surface. A cell is OWNED
where it is the place of a texel: each covered texel of the textures is one owned cell. It is HALO where it continues a
chart beyond a seam, or stands for a texel that another cell owns: its colour comes from owned cells elsewhere.
Everything else is EMPTY, which nothing crosses.

Faces that share an edge in space and in the image, on its two sides, are of one chart; where an edge of exactly two
faces is shared in space only, it is a seam, also between textures. A texel is covered if its centre lies in a triangle.
Where triangles overlap in the image the texel is owned by the largest chart, and other charts look at it. A texture
that tiles is owned by the fullest period of a chart. Beyond a seam the faces on its other side are unfolded into the
plane of the face before it, and looked up there; beyond open edges, and edges of more than two faces, is nothing.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli._native import build_atlas as build_native_atlas
from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Indices, Int8s, Int32s, Int64s, Uint8s
from beltrami_cli.errors import ProcessingError
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.grouping import group_places
from beltrami_cli.surface.records import TexturedSurface

if TYPE_CHECKING:
    from beltrami_cli._native import AtlasArrays

EMPTY, OWNED, HALO = 0, 1, 2
# Weights of the least-squares line through values 1/2, 3/2 and 5/2 texels from a seam, evaluated at the seam.
_EXTRAPOLATION = np.array([13, 4, -5]) / 12
REACH = len(_EXTRAPOLATION)
_CELLS = 1 << 14  # whose areas are measured at a time, in the processor's cache


@dataclass(frozen=True)
class Halo:
    """The halo cells, H in number."""

    cells: Indices  # (H,): flat indices, ascending
    taps: Indices  # (H, 4): owned cells (flat indices) to interpolate from
    weights: Float32s  # (H, 4): non-negative weights of sum 1
    # Shape (H,): seam over which the cell was reached; -1: none, the cell stands for a texel owned elsewhere.
    seams: Int32s

    @cached_property
    def nearest(self) -> Indices:
        """The nearest owned cell of each halo cell, shape (H,)."""
        nearest = self.weights.argmax(axis=1)
        return np.take_along_axis(self.taps, nearest[:, None], axis=1)[:, 0]

    def only(self, chosen: Bools) -> Halo:
        return Halo(self.cells[chosen], self.taps[chosen], self.weights[chosen], self.seams[chosen])


@dataclass(frozen=True)
class Gutter:
    """Uncovered texels that show colours of charts."""

    cells: Indices  # (G,): halo cells (flat indices) on uncovered texels
    texels: (
        Indices  # (G,): those texels, each at most once: the colours for lookups just beyond a chart's border
    )
    # Shapes (B,) and (L,), ascending: texels that lookups on faces read. Border texels are next to texels that the
    # chart of each such face covers; lone texels are next to none, and may show a part of the surface far from the
    # charts around them.
    border_texels: Indices
    lone_texels: Indices


_NOTHING = np.zeros(0, np.int64)
NO_HALO = Halo(_NOTHING, np.zeros((0, 4), np.int64), np.zeros((0, 4), np.float32), np.zeros(0, np.int32))
NO_GUTTER = Gutter(_NOTHING, _NOTHING, _NOTHING, _NOTHING)


@dataclass(frozen=True)
class Atlas:
    """Charts laid out on a canvas of R x C cells."""

    kind: Uint8s  # (R, C): EMPTY, OWNED or HALO. A margin as wide as the halo is EMPTY or HALO on all sides.
    # Shape (4, R, C): squared distances in space, in the surface's unit, from each cell to its neighbours on the right,
    # below, below right and below left. Infinite outside the canvas and where the surface ends between both cells (at
    # an open edge, or between parts of a chart that touch only in the image); undefined if either is EMPTY.
    lengths: large_arrays.Droppable[Float32s]
    # Shape (K,): flat indices, ascending, of cells at an edge where the surface ends between them and a neighbour that
    # is not EMPTY.
    cut_cells: Indices
    owned: large_arrays.Droppable[Indices]  # (T,): flat indices of the owned cells, ascending
    owned_texels: Indices  # (T,): their texels: offset of the texture + row * width + column
    # Shape (number of textures + 1,): texels of texture i are numbered from its offset, row by row.
    texture_offsets: Int64s
    halo: Halo
    gutter: Gutter
    chart_of: Indices  # (T,): chart of each owned cell
    # Numbers of charts and seams. A seam is a run of seam edges between two charts, or of a chart with itself.
    charts: int
    seams: int
    covered: int  # texels covered by the surface, then those covered more than once
    overlapped: int

    @property
    def squared_lengths(self) -> Float32s:
        return self.lengths.get()

    @property
    def owned_cells(self) -> Indices:
        return self.owned.get()

    @property
    def counts(self) -> dict[str, int]:
        return {name: getattr(self, name) for name in ("charts", "seams", "covered", "overlapped")}

    @property
    def is_owned(self) -> Bools:
        owned: Bools = large_arrays.empty(self.kind.shape, bool)
        return np.equal(self.kind, OWNED, out=owned)

    @property
    def is_filled(self) -> Bools:
        filled: Bools = large_arrays.empty(self.kind.shape, bool)
        return np.not_equal(self.kind, EMPTY, out=filled)

    def covered_by_texture(self) -> Int64s:
        """Return the number of texels of each texture that have a cell."""
        if len(self.texture_offsets) == 2:
            return np.array([len(self.owned_texels)])
        return np.histogram(self.owned_texels, self.texture_offsets)[0].astype(np.int64)

    def texture_of(self, texels: Indices) -> Int64s:
        return np.searchsorted(self.texture_offsets, texels, side="right") - 1

    def by_texture(self, texels: Indices) -> Iterator[tuple[int, Bools | slice, Indices]]:
        """Yield the index of each texture, a mask of its texels, and these relative to the first texel."""
        if not len(texels):
            return
        first, last = self.texture_of(np.array([texels.min(), texels.max()])).tolist()
        for index in range(first, last + 1):
            begin, end = self.texture_offsets[index : index + 2].tolist()
            if first == last:
                yield index, slice(None), texels - begin
                return
            inside = (texels >= begin) & (texels < end)
            if inside.any():
                yield index, inside, texels[inside] - begin


def refresh_halo(planes: Float32s | Int8s, atlas: Atlas, *, interpolated: bool = False) -> None:
    """Update the halo cells of all planes, shape (N, R, C), from their owned cells, in place."""
    # Averages need the nearest cell: an interpolated value has less noise than other samples, and at an edge it is a
    # colour of neither side, which lets kernels leak across. Interpolated values are for display.
    halo, cells, nearest = atlas.halo, atlas.halo.cells, atlas.halo.nearest
    at_once = large_arrays.SCATTERED if interpolated or large_arrays.any_in_files() else max(1, len(cells))
    for block in large_arrays.blocks(len(cells), at_once):
        taps, weights = halo.taps[block], halo.weights[block]
        for plane in planes.reshape(len(planes), -1):
            shown = np.einsum("ht,ht->h", plane[taps], weights) if interpolated else plane[nearest[block]]
            plane[cells[block]] = shown


def without_halo(atlas: Atlas, dropped: Bools) -> Atlas:
    """Return the atlas with the marked halo cells, shape (H,), emptied."""
    kind, gutter = large_arrays.copy_of(atlas.kind), atlas.gutter
    kind.reshape(-1)[atlas.halo.cells[dropped]] = EMPTY
    seen = kind.reshape(-1)[gutter.cells] != EMPTY
    gutter = dataclasses.replace(gutter, cells=gutter.cells[seen], texels=gutter.texels[seen])
    return dataclasses.replace(atlas, kind=kind, halo=atlas.halo.only(~dropped), gutter=gutter)


def without_owned(atlas: Atlas, dropped: Bools) -> Atlas:
    """Return the atlas with the marked owned cells, shape (T,), emptied, and halo cells that depend on them."""
    gone = np.zeros(atlas.kind.size, bool)
    gone[atlas.owned_cells[dropped]] = True
    weights = np.where(gone[atlas.halo.taps], 0, atlas.halo.weights)
    total = weights.sum(axis=1)
    orphaned = total <= 0
    weights /= np.where(orphaned, 1, total)[:, None]
    kind = large_arrays.copy_of(atlas.kind)
    kind.reshape(-1)[gone] = EMPTY
    kept = dataclasses.replace(
        atlas, kind=kind, owned=owned_of(kind),
        owned_texels=atlas.owned_texels[~dropped], chart_of=atlas.chart_of[~dropped],
        halo=dataclasses.replace(atlas.halo, weights=weights.astype(np.float32)),
    )  # fmt: skip
    return without_halo(kept, orphaned)


def owned_of(kind: Uint8s) -> large_arrays.Droppable[Indices]:
    """Return the flat indices of the owned cells, ascending, computed on demand."""
    return large_arrays.Droppable(None, partial(large_arrays.indices_of, kind, OWNED))


_WRAP_CODES = {"repeat": 0, "mirror": 1, "clamp": 2}


def build_atlas(
    surface: TexturedSurface, sizes: Sequence[tuple[int, int]], margin: int, threads: int = 1
) -> Atlas:
    """Lay out the charts of a textured surface, and extend each by `margin` cells over its seams."""
    build = partial(_build, surface, sizes, margin, threads)
    made = build()
    smallest = np.min_scalar_type(-made["charts"] - 1)
    chart_of = large_arrays.empty(len(made["chart_of"]), smallest)
    for block in large_arrays.blocks(len(chart_of)):
        chart_of[block] = made["chart_of"][block]
    texels = np.array([width * height for width, height in sizes], np.int64)
    return Atlas(
        kind=made["kind"],
        lengths=large_arrays.Droppable(made["squared_lengths"], lambda: build()["squared_lengths"]),
        cut_cells=made["cut_cells"],
        owned=owned_of(made["kind"]),
        owned_texels=made["owned_texels"],
        texture_offsets=np.concatenate([[0], np.cumsum(texels)]),
        halo=Halo(made["halo_cells"], made["halo_taps"], made["halo_weights"], made["halo_seams"]),
        gutter=Gutter(
            made["gutter_cells"], made["gutter_texels"], made["border_texels"], made["lone_texels"]
        ),
        chart_of=chart_of,
        charts=made["charts"], seams=made["seams"], covered=made["covered"], overlapped=made["overlapped"],
    )  # fmt: skip


def _build(
    surface: TexturedSurface, sizes: Sequence[tuple[int, int]], margin: int, threads: int
) -> AtlasArrays:
    place_of, first = group_places(surface.positions, surface.space_of, surface.faces)
    wraps = ([_WRAP_CODES[mode] for mode in texture.wrap] for texture in surface.textures)
    rows = [(*size, *wrap) for size, wrap in zip(sizes, wraps, strict=True)]
    grids = np.array(rows, np.int32).reshape(-1, 4)
    try:
        return build_native_atlas(
            np.ascontiguousarray(surface.positions[first], np.float64),
            np.ascontiguousarray(place_of[surface.faces], np.int32).reshape(-1, 3),
            np.ascontiguousarray(surface.uv, np.float64).reshape(-1, 3, 2),
            np.ascontiguousarray(surface.texture_of, np.int32),
            grids,  # width, height, wrap modes along u and v of each texture
            margin,
            threads,
            lambda size: large_arrays.empty(size, np.uint8),
            lambda _: large_arrays.release_pages(),
        )
    except ValueError as error:  # std::length_error of the core
        raise ProcessingError(f"{error}; use smaller textures") from error


def at_seam(values: Sequence[Array]) -> Float64s:
    """Extrapolate three cells on a line, nearest first, to the seam; return a single cell unchanged."""
    if len(values) == 1:
        return values[0].astype(np.float64)
    return np.asarray(sum(weight * each for weight, each in zip(_EXTRAPOLATION, values, strict=True)))


def lines_over_seams(atlas: Atlas, reach: int) -> list[list[Int64s]]:
    """Return lines of cells across seams, in four directions: `reach` owned cells from the seam, then halo cells."""
    columns, size = atlas.kind.shape[1], atlas.kind.size
    owned = atlas.kind.reshape(-1) == OWNED
    beyond = np.zeros(size, bool)
    beyond[atlas.halo.cells[atlas.halo.seams >= 0]] = True
    first = np.flatnonzero(beyond)
    lines = []
    for step in (1, -1, columns, -columns):
        line = [first - step * (k + 1) for k in range(reach)] + [first + step * k for k in range(reach)]
        fits = np.ones(len(first), bool)
        for number, cells in enumerate(line):
            inside = (cells >= 0) & (cells < size)
            fits &= inside & (owned if number < reach else beyond)[np.where(inside, cells, 0)]
        lines.append([cells[fits] for cells in line])
    return lines


def texel_areas(atlas: Atlas) -> Float64s:
    """Return the surface area of each owned cell, shape (T,), in the surface's own unit squared."""
    columns, filled = atlas.kind.shape[1], atlas.kind.reshape(-1) != EMPTY
    squared_lengths = atlas.squared_lengths[:3].reshape(3, -1)
    areas = np.empty(len(atlas.owned_cells))
    for block in large_arrays.blocks(len(areas), _CELLS):
        total, count = np.zeros((2, block.stop - block.start))
        # The mean of the squares of four cells around it; all cells around an owned one lie on the canvas.
        for offset in (0, 1, columns, columns + 1):
            first = atlas.owned_cells[block] - offset
            # A parallelogram: |a x b|^2 = |a|^2 |b|^2 - (a . b)^2, where a . b follows from |a + b|^2.
            a, b, c = squared_lengths[:, first].astype(np.float64)
            known = np.isfinite(a + b + c)
            for corner in (0, 1, columns, columns + 1):
                known &= filled[first + corner]
            a, b, c = np.where(known, (a, b, c), 0)
            total += np.sqrt(np.maximum(a * b - ((c - a - b) / 2) ** 2, 0))
            count += known
        areas[block] = np.divide(total, count, out=np.full(len(total), np.nan), where=count > 0)
    measured = np.isfinite(areas)
    return np.where(measured, areas, areas[measured].mean() if measured.any() else 1.0)
