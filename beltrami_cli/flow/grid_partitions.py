"""Partitions of a grid: rectangles of a canvas, each with the margin that its kernels read."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s, Int64s
from beltrami_cli.flow.canvas import kernel_margin
from beltrami_cli.flow.grid_manifold import GridManifold
from beltrami_cli.flow.partitions import Advance
from beltrami_cli.flow.records import Step
from beltrami_cli.surface.atlas import EMPTY, OWNED, Atlas


@dataclass(frozen=True)
class Core:
    """The cells [top, bottom) x [left, right) of a canvas."""

    top: int
    bottom: int
    left: int
    right: int


class GridPartition:
    """The owned cells of a rectangle with a margin around it, a `Partition`."""

    def __init__(
        self,
        whole: GridManifold,
        core: Core,
        number: Int64s,  # of the sample in each cell of the canvas
        source: Int64s,  # number of the sample whose value the cell has
        steps: Sequence[Step],
        channels: int,
    ) -> None:
        margin, (rows, columns) = kernel_margin(whole.parameters), whole.geometry.atlas.kind.shape
        down = np.arange(max(0, core.top - margin), min(rows, core.bottom + margin))
        along = np.arange(max(0, core.left - margin), min(columns, core.right + margin))
        cells = (down[:, None] * columns + along).astype(np.int64)
        inside = ((down >= core.top) & (down < core.bottom))[:, None] & (
            (along >= core.left) & (along < core.right)
        )
        self._part = whole.cut(cells, inside)
        self._steps, self._channels, self.threads = tuple(steps), channels, whole.parameters.threads
        atlas = self._part.geometry.atlas
        self.owned = number[cells.reshape(-1)[atlas.owned_cells]]
        self._filled = np.flatnonzero(atlas.kind != EMPTY)
        drawn = source[cells.reshape(-1)[self._filled]]
        self.borrowed = np.setdiff1d(drawn, self.owned)
        # Both are ascending, so that a value is found by bisection.
        own_row = np.minimum(np.searchsorted(self.owned, drawn), max(0, len(self.owned) - 1))
        is_own = self.owned[own_row] == drawn
        self._rows = np.where(is_own, own_row, len(self.owned) + np.searchsorted(self.borrowed, drawn))

    def advance(self, own: Float32s, borrowed: Float32s, iteration: int, threads: int) -> Advance:
        parameters = dataclasses.replace(self._part.parameters, threads=threads)
        part, atlas = dataclasses.replace(self._part, parameters=parameters), self._part.geometry.atlas
        planes = np.zeros((own.shape[1], *atlas.kind.shape), np.float32)
        values = np.concatenate([own, borrowed])
        for plane, channel in zip(planes.reshape(len(planes), -1), values.T, strict=True):
            plane[self._filled] = channel[self._rows]
        metric = part.measure(planes[: self._channels], self._steps[iteration])
        averaged = part.average([planes], metric)
        return Advance(part.geometry.take(averaged.stacks[0], atlas.owned_cells), averaged.samples, 0)


def cut_grid(
    whole: GridManifold, count: int, widening: int, steps: Sequence[Step], channels: int
) -> list[GridPartition]:
    """Cut a canvas into up to `count` partitions with about the same number of owned cells and margins that suffice."""
    del widening
    atlas = whole.geometry.atlas
    number, source = _sources(atlas)
    cores = _cores(atlas.kind == OWNED, count)
    return [GridPartition(whole, core, number, source, steps, channels) for core in cores]


def _sources(atlas: Atlas) -> tuple[Int64s, Int64s]:
    """Return for each cell of the canvas its own sample, and the sample whose value it has; -1: none."""
    number = np.full(atlas.kind.size, -1, np.int64)
    number[atlas.owned_cells] = np.arange(len(atlas.owned_cells))
    source = number.copy()
    source[atlas.halo_cells] = number[atlas.halo_nearest]
    return number, source


def _cores(owned: Bools, count: int) -> Iterator[Core]:
    """Cut into bands of rows, and each band into columns, so that rectangles are about square and equally full."""
    rows, columns = owned.shape
    bands = int(np.clip(round((count * rows / max(1, columns)) ** 0.5), 1, count))
    shares = np.linspace(0, count, bands + 1).round().astype(int)
    borders = _even(owned.sum(axis=1), shares / count)
    for top, bottom, parts in zip(borders[:-1], borders[1:], np.diff(shares).tolist(), strict=True):
        if top == bottom:
            continue
        across = _even(owned[top:bottom].sum(axis=0), np.linspace(0, 1, parts + 1))
        for left, right in pairwise(across):
            if owned[top:bottom, left:right].any():
                yield Core(top, bottom, left, right)


def _even(counts: Int64s, shares: Float64s) -> list[int]:
    """Return borders between entries so that the sum before each is about its share of the total."""
    totals = np.concatenate([[0], np.cumsum(counts)])
    borders = np.searchsorted(totals, shares * totals[-1])
    borders[0], borders[-1] = 0, len(counts)
    return np.maximum.accumulate(borders).tolist()  # type: ignore[no-any-return]
