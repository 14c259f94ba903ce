"""Means of squares of cells of a canvas, at which patches see further; colours reach over seams as halo does."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s, Int32s, Uint8s
from beltrami_cli.flow.canvas import canvas_margin, collaborate_on_canvas
from beltrami_cli.flow.domain import CoarseLevel, Mixing, Stack
from beltrami_cli.flow.noise.haar_noise import mixed_signs
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.flow.regularisation import gaussian_taps
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import EMPTY, HALO, OWNED, Atlas, refresh_halo

# Of random means; any is as good.
_SEED = 21


class Squares(CoarseLevel):
    """Means of squares of cells of a canvas: of the owned cells of each, or of halo where there are no such."""

    axis: ClassVar[int] = 0
    width: ClassVar[float] = 3.0

    def __init__(
        self,
        atlas: Atlas,
        side: int,
        threads: int,
        relative: Float32s | None,
        tick: Callable[[], None] | None = None,
    ) -> None:
        self._atlas, self._side, self._threads = atlas, side, threads
        self._report = None if tick is None else lambda _: tick()
        kinds, counts = sort_squares(atlas.kind, side)
        self.kinds, self._counts = large_arrays.kept(kinds), large_arrays.kept(counts)
        self.noise = 1 / side**2
        self._differing = None if relative is None else self.means(relative)[0]
        ones: Float32s = large_arrays.empty(self.kinds.shape, np.float32)
        ones.fill(1)
        self.relative = ones if self._differing is None else self._differing

    def means(self, stack: Float32s) -> Float32s:
        """Return the means of planes, shape (N, R, C); 0 in empty squares."""
        from beltrami_cli._native import means_of_squares

        kind, threads = self._atlas.kind, self._threads
        means: Float32s = large_arrays.empty((len(stack), *self.kinds.shape), np.float32)
        for rows in large_arrays.blocks(len(self.kinds), self._rows_at_once):
            cells = self._cells(rows)
            for plane, own in zip(stack[:, None], means, strict=True):
                own[rows] = means_of_squares(
                    kind[cells], self.kinds[rows], plane[:, cells], self._side, threads
                )[0]
        return means

    @property
    def _rows_at_once(self) -> int:
        cells: int = self._side**2 * self.kinds.shape[1]
        return max(1, large_arrays.BLOCK // cells)

    def _cells(self, rows: slice) -> slice:
        return slice(rows.start * self._side, rows.stop * self._side)

    def collaborate(self, noisy: Stack, pilot: Stack, mixing: Mixing, *, shared: bool = False) -> Stack:
        """Estimate means from patches; noise that cells share is no smaller where a square has more of them."""
        relative = None if self._differing is None else self._differing[None]
        if not shared:
            fewer = np.maximum(self._counts, 1) * np.float32(self.noise)
            relative = (self.relative / fewer)[None]
        return collaborate_on_canvas(
            self.kinds, noisy, pilot, mixing, self._threads, self._report, relative=relative
        )

    def probe(self, means: Stack, noise: Float64s) -> Stack:
        return mixed_signs(noise, means.shape[1:], np.random.default_rng(_SEED))

    def add_enlarged(self, stack: Stack, changes: Stack) -> None:
        """Add changes of squares to their owned cells, bilinear between the squares that have such."""
        from beltrami_cli._native import add_enlarged

        atlas, threads = self._atlas, self._threads
        for rows in large_arrays.blocks(len(self.kinds), self._rows_at_once):
            # With those above and below, between whose changes their cells lie.
            around = slice(max(0, rows.start - 1), min(len(self.kinds), rows.stop + 1))
            cells, first = self._cells(rows), self._cells(around).start
            kind, kinds = atlas.kind[self._cells(around)], self.kinds[around]
            for plane, change in zip(stack, changes[:, None], strict=True):
                part = plane[None, self._cells(around)].copy()
                add_enlarged(kind, kinds, change[:, around], part, self._side, threads)
                plane[cells] = part[0, cells.start - first : cells.stop - first]
        refresh_halo(stack, atlas)

    def planes(self, count: int) -> Float32s:
        planes: Float32s = large_arrays.zeros((count, *self.kinds.shape), np.float32)
        return planes

    def total(self, planes: Float32s) -> Float64s:
        return np.asarray(
            np.sum(planes * self._counts, axis=(1, 2), dtype=np.float64, where=self.kinds == OWNED)
        )

    def spread(self, planes: Float32s) -> Float32s:
        """Average planes over the owned squares around."""
        from beltrami_cli._native import convolve

        return convolve(planes * (self.kinds == OWNED), gaussian_taps(self.width), self._threads)


def squares_for(
    atlas: Atlas,
    parameters: KernelParameters,
    most: int,
    relative: Float32s | None,
    tick: Callable[[], None] | None = None,
) -> list[Squares]:
    """Return up to `most` levels of squares, fine to coarse, as far as none holds cells of two charts."""
    one_chart = atlas.chart_of.max(initial=0) == 0
    apart = max(atlas.kind.shape) if one_chart else 2 * canvas_margin(parameters)
    sides = (2**level for level in range(1, most + 1))
    return [Squares(atlas, side, parameters.thread_count, relative, tick) for side in sides if side <= apart]


def sort_squares(kind: Uint8s, side: int) -> tuple[Uint8s, Float32s]:
    """Return the kind of each square, OWNED if a cell is, and how many of its cells are of that kind."""
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
