"""Similar patches on a canvas, and its coarse levels."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from beltrami_cli._native import (
    PATCH_TILE_MARGIN,
    PATCH_TILE_SIDE,
    add_enlarged,
    collaborate_on_grid,
    convolve,
    means_of_squares,
)
from beltrami_cli.arrays import Bools, Float32s, Float64s, Int32s, Uint8s
from beltrami_cli.flow.chunks import Chunking, Figures
from beltrami_cli.flow.cuts import Rectangle, chunks_of_canvas, grown
from beltrami_cli.flow.manifolds.domain import CoarseLevel, Regions
from beltrami_cli.flow.manifolds.geometry import Stack
from beltrami_cli.flow.manifolds.grid.gaussian import gaussian_taps
from beltrami_cli.flow.manifolds.grid.margins import canvas_margin
from beltrami_cli.flow.mixing import Mixing
from beltrami_cli.flow.noise.drawing import draw_white
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import EMPTY, HALO, OWNED, Atlas, refresh_halo

# Seed of random means; an arbitrary number.
_SEED = 21


def collaborate_on_canvas(
    kind: Uint8s,
    stacks: Sequence[Stack],
    mixing: Mixing,
    threads: int,
    progress: Callable[[int], None] | None = None,
    *,
    replaces_pilot: bool = False,
    chunking: Chunking | None = None,
) -> Float32s:
    """Estimate the owned cells from similar patches.

    `stacks`: the noisy colours, the pilot on which patches are compared, and, if the noise varies, its variance
    relative to the mean.
    """
    noisy, pilot = stacks[:2]
    if chunking is None:
        estimates = pilot if replaces_pilot else large_arrays.empty(noisy.shape, np.float32)
        _write_estimates(kind, stacks, mixing, threads, estimates, progress)
        return estimates
    estimates = large_arrays.empty(noisy.shape, np.float32)
    # Groups start tile by tile. The order in which tiles add to a cell has a period of two tiles.
    before, after = 2 * PATCH_TILE_SIDE, PATCH_TILE_SIDE + PATCH_TILE_MARGIN
    cut, operation = partial(_part_for_patches, kind), partial(_estimate_part, mixing=mixing)
    chunks = chunks_of_canvas(cut, kind == OWNED, chunking.count, before, before, after)
    chunking.apply(chunks, operation, stacks, [estimates], progress, size=kind.size, threads=threads)
    return estimates


def _part_for_patches(kind: Uint8s, around: Rectangle, core: Rectangle) -> tuple[Uint8s, Rectangle]:
    """Cut out the kinds of cells; groups start only near `core`, the rectangle that is estimated."""
    part: Uint8s = kind[around].copy()
    # The groups of adjacent tiles reach the rectangle; cells beyond these only supply candidates.
    inside = np.zeros(part.shape, bool)
    inside[grown(core, PATCH_TILE_SIDE, PATCH_TILE_SIDE, part.shape)] = True
    part[(part == OWNED) & ~inside] = HALO
    return part, core


def _estimate_part(
    part: tuple[Uint8s, Rectangle], stacks: Sequence[Float32s], threads: int, mixing: Mixing
) -> tuple[list[Float32s], Figures]:
    (kind, core), estimates = part, large_arrays.empty(stacks[0].shape, np.float32)
    _write_estimates(kind, stacks, mixing, threads, estimates)
    return [estimates[core]], (0, 0)


def _write_estimates(
    kind: Uint8s,
    stacks: Sequence[Float32s],
    mixing: Mixing,
    threads: int,
    estimates: Float32s,
    progress: Callable[[int], None] | None = None,
) -> None:
    noisy, pilot, *relative = stacks

    def report(done: int) -> None:
        large_arrays.release_pages()
        if progress is not None:
            progress(done)

    variances = relative[0][0] if relative else None
    collaborate_on_grid(
        kind, noisy, pilot, mixing.parts, variances, mixing.has_pilot, estimates, threads, report
    )


@dataclass(eq=False)
class Squares(CoarseLevel, Regions):
    """Means over squares of cells of a canvas: of the owned cells in each, else of its halo cells."""

    axis: ClassVar[int] = 0

    atlas: Atlas
    side: int  # in cells
    threads: int
    cell_variances: Float32s | None = None  # of the noise, relative to the mean; None: the same everywhere
    chunking: Chunking | None = None
    width: float = 3.0

    def __post_init__(self) -> None:
        kinds, counts = sort_squares(self.atlas.kind, self.side)
        self.kinds, self.counts = large_arrays.kept(kinds), large_arrays.kept(counts)
        self.noise = 1 / self.side**2
        self.relative = np.broadcast_to(np.float32(1), self.kinds.shape)
        if self.cell_variances is not None:
            self.relative = self.means(self.cell_variances)[0]

    def means(self, stack: Float32s) -> Float32s:
        """Average planes, shape (N, R, C); 0 in empty squares."""
        means: Float32s = large_arrays.empty((len(stack), *self.kinds.shape), np.float32)
        for cells in self._blocks():
            for plane, mean in zip(stack[:, None], means, strict=True):
                rows, part = self.means_of_rows(plane[:, cells], cells)
                mean[rows] = part[0]
        return means

    def means_of_rows(self, planes: Float32s, rows: slice) -> tuple[slice, Float32s]:
        squares = slice(rows.start // self.side, -(-rows.stop // self.side))
        kind, kinds = self.atlas.kind[rows], self.kinds[squares]
        return squares, means_of_squares(kind, kinds, planes, self.side, self.threads)

    def _blocks(self) -> Iterator[slice]:
        """Slices of rows of cells, in whole squares."""
        rows, columns = self.atlas.kind.shape
        return large_arrays.blocks(rows, max(1, large_arrays.BLOCK // (self.side * columns)) * self.side)

    def collaborate(
        self, noisy: Stack, pilot: Stack, mixing: Mixing, progress: Callable[[int], None] | None = None, *,
        shared: bool = False,
    ) -> Stack:  # fmt: skip
        """Estimate means from patches; `shared` noise does not fall with the number of cells in a square."""
        stacks = [noisy, pilot]
        if not shared:
            fewer = np.maximum(self.counts, 1) * np.float32(self.noise)
            stacks.append((self.relative / fewer)[None])
        elif self.cell_variances is not None:
            stacks.append(self.relative[None])
        return collaborate_on_canvas(
            self.kinds, stacks, mixing, self.threads, progress, chunking=self.chunking
        )

    def probe(self, means: Stack, noise: Float64s) -> Stack:
        return draw_white(noise, means.shape[1:], np.random.default_rng(_SEED))

    def enlarged(self, planes: Float32s, rows: slice) -> Float32s:
        """Interpolate planes bilinearly between owned squares, at the owned cells of some rows; 0 in other cells."""
        # Include the squares above and below for interpolation.
        around = slice(max(0, rows.start // self.side - 1), -(-rows.stop // self.side) + 1)
        kind = self.atlas.kind[around.start * self.side : around.stop * self.side]
        cells = np.zeros((len(planes), *kind.shape), np.float32)
        add_enlarged(kind, self.kinds[around], planes[:, around], cells, self.side, self.threads)
        first = around.start * self.side
        return cells[:, rows.start - first : rows.stop - first]

    def add_enlarged_in_place(self, stack: Stack, changes: Stack) -> None:
        for rows in self._blocks():
            for plane, change in zip(stack, changes[:, None], strict=True):
                plane[rows] += self.enlarged(change, rows)[0]
        refresh_halo(stack, self.atlas)

    @property
    def shape(self) -> tuple[int, ...]:
        return self.kinds.shape

    def total(self, planes: Float32s) -> Float64s:
        return np.asarray(
            np.sum(planes * self.counts, axis=(1, 2), dtype=np.float64, where=self.kinds == OWNED)
        )

    def spread(self, planes: Float32s) -> Float32s:
        """Average planes over adjacent owned squares."""
        return convolve(planes * (self.kinds == OWNED), gaussian_taps(self.width), self.threads)


def largest_side(atlas: Atlas, parameters: KernelParameters) -> int:
    """Side up to which no square has cells of two charts."""
    has_one_chart = atlas.chart_of.max(initial=0) == 0
    return max(atlas.kind.shape) if has_one_chart else 2 * canvas_margin(parameters)


def sort_squares(kind: Uint8s, side: int) -> tuple[Uint8s, Float32s]:
    """Return the kind of each square, OWNED if any cell is owned, and its number of cells of that kind."""
    kinds = np.empty((-(-len(kind) // side), -(-kind.shape[1] // side)), np.uint8)
    counts = np.empty(kinds.shape, np.float32)
    for rows in large_arrays.blocks(len(kinds), max(1, large_arrays.BLOCK // (side * kind.shape[1]))):
        cells = kind[rows.start * side : rows.stop * side]
        owned, halo = (
            _sums_of_runs(_sums_of_runs(cells == wanted, side).T, side).T for wanted in (OWNED, HALO)
        )
        kinds[rows] = np.where(owned > 0, OWNED, np.where(halo > 0, HALO, EMPTY))
        counts[rows] = np.where(owned > 0, owned, halo)
    return kinds, counts


def _sums_of_runs(rows: Bools | Int32s, length: int) -> Int32s:
    sums = np.zeros((-(-len(rows) // length), rows.shape[1]), np.int32)
    for first in range(length):
        part = rows[first::length]
        sums[: len(part)] += part
    return sums
