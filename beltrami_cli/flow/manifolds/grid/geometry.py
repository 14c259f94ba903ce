"""The geometry of a regular grid: the cells of a texture atlas, or the pixels of one image."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, TypeAlias

import numpy as np

from beltrami_cli._native import halo_repeats as count_repeats
from beltrami_cli._native import local_scale
from beltrami_cli.arrays import Array, Bools, Float32s, Indices, Int64s, Uint8s
from beltrami_cli.flow.cuts import Rectangle
from beltrami_cli.flow.manifolds.blocks import SUMMED_ROWS
from beltrami_cli.flow.manifolds.geometry import ENOUGH_DIFFERENCES, Geometry, Stack
from beltrami_cli.flow.manifolds.grid.gaussian import GridGaussian
from beltrami_cli.flow.manifolds.kernel_work import KernelWork
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import EMPTY, HALO, NO_GUTTER, NO_HALO, OWNED, Atlas, owned_of, refresh_halo

# Rows and columns around a halo cell in which cells with the same texel are searched: enough for a chart up to seven
# times as fine as the chart beyond the seam.
_REPEATS_REACH = 3

CellIndex: TypeAlias = Rectangle | Int64s
"""Some cells of a canvas: a rectangle, or flat indices, shape (R', C')."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GridGeometry(Geometry):
    """The cells of an atlas; stacks are planes on its canvas."""

    axis: ClassVar[int] = 0

    atlas: Atlas
    spacing: float
    # Factors of squared lengths that scale the spacing around each cell to 1
    scales: large_arrays.Droppable[Float32s] | None
    repeats: Uint8s | None  # number of cells that show the same texel
    stops_at_holes: bool
    threads: int

    @classmethod
    def of(cls, atlas: Atlas, parameters: KernelParameters, *, stop_at_holes: bool) -> GridGeometry:
        measure, threads = partial(_local_scales, atlas, parameters.window), parameters.thread_count
        scales = large_arrays.Droppable(measure(), measure)
        return cls(
            atlas=atlas, spacing=_mean_spacing(atlas, scales.get()),
            scales=scales if parameters.units == "spacing" else None, repeats=halo_repeats(atlas, threads),
            stops_at_holes=stop_at_holes, threads=threads,
        )  # fmt: skip

    @property
    def scale(self) -> Float32s | None:
        return None if self.scales is None else self.scales.get()

    def drop_distances(self) -> None:
        self.atlas.lengths.drop()
        if self.scales is not None:
            self.scales.drop()

    def drop_samples(self) -> None:
        self.atlas.owned.drop()

    @property
    def size(self) -> int:
        return self.atlas.kind.size

    @property
    def shape(self) -> tuple[int, ...]:
        return self.atlas.kind.shape

    @property
    def kernels(self) -> int:
        return int(np.count_nonzero(self.atlas.kind == OWNED))

    @property
    def kind(self) -> Uint8s:
        return self.atlas.kind[None]

    def cut(self, samples: CellIndex, inside: Bools) -> GridGeometry:
        """Cut out cells, shape (R', C'), without refreshing their halo; `inside` marks the cells that have a kernel."""
        whole, kind = self.atlas, pick(self.atlas.kind, samples).copy()
        kind[(kind == OWNED) & ~inside] = HALO
        if not isinstance(samples, tuple):
            kind[samples == whole.kind.size - 1] = EMPTY  # cells of the margin and beyond the canvas
        atlas = dataclasses.replace(
            whole, kind=kind, lengths=large_arrays.Droppable(pick(whole.squared_lengths, samples)),
            cut_cells=_cut_cells_among(whole, samples), owned=owned_of(kind), owned_texels=np.zeros(0, np.int64),
            chart_of=np.zeros(0, np.int32), halo=NO_HALO, gutter=NO_GUTTER,
        )  # fmt: skip
        scales = None if self.scale is None else large_arrays.Droppable(pick(self.scale, samples))
        repeats = None if self.repeats is None else pick(self.repeats, samples)
        return dataclasses.replace(self, atlas=atlas, scales=scales, repeats=repeats)

    def work(self, unit: float) -> KernelWork:
        return KernelWork(self.kernels, unit)

    def take(self, stack: Stack, samples: Indices) -> Float32s:
        return colours_at(stack, samples)

    def differences(self, stack: Stack) -> Float32s:
        """Differences between neighbours along rows, in evenly spread rows, shape (K, G)."""
        owned = self.atlas.kind == OWNED
        rows = np.arange(0, len(owned), max(1, int(np.count_nonzero(owned)) // ENOUGH_DIFFERENCES))
        both = owned[rows, :-1] & owned[rows, 1:]
        return (stack[:, rows, 1:] - stack[:, rows, :-1])[:, both].T

    def isolated(self, marked: Bools) -> Bools:
        counts = np.pad(marked, 1).astype(np.uint8)
        counts = counts[:-2] + counts[1:-1] + counts[2:]
        single: Bools = counts[:, :-2] + counts[:, 1:-1] + counts[:, 2:] == 1
        return marked & single

    def smoothable(self, colours: Stack) -> tuple[Float32s, int]:
        return colours, self.size - int(np.count_nonzero(self.atlas.kind))

    def gaussian(self, scale: float) -> GridGaussian:
        return GridGaussian.of(self.atlas, scale, stop_at_holes=self.stops_at_holes, threads=self.threads)

    def refresh(self, stack: Stack) -> None:
        refresh_halo(stack, self.atlas)


def pick(planes: Array, samples: CellIndex) -> Array:
    """Cells of planes; rectangles are views, not copies."""
    if isinstance(samples, tuple):
        part: Array = planes[samples]
        return part
    flat = planes.reshape(*planes.shape[:-2], -1)
    picked = np.empty((*flat.shape[:-1], *samples.shape), planes.dtype)
    for rows in large_arrays.blocks(len(samples), SUMMED_ROWS):
        picked[..., rows, :] = flat[..., samples[rows]]
    return picked


def colours_at(planes: Float32s, cells: Indices) -> Float32s:
    """Return the colours of K cells (flat indices) in planes, shape (N, R, C), one row per cell."""
    colours = large_arrays.empty((len(cells), len(planes)), np.float32)
    for block in large_arrays.blocks(len(cells)):
        for k, plane in enumerate(planes):
            colours[block, k] = plane.take(cells[block])
    return colours


def _cut_cells_among(atlas: Atlas, samples: CellIndex) -> Int64s:
    """Return the cells at cuts among some cells, as flat indices of these."""
    if isinstance(samples, tuple):
        _, rows, columns = samples
        row, column = np.divmod(atlas.cut_cells, atlas.kind.shape[1])
        inside = (row >= rows.start) & (row < rows.stop) & (column >= columns.start) & (column < columns.stop)
        width = columns.stop - columns.start
        flat: Int64s = (row[inside] - rows.start) * width + column[inside] - columns.start
        return flat
    is_cut = np.zeros(atlas.kind.size, bool)
    is_cut[atlas.cut_cells] = True
    return np.flatnonzero(is_cut[samples.reshape(-1)])


def _local_scales(atlas: Atlas, window: int) -> Float32s:
    """Return the factor of squared lengths that scales the local spacing to 1, shape (R, C)."""
    rows, reach = atlas.kind.shape[0], window // 2
    scales = large_arrays.empty(atlas.kind.shape, np.float32)
    for band in large_arrays.blocks(rows, SUMMED_ROWS):
        first = max(0, band.start - reach)
        right, below = atlas.squared_lengths[:2, first : band.stop + reach]
        scales[band] = local_scale(right, below, reach)[band.start - first : band.stop - first]
    return scales


def _mean_spacing(atlas: Atlas, scale: Float32s) -> float:
    """Return the mean length of a local unit over the owned cells; 0 without any."""
    total, count = 0.0, 0
    for rows in large_arrays.blocks(len(atlas.kind), SUMMED_ROWS):
        spacing = 1 / np.sqrt(scale[rows][atlas.kind[rows] == OWNED])
        total, count = total + float(spacing.sum(dtype=np.float64)), count + len(spacing)
    return total / count if count else 0.0


def halo_repeats(atlas: Atlas, threads: int) -> Uint8s | None:
    """Return the number of cells that show each cell's texel, shape (R, C); None if all texels are shown once."""
    if not len(atlas.halo.cells):
        return None
    cells, sources = (np.ascontiguousarray(of, np.int64) for of in (atlas.halo.cells, atlas.halo.nearest))
    rows, columns = atlas.kind.shape
    repeats = large_arrays.kept(
        count_repeats(rows, columns, cells, sources, atlas.halo.seams, _REPEATS_REACH, threads)
    )
    return repeats if repeats.max(initial=1) > 1 else None
