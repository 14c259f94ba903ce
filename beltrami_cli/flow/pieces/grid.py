"""Rectangular pieces of a canvas."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.pieces.exchange import Advance
from beltrami_cli.flow.regularisation import guide_radius
from beltrami_cli.mesh.atlas import EMPTY, HALO, OWNED

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from beltrami_cli.flow.cell_fields import CellFields
    from beltrami_cli.flow.grid_metric import GridMetric
    from beltrami_cli.flow.parameters import KernelParameters
    from beltrami_cli.mesh.atlas import Atlas

# The paper's scheme looks for the support of an obtuse quadrant so many cells away.
_FURTHEST_SUPPORT = 10


@dataclass(frozen=True)
class GridFields:
    """A canvas as the flow has it.

    Attributes
    ----------
    atlas : Atlas
        With T owned cells, which are the samples.
    cells : CellFields
        Of the whole canvas.
    metric : GridMetric
        Of the whole canvas.
    channels : int
        How many of the values are colours, which the metric is made of.
    parameters : KernelParameters
        What to run with.
    scheme : str
        As the core takes it.
    """

    atlas: Atlas
    cells: CellFields
    metric: GridMetric
    channels: int
    parameters: KernelParameters
    scheme: str

    @property
    def margin(self) -> int:
        """How many cells around a cell its result in one iteration depends on."""
        parameters = self.parameters
        window = parameters.window // 2 + 1 + (_FURTHEST_SUPPORT if self.scheme == "metric" else 0)
        return window + (guide_radius(parameters.metric_scale) if parameters.metric_steps else 0)

    def sources(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return for each cell of the canvas the sample that it is, and the one whose value it has; -1: none."""
        number = np.full(self.atlas.kind.size, -1, np.int64)
        number[self.atlas.owned_cells] = np.arange(len(self.atlas.owned_cells))
        source = number.copy()
        source[self.atlas.halo_cells] = number[self.atlas.halo_nearest]
        return number, source


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
    fields : GridFields
        The whole canvas.
    core : Core
        The rectangle.
    number, source : ndarray of int64, shape (R * C,)
        As `GridFields.sources` tells.
    """

    def __init__(
        self, fields: GridFields, core: Core, number: NDArray[np.int64], source: NDArray[np.int64]
    ) -> None:
        atlas, margin = fields.atlas, fields.margin
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
        self._cells = fields.cells.at(cells)
        alone = _without_references(atlas, kind, self._lengths, np.flatnonzero(cut[cells.reshape(-1)]))
        self._metric = fields.metric.cut_out(alone, cells)
        self._beta, self._channels = fields.metric.beta, fields.channels
        self._parameters, self._scheme = fields.parameters, fields.scheme
        self.threads = fields.parameters.threads

    def advance(
        self, own: NDArray[np.float32], borrowed: NDArray[np.float32], iteration: int, threads: int
    ) -> Advance:
        """As for `Piece`."""
        from beltrami_cli._native import smooth_grid

        parameters = self._parameters
        planes = np.zeros((own.shape[1], *self._kind.shape), np.float32)
        values = np.concatenate([own, borrowed])
        flat = planes.reshape(len(planes), -1)
        for plane, channel in zip(flat, values.T, strict=True):
            plane[self._filled] = channel[self._rows]
        metric, beta = self._metric.join(
            planes[: self._channels],
            self._beta * parameters.growth(iteration),
            regularised=parameters.is_regularised(iteration),
        )
        smoothed, held = smooth_grid(
            self._kind, self._lengths, self._cells.scale, self._cells.repeats, metric, planes, beta, parameters.t,
            parameters.radius, parameters.window // 2, self._scheme, 0, threads, None,
        )  # fmt: skip
        made = smoothed.reshape(len(smoothed), -1)[:, self._own_cells]
        return Advance(np.ascontiguousarray(made.T), held, 0)


def cut_grid(fields: GridFields, count: int) -> list[GridPiece]:
    """Cut a canvas into up to `count` pieces with about the same number of owned cells."""
    number, source = fields.sources()
    return [GridPiece(fields, core, number, source) for core in _cores(fields.atlas.kind == OWNED, count)]


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
