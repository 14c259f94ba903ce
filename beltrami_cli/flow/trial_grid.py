"""A sample of a canvas on which iterations can be tried: some blocks of it, with a rim around each."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.octaves import draw_octaves, sigma_of_octaves
from beltrami_cli.flow.risk import wanted_probes
from beltrami_cli.surface.atlas import EMPTY, HALO, OWNED, refresh_halo

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from beltrami_cli.flow.cell_fields import CellFields
    from beltrami_cli.flow.grid_metric import GridMetric
    from beltrami_cli.flow.risk import Step
    from beltrami_cli.surface.atlas import Atlas, Indices

# Cells a side of the core of a block, whose result counts.
_CORE = 64

# Iterations carry what is wrong at a block's border inwards; most of a kernel's weight lies within so many cells.
_RIM = 8

# With any seed the choice is as good; with this one it is the same every time.
_SEED = 20


class GridTrial:
    """Blocks of a canvas, side by side on one of their own.

    Parameters
    ----------
    atlas : Atlas
        The canvas, R x C cells.
    planes : ndarray of float32, shape (N, R, C)
        Noisy colours, halo included.
    fields : CellFields
        Of the whole canvas.
    metric : GridMetric
        Of the whole canvas.
    iterate : callable
        Makes an iteration from the atlas, its fields, metric planes with their beta, colours and t.
    budget : int
        About how many cells to look at; a canvas with no more owned cells is taken whole.
    reach : int
        How far a cell's result in one iteration depends on others, in cells along rows and columns.
    octaves : ndarray of float64, shape (L, N, N), optional
        The noise that neighbouring cells have in common; without it, it is independent.

    Attributes
    ----------
    samples : int
        Cells whose result counts.
    """

    def __init__(
        self,
        atlas: Atlas,
        planes: NDArray[np.float32],
        fields: CellFields,
        metric: GridMetric,
        iterate: Callable[..., NDArray[np.float32]],
        budget: int,
        reach: int,
        octaves: NDArray[np.float64] | None = None,
    ) -> None:
        self._iterate = iterate
        if len(atlas.owned_cells) <= budget:
            self._atlas, self._fields, self._metric, self.start = atlas, fields, metric, planes
            self._scored = atlas.owned_cells
        else:
            cells, core = _blocks(atlas, budget, reach)
            self._atlas = _cut_out(atlas, cells, core, reach)
            self._fields = fields.at(cells)
            self.start = np.ascontiguousarray(planes.reshape(len(planes), -1)[:, cells])
            self.start[:, self._atlas.kind == EMPTY] = 0
            self._metric = metric.cut_out(self._atlas, cells)
            self._scored = np.flatnonzero(core & (self._atlas.kind == OWNED))
        self.samples = len(self._scored)
        self.signs = _perturbations(wanted_probes(self.samples), self.start.shape, octaves)
        self.signs[..., self._atlas.kind == EMPTY] = 0
        for planes in self.signs:
            refresh_halo(planes, self._atlas)

    def step(self, state: NDArray[np.float32], step: Step) -> NDArray[np.float32]:
        """Return the planes after an iteration."""
        metric = self._metric.join(state, step.beta, regularised=step.regularised)
        return self._iterate(self._atlas, self._fields, metric, state, step.t)

    def scored(self, state: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the colours of the cells that count, shape (samples, N)."""
        return state.reshape(len(state), -1)[:, self._scored].T


def _perturbations(
    count: int, shape: tuple[int, ...], octaves: NDArray[np.float64] | None
) -> NDArray[np.float32]:
    """Return random planes like the noise: signs, or what neighbours and channels have in common as they do."""
    random = np.random.default_rng(_SEED)
    if octaves is None:
        return (random.integers(0, 2, (count, *shape), np.int8) * 2 - 1).astype(np.float32)
    size = np.float32(np.sqrt(np.mean(np.square(sigma_of_octaves(octaves)))))
    return np.stack([draw_octaves(octaves, (shape[1], shape[2]), random) / size for _ in range(count)])


def _blocks(atlas: Atlas, budget: int, reach: int) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Choose blocks spread evenly over the owned cells.

    Returns
    -------
    cells : ndarray of int64, shape (blocks * side, side)
        The flat index of each cell on the canvas; for what lies beyond it that of its last cell, in the margin.
    core : ndarray of bool, shape (blocks * side, side)
        The cells whose results count.
    """
    rows, columns = atlas.kind.shape
    across = np.arange(0, columns, _CORE)
    bands = (atlas.kind[top : top + _CORE] == OWNED for top in range(0, rows, _CORE))
    held = np.cumsum([np.add.reduceat(band.sum(axis=0), across) for band in bands])
    wanted = max(1, budget // _CORE**2)
    chosen = np.unique(np.searchsorted(held, (np.arange(wanted) + 0.5) * held[-1] / wanted))
    top, left = np.divmod(chosen, -(-columns // _CORE))
    margin = _RIM + reach
    side = np.arange(-margin, _CORE + margin)
    row = (top[:, None] * _CORE + side)[:, :, None]
    column = (left[:, None] * _CORE + side)[:, None, :]
    on = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    cells = np.where(on, row * columns + column, atlas.kind.size - 1).reshape(-1, len(side))
    inside = (side >= 0) & (side < _CORE)
    core = np.tile(inside[:, None] & inside, (len(chosen), 1))
    return cells.astype(np.int64), core


def _cut_out(atlas: Atlas, cells: NDArray[np.int64], core: NDArray[np.bool_], reach: int) -> Atlas:
    """Return the atlas of blocks; what a block's border cuts off keeps its colours, as halo that is not refreshed."""
    kind = atlas.kind.reshape(-1)[cells]
    kind[cells == atlas.kind.size - 1] = EMPTY
    side = cells.shape[1]
    at = np.arange(side)
    inner = (at >= reach) & (at < side - reach)
    kind[(kind == OWNED) & ~np.tile(inner[:, None] & inner, (len(cells) // side, 1))] = HALO
    # A cell that is in several blocks is taken from the one whose core it is, and not from another's rim.
    owned = np.flatnonzero(kind == OWNED)
    order = np.lexsort([~core.reshape(-1)[owned], cells.reshape(-1)[owned]])
    owned = owned[order]
    mirrored = np.flatnonzero(kind != EMPTY)
    rank = _rank(atlas.halo_cells, cells.reshape(-1)[mirrored])
    mirrored, rank = mirrored[rank >= 0], rank[rank >= 0]
    place = _rank(cells.reshape(-1)[owned], atlas.halo_taps[rank])
    taps = np.where(place >= 0, owned[place], -1) if len(owned) else place
    whole = np.all((taps >= 0) | (atlas.halo_weights[rank] == 0), axis=1)
    nothing = np.zeros(0, np.int64)
    return dataclasses.replace(
        atlas,
        kind=kind,
        squared_lengths=np.ascontiguousarray(atlas.squared_lengths.reshape(4, -1)[:, cells]),
        cut_cells=np.flatnonzero(_rank(atlas.cut_cells, cells.reshape(-1)) >= 0),
        owned_cells=np.flatnonzero(kind == OWNED),
        halo_cells=mirrored[whole],
        halo_taps=np.maximum(taps[whole], 0).astype(np.int64),
        halo_weights=atlas.halo_weights[rank[whole]],
        halo_seams=atlas.halo_seams[rank[whole]],
        gutter_cells=nothing,
        gutter_texels=nothing,
    )


def _rank(ascending: Indices, wanted: Indices) -> NDArray[np.int64]:
    """Tell where numbers stand in an ascending list, the first of equal ones; -1: nowhere."""
    if not len(ascending):
        return np.full(wanted.shape, -1, np.int64)
    rank = np.minimum(np.searchsorted(ascending, wanted), len(ascending) - 1)
    return np.where(ascending[rank] == wanted, rank, -1)
