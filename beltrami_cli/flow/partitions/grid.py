"""Rectangular pieces of a canvas."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.canvas import apply_kernel
from beltrami_cli.flow.partitions.exchange import Advance
from beltrami_cli.surface.atlas import EMPTY, HALO, OWNED

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from beltrami_cli.flow.canvas import Canvas
    from beltrami_cli.surface.atlas import Atlas


@dataclass(frozen=True)
class Core:
    """The cells [top, bottom) x [left, right) of a canvas."""

    top: int
    bottom: int
    left: int
    right: int


class GridPiece:
    """The owned cells of a rectangle with a margin around it, as a canvas of its own.

    Parameters
    ----------
    canvas : Canvas
        The whole canvas.
    core : Core
        The rectangle.
    number, source : ndarray of int64, shape (R * C,)
        As `_sources` tells.
    """

    def __init__(
        self, canvas: Canvas, core: Core, number: NDArray[np.int64], source: NDArray[np.int64]
    ) -> None:
        atlas, margin = canvas.atlas, canvas.margin
        rows, columns = atlas.kind.shape
        down = np.arange(max(0, core.top - margin), min(rows, core.bottom + margin))
        along = np.arange(max(0, core.left - margin), min(columns, core.right + margin))
        cells = (down[:, None] * columns + along).astype(np.int64)
        inside = ((down >= core.top) & (down < core.bottom))[:, None] & (
            (along >= core.left) & (along < core.right)
        )
        kind = atlas.kind.reshape(-1)[cells]
        kind[(kind == OWNED) & ~inside] = HALO  # which lends its value, and has no kernel
        self._own_cells = np.flatnonzero(kind == OWNED)
        self.owned = number[cells.reshape(-1)[self._own_cells]]
        self._filled = np.flatnonzero(kind != EMPTY)
        drawn = source[cells.reshape(-1)[self._filled]]
        self.borrowed = np.setdiff1d(drawn, self.owned)
        # Both are ascending, so that a value is found by bisection.
        own_row = np.minimum(np.searchsorted(self.owned, drawn), max(0, len(self.owned) - 1))
        is_own = self.owned[own_row] == drawn
        self._rows = np.where(is_own, own_row, len(self.owned) + np.searchsorted(self.borrowed, drawn))
        cut = np.zeros(atlas.kind.size, bool)
        cut[atlas.cut_cells] = True
        self._lengths = np.ascontiguousarray(atlas.squared_lengths.reshape(4, -1)[:, cells])
        self._kind = kind
        self._cells = canvas.cells.at(cells)
        alone = _without_references(atlas, kind, self._lengths, np.flatnonzero(cut[cells.reshape(-1)]))
        self._metric = canvas.metric.cut_out(alone, cells)
        self._beta, self._channels = canvas.metric.beta, canvas.channels
        self._parameters = canvas.parameters
        self.threads = canvas.parameters.threads

    def advance(
        self, own: NDArray[np.float32], borrowed: NDArray[np.float32], iteration: int, threads: int
    ) -> Advance:
        """As for `Piece`."""
        parameters = self._parameters
        planes = np.zeros((own.shape[1], *self._kind.shape), np.float32)
        values = np.concatenate([own, borrowed])
        flat = planes.reshape(len(planes), -1)
        for plane, channel in zip(flat, values.T, strict=True):
            plane[self._filled] = channel[self._rows]
        metric = self._metric.join(
            planes[: self._channels],
            self._beta * parameters.growth(iteration),
            regularised=parameters.is_regularised(iteration),
        )
        smoothed, held = apply_kernel(
            self._kind, self._lengths, self._cells, metric, planes, parameters, threads
        )
        made = smoothed.reshape(len(smoothed), -1)[:, self._own_cells]
        return Advance(np.ascontiguousarray(made.T), held, 0)


def cut_grid(canvas: Canvas, count: int) -> list[GridPiece]:
    """Cut a canvas into up to `count` pieces with about the same number of owned cells."""
    number, source = _sources(canvas.atlas)
    return [GridPiece(canvas, core, number, source) for core in _cores(canvas.atlas.kind == OWNED, count)]


def _sources(atlas: Atlas) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return for each cell of the canvas the sample that it is, and the one whose value it has; -1: none."""
    number = np.full(atlas.kind.size, -1, np.int64)
    number[atlas.owned_cells] = np.arange(len(atlas.owned_cells))
    source = number.copy()
    source[atlas.halo_cells] = number[atlas.halo_nearest]
    return number, source


def _cores(owned: NDArray[np.bool_], count: int) -> Iterator[Core]:
    """Cut into bands of rows, and each band into columns, so that rectangles are about square and equally full."""
    rows, columns = owned.shape
    bands = int(np.clip(round((count * rows / max(1, columns)) ** 0.5), 1, count))
    shares = np.linspace(0, count, bands + 1).round().astype(int)
    borders = _even(owned.sum(axis=1), shares / count)
    for top, bottom, pieces in zip(borders[:-1], borders[1:], np.diff(shares).tolist(), strict=True):
        if top == bottom:
            continue
        across = _even(owned[top:bottom].sum(axis=0), np.linspace(0, 1, pieces + 1))
        for left, right in pairwise(across):
            if owned[top:bottom, left:right].any():
                yield Core(top, bottom, left, right)


def _even(counts: NDArray[np.int64], shares: NDArray[np.float64]) -> list[int]:
    """Return borders between entries so that what lies before each is about its share of all."""
    held = np.concatenate([[0], np.cumsum(counts)])
    borders = np.searchsorted(held, shares * held[-1])
    borders[0], borders[-1] = 0, len(counts)
    return np.maximum.accumulate(borders).tolist()  # type: ignore[no-any-return]


def _without_references(
    atlas: Atlas, kind: NDArray[np.uint8], lengths: NDArray[np.float32], cut_cells: NDArray[np.int64]
) -> Atlas:
    """Return the atlas of a rectangle, whose halo others refresh."""
    nothing = np.zeros(0, np.int64)
    return dataclasses.replace(
        atlas,
        kind=kind,
        squared_lengths=lengths,
        cut_cells=cut_cells,
        owned_cells=np.flatnonzero(kind == OWNED),
        owned_texels=nothing,
        halo_cells=nothing,
        halo_taps=np.zeros((0, 4), np.int64),
        halo_weights=np.zeros((0, 4), np.float32),
        halo_seams=np.zeros(0, np.int32),
        gutter_cells=nothing,
        gutter_texels=nothing,
        chart_of=np.zeros(0, np.int32),
    )
