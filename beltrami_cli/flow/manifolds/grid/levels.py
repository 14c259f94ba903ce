"""Coarse levels of a canvas: means over squares of cells."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import ClassVar

import numpy as np

from beltrami_cli._native import add_enlarged, convolve, means_of_squares
from beltrami_cli.arrays import Bools, Float32s, Float64s, Int32s, Uint8s
from beltrami_cli.flow.chunks import Chunking
from beltrami_cli.flow.manifolds.domain import CoarseLevel, Regions
from beltrami_cli.flow.manifolds.geometry import Stack
from beltrami_cli.flow.manifolds.grid.gaussian import gaussian_taps
from beltrami_cli.flow.manifolds.grid.margins import canvas_margin
from beltrami_cli.flow.manifolds.grid.patches import collaborate_on_canvas
from beltrami_cli.flow.mixing import Mixing
from beltrami_cli.flow.noise.drawing import draw_white
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import EMPTY, HALO, OWNED, Atlas, refresh_halo

# Seed of random means; an arbitrary number.
_SEED = 21


class Squares(CoarseLevel, Regions):
    """Means over squares of cells of a canvas: of the owned cells in each, else of its halo cells."""

    axis: ClassVar[int] = 0

    def __init__(
        self, atlas: Atlas, side: int, threads: int, *,
        cell_variances: Float32s | None = None, chunking: Chunking | None = None, width: float = 3.0,
    ) -> None:  # fmt: skip
        """Sort squares of `side` cells; `cell_variances`: of the noise, relative to the mean, None: the same."""
        self.side, self.width = side, width
        self._atlas, self._threads, self._chunking = atlas, threads, chunking
        kinds, counts = sort_squares(atlas.kind, side)
        self._kinds, self._counts = large_arrays.kept(kinds), large_arrays.kept(counts)
        self._varies = cell_variances is not None
        self.relative_variances = np.broadcast_to(np.float32(1), kinds.shape)
        if cell_variances is not None:
            self.relative_variances = self.means(cell_variances)[0]

    @property
    def noise_ratio(self) -> float:
        return 1 / self.side**2

    def means(self, stack: Float32s) -> Float32s:
        """Average planes, shape (N, R, C); 0 in empty squares."""
        means: Float32s = large_arrays.empty((len(stack), *self._kinds.shape), np.float32)
        for cells in self._blocks():
            for plane, mean in zip(stack[:, None], means, strict=True):
                rows, part = self.means_of_rows(plane[:, cells], cells)
                mean[rows] = part[0]
        return means

    def means_of_rows(self, planes: Float32s, rows: slice) -> tuple[slice, Float32s]:
        squares = slice(rows.start // self.side, -(-rows.stop // self.side))
        kind, kinds = self._atlas.kind[rows], self._kinds[squares]
        return squares, means_of_squares(kind, kinds, planes, self.side, self._threads)

    def _blocks(self) -> Iterator[slice]:
        """Slices of rows of cells, in whole squares."""
        rows, columns = self._atlas.kind.shape
        return large_arrays.blocks(rows, max(1, large_arrays.BLOCK // (self.side * columns)) * self.side)

    def collaborate(
        self, noisy: Stack, pilot: Stack, mixing: Mixing, progress: Callable[[int], None] | None = None, *,
        shared: bool = False,
    ) -> Stack:  # fmt: skip
        """Estimate means from patches; `shared` noise does not fall with the number of cells in a square."""
        stacks = [noisy, pilot]
        if not shared:
            fewer = np.maximum(self._counts, 1) * np.float32(self.noise_ratio)
            stacks.append((self.relative_variances / fewer)[None])
        elif self._varies:
            stacks.append(self.relative_variances[None])
        return collaborate_on_canvas(
            self._kinds, stacks, mixing, self._threads, progress, chunking=self._chunking
        )

    def probe(self, means: Stack, noise: Float64s) -> Stack:
        return draw_white(noise, means.shape[1:], np.random.default_rng(_SEED))

    def enlarged(self, planes: Float32s, rows: slice) -> Float32s:
        """Interpolate planes bilinearly between owned squares, at the owned cells of some rows; 0 in other cells."""
        # Include the squares above and below for interpolation.
        around = slice(max(0, rows.start // self.side - 1), -(-rows.stop // self.side) + 1)
        kind = self._atlas.kind[around.start * self.side : around.stop * self.side]
        cells = np.zeros((len(planes), *kind.shape), np.float32)
        add_enlarged(kind, self._kinds[around], planes[:, around], cells, self.side, self._threads)
        first = around.start * self.side
        return cells[:, rows.start - first : rows.stop - first]

    def add_enlarged_in_place(self, stack: Stack, changes: Stack) -> None:
        for rows in self._blocks():
            for plane, change in zip(stack, changes[:, None], strict=True):
                plane[rows] += self.enlarged(change, rows)[0]
        refresh_halo(stack, self._atlas)

    @property
    def shape(self) -> tuple[int, ...]:
        return self._kinds.shape

    def total(self, planes: Float32s) -> Float64s:
        return np.asarray(
            np.sum(planes * self._counts, axis=(1, 2), dtype=np.float64, where=self._kinds == OWNED)
        )

    def spread(self, planes: Float32s) -> Float32s:
        """Average planes over adjacent owned squares."""
        return convolve(planes * (self._kinds == OWNED), gaussian_taps(self.width), self._threads)


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
