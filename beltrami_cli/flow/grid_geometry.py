"""The geometry of a regular grid: the cells of a texture atlas, or the pixels of one image."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, TypeAlias

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int64s, Uint8s
from beltrami_cli.flow.canvas import (
    ROWS,
    colours_at,
    halo_repeats,
    local_scales,
    mean_spacing,
    without_references,
)
from beltrami_cli.flow.chunks import Rectangle
from beltrami_cli.flow.clipping import ClippedChannels, find_clipped
from beltrami_cli.flow.domain import ENOUGH_STEPS, Geometry, KernelWork, Stack
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.flow.regularisation import GridGaussian, gaussian_taps
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import EMPTY, HALO, OWNED, Atlas, Indices, refresh_halo

# Standard deviation of one pass of a wide Gaussian, in cells, whose window the halo fills.
_SPREAD = 1.6


@dataclass(frozen=True, kw_only=True, eq=False)
class GridGeometry(Geometry):
    """Cells of an atlas; stacks are planes on its canvas."""

    axis: ClassVar[int] = 0
    width: ClassVar[float] = 6.0

    atlas: Atlas
    spacing: float
    # Factors of squared lengths that make the spacing around each cell 1
    scales: large_arrays.Droppable | None
    repeats: Uint8s | None  # how often each cell's texel is shown
    stops_at_holes: bool
    threads: int

    @classmethod
    def of(cls, atlas: Atlas, parameters: KernelParameters, *, stop_at_holes: bool) -> GridGeometry:
        measure, threads = partial(local_scales, atlas, parameters.window), parameters.thread_count
        scales = large_arrays.Droppable(measure(), measure)
        return cls(
            atlas=atlas, spacing=mean_spacing(atlas, scales.get()),
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

    @property
    def size(self) -> int:
        return self.atlas.kind.size

    @property
    def samples(self) -> Indices:
        return self.atlas.owned_cells

    @property
    def kind(self) -> Uint8s:
        return self.atlas.kind[None]

    def cut(self, samples: Cells, inside: Bools) -> GridGeometry:
        """Return a part, shape (R', C'); `inside`: mask of cells that have a kernel."""
        kind = pick(self.atlas.kind, samples).copy()
        kind[(kind == OWNED) & ~inside] = HALO
        lengths = large_arrays.Droppable(pick(self.atlas.squared_lengths, samples))
        atlas = dataclasses.replace(self.atlas, kind=kind, lengths=lengths)
        if isinstance(samples, Rectangle):
            rows = np.arange(samples.top, samples.bottom)[:, None] * self.atlas.kind.shape[1]
            atlas = without_references(atlas, self.atlas, rows + np.arange(samples.left, samples.right))
        elif not isinstance(samples, slice):
            atlas = without_references(atlas, self.atlas, samples)
        scales = None if self.scale is None else large_arrays.Droppable(pick(self.scale, samples))
        repeats = None if self.repeats is None else pick(self.repeats, samples)
        return dataclasses.replace(self, atlas=atlas, scales=scales, repeats=repeats)

    def work(self, unit: float) -> KernelWork:
        return KernelWork(self.kernels, unit)

    def take(self, stack: Stack, samples: Indices) -> Float32s:
        """Return the channels of some cells, by their flat indices, with a row a cell."""
        return colours_at(stack, samples)

    def steps(self, stack: Stack) -> Float32s:
        """Return differences between neighbours along rows, in evenly spread rows, shape (K, G)."""
        owned = self.atlas.kind == OWNED
        rows = np.arange(0, len(owned), max(1, int(np.count_nonzero(owned)) // ENOUGH_STEPS))
        both = owned[rows, :-1] & owned[rows, 1:]
        return (stack[:, rows, 1:] - stack[:, rows, :-1])[:, both].T

    def single(self, marked: Bools) -> Bools:
        """Return which of the marked cells, shape (R, C), have no marked ones among their eight neighbours."""
        counts = np.pad(marked, 1).astype(np.uint8)
        counts = counts[:-2] + counts[1:-1] + counts[2:]
        single: Bools = counts[:, :-2] + counts[:, 1:-1] + counts[:, 2:] == 1
        return marked & single

    def find_clipped(self, colours: Stack, sigma: Float64s) -> ClippedChannels | None:
        return find_clipped(colours, sigma, empty=self.size - int(np.count_nonzero(self.atlas.kind)))

    def gaussian(self, scale: float) -> GridGaussian:
        atlas, stops = self.atlas, self.stops_at_holes
        return GridGaussian.of(atlas.is_filled, scale, stop_at_holes=stops, atlas=atlas, threads=self.threads)

    def refresh(self, stack: Stack) -> None:
        refresh_halo(stack, self.atlas)

    def planes(self, count: int) -> Float32s:
        planes: Float32s = large_arrays.zeros((count, *self.atlas.kind.shape), np.float32)
        return planes

    def total(self, planes: Float32s) -> Float64s:
        kind, total = self.atlas.kind, np.zeros(len(planes))
        for rows in large_arrays.blocks(len(kind), ROWS):
            own = np.where(kind[rows] == OWNED, planes[:, rows], np.float32(0))
            total += own.sum(axis=(1, 2), dtype=np.float64)
        return total

    def spread(self, planes: Float32s) -> Float32s:
        """Average planes over the surface, in passes that reach as far as the halo."""
        from beltrami_cli._native import convolve_to

        taps = gaussian_taps(_SPREAD)
        reach, kind, threads = len(taps) // 2, self.atlas.kind, self.threads
        means, other = self.planes(len(planes)), self.planes(1)
        for plane, own in zip(planes[:, None], means[:, None], strict=True):
            before, after = own, other
            for rows in self._blocks():
                np.multiply(plane[:, rows], kind[rows] != EMPTY, out=before[:, rows])
            for _ in range(round((self.width / _SPREAD) ** 2)):
                for rows in self._blocks():
                    first = max(0, rows.start - reach)
                    around = slice(first, rows.stop + reach)
                    here, offset = before[:, around], rows.start - first
                    convolve_to(here, taps, offset, kind[around], after[:, rows], threads)
                self.refresh(after)
                before, after = after, before
            if before is not own:
                own[:] = before
        return means

    def _blocks(self) -> Iterator[slice]:
        """Go through the rows in blocks of `large_arrays.BLOCK` cells."""
        rows, columns = self.atlas.kind.shape
        return large_arrays.blocks(rows, max(ROWS, large_arrays.BLOCK // max(1, columns)))


Cells: TypeAlias = slice | Rectangle | Int64s
"""Some cells of a canvas: rows, a rectangle, or flat indices, shape (R', C')."""


def pick(planes: Array, samples: Cells) -> Array:
    """Return some cells of an array of planes."""
    if isinstance(samples, slice):
        return planes[..., samples, :]
    if isinstance(samples, Rectangle):
        return np.ascontiguousarray(planes[samples.index])
    flat = planes.reshape(*planes.shape[:-2], -1)
    picked = np.empty((*flat.shape[:-1], *samples.shape), planes.dtype)
    for rows in large_arrays.blocks(len(samples), ROWS):
        picked[..., rows, :] = flat[..., samples[rows]]
    return picked
