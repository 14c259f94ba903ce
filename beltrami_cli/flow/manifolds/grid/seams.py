"""Seams of a canvas at which colours jump, and where the canvas therefore ends."""

from __future__ import annotations

import numpy as np

from beltrami_cli._native import nearest_marked
from beltrami_cli.arrays import Bools, Float32s, Float64s, Indices, Int32s
from beltrami_cli.flow.noise.grid_squares import GridSquares
from beltrami_cli.flow.noise.reading import read_noise
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import OWNED, Atlas

# A jump counts if it is this many standard errors of the mean over the seam ...
_ERRORS = 4.0
# ... and this share of the noise: below, averaging over the seam still removes more noise than it adds bias ...
_OF_NOISE = 0.3
# ... and more than JPEG blocks and rounding leave between two charts of one continuous image.
_MIN_JUMP = 4 / 255
# Minimum number of steps over a seam to estimate their energy.
_MIN_STEPS = 8


def find_colour_jumps(atlas: Atlas, planes: Float32s, sigma: Float64s) -> Bools:
    """Whether the sides of each seam differ by more than noise, shape (S,)."""
    different = np.zeros(max(1, atlas.seams), bool)
    seam, steps, along = _steps_over_seams(atlas, planes)
    if not len(seam):
        return different
    order = np.argsort(seam, kind="stable")
    starts = np.flatnonzero(np.r_[True, seam[order][1:] != seam[order][:-1]])
    noise = float(np.sqrt(np.mean(np.square(sigma))))
    for first, last in zip(starts, np.r_[starts[1:], len(seam)], strict=True):
        members = order[first:last]
        jump = np.abs(np.median(steps[members], axis=0)).max()
        # A step between two noisy samples has the deviation sqrt(2) sigma. The error of a median is 1.25 times that of
        # a mean.
        error = 1.25 * np.sqrt(2) * noise / np.sqrt(len(members))
        shifted = jump > max(_ERRORS * error, _OF_NOISE * noise, _MIN_JUMP)
        different[seam[members[0]]] = shifted or _is_patterned(steps[members], along[members], noise)
    return different


def _steps_over_seams(atlas: Atlas, planes: Float32s) -> tuple[Int32s, Float32s, Float32s]:
    """Return the seam of each halo cell next to an owned cell, the step in colour to it, and the step before."""
    rows, columns = atlas.kind.shape
    flat_kind, flat = atlas.kind.reshape(-1), planes.reshape(len(planes), -1)
    seams: list[Int32s] = []
    over: list[Float32s] = []
    before: list[Float32s] = []
    of_seams = np.flatnonzero(atlas.halo.seams >= 0)
    for block in large_arrays.blocks(len(of_seams), large_arrays.SCATTERED):
        cells, reached = atlas.halo.cells[of_seams[block]], atlas.halo.seams[of_seams[block]]
        for step in (1, -1, columns, -columns):
            inner, second = cells - step, cells - 2 * step
            valid = (second >= 0) & (second < rows * columns) & (inner >= 0) & (inner < rows * columns)
            valid[valid] &= (flat_kind[inner[valid]] == OWNED) & (flat_kind[second[valid]] == OWNED)
            seams.append(reached[valid])
            over.append((flat[:, cells[valid]] - flat[:, inner[valid]]).T)
            before.append((flat[:, inner[valid]] - flat[:, second[valid]]).T)
    if not seams:
        nothing = np.zeros((0, len(planes)), np.float32)
        return np.zeros(0, np.int32), nothing, nothing
    return np.concatenate(seams), np.concatenate(over), np.concatenate(before)


def _is_patterned(steps: Float32s, nearby: Float32s, noise: float) -> bool:
    """Detect a jump that changes its sign along the seam: steps across it have more energy than steps next to it.

    Neighbours may share noise, as in JPEG images, but not across a seam, which adds to the energy there.
    """
    if len(steps) < _MIN_STEPS:
        return False
    across, along = np.square(steps).mean(axis=1), np.square(nearby).mean(axis=1)
    error = float((across - along).std()) / np.sqrt(len(steps))
    excess = across.mean() - max(along.mean(), 2 * noise**2)
    return bool(excess > max(_ERRORS * error, (_OF_NOISE * noise) ** 2 + _MIN_JUMP**2))


def halo_beyond(atlas: Atlas, different: Bools) -> Bools:
    """Which halo cells, shape (H,), lie beyond the seams marked in `different`, shape (S,)."""
    # Near a corner of several charts a cell may be reached over two seams; either may be marked.
    seams = atlas.halo.seams
    beyond = (seams >= 0) & different[np.maximum(seams, 0)]
    if not beyond.any():
        return beyond
    reached = _charts_at(atlas, atlas.halo.nearest)
    sides = _sides_of_seams(atlas, reached)
    jumps = {tuple(pair) for seam, pair in enumerate(np.sort(sides, axis=1).tolist()) if different[seam]}
    # Cells of a third chart, grouped by chart and seam.
    third = (seams >= 0) & ~beyond & (reached[:, None] != sides[seams]).all(axis=1)
    for seam, chart in {*zip(seams[third].tolist(), reached[third].tolist(), strict=True)}:
        if any((min(chart, side), max(chart, side)) in jumps for side in sides[seam].tolist()):
            beyond |= third & (seams == seam) & (reached == chart)
    return beyond


def _charts_at(atlas: Atlas, cells: Indices) -> Int32s:
    """Return the charts of cells; -1 for cells that are not owned."""
    charts = np.full(len(cells), -1, np.int32)
    for block in large_arrays.blocks(len(cells) if len(atlas.owned_cells) else 0, large_arrays.SCATTERED):
        numbers = cells[block]
        rank = np.minimum(np.searchsorted(atlas.owned_cells, numbers), len(atlas.owned_cells) - 1)
        owned = atlas.owned_cells[rank] == numbers
        charts[block][owned] = atlas.chart_of[rank[owned]]
    return charts


def _sides_of_seams(atlas: Atlas, reached: Int32s) -> Int32s:
    """Return the two charts of each seam, shape (S, 2): of an owned cell and of the halo cell next to it."""
    kind, columns = atlas.kind.reshape(-1), atlas.kind.shape[1]
    of_seams = np.flatnonzero(atlas.halo.seams >= 0)
    cells, seams = atlas.halo.cells[of_seams], atlas.halo.seams[of_seams]
    inner, halo = np.full((2, max(1, atlas.seams)), -1, cells.dtype)
    for step in (1, -1, columns, -columns):
        # The first and the last cell of a canvas are in its margin.
        is_owned = kind.take(cells - step, mode="clip") == OWNED
        inner[seams[is_owned]], halo[seams[is_owned]] = cells[is_owned] - step, of_seams[is_owned]
    known = np.flatnonzero(halo >= 0)
    sides = np.full((len(halo), 2), -1, np.int32)
    sides[known] = np.column_stack([_charts_at(atlas, inner[known]), reached[halo[known]]])
    return sides


def end_at_seams_in_place(planes: Float32s, atlas: Atlas, threads: int) -> None:
    """Extend a guide as a constant over the seams whose sides differ."""
    sigma = read_noise(planes, GridSquares.of(atlas.is_owned), varies=False).sigma
    beyond = atlas.halo.cells[halo_beyond(atlas, find_colour_jumps(atlas, planes, sigma))]
    if len(beyond):
        is_beyond = np.zeros(atlas.kind.shape, bool)
        is_beyond.reshape(-1)[beyond] = True
        cells, nearest = nearest_marked(atlas.is_owned, is_beyond, max(atlas.kind.shape), threads)
        flat = planes.reshape(len(planes), -1)
        flat[:, cells] = flat[:, nearest]
