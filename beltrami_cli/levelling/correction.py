"""Correction of exposure steps, which preserves the mean of the corrected colours.

JPEG mixes hues at the borders of charts with colours beyond: a decoder interpolates subsampled chroma, so that texels
near a border contain some of the colour beyond it, which may have another exposure. Such hues are extrapolated from
further inside the chart. Brightness is stored for each texel, and is not extrapolated.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s, Indices, Int32s, Int64s
from beltrami_cli.levelling.exposures import (
    VISIBLE,
    Exposures,
    Verdict,
    fit_exposures,
    have_steps,
    judge,
    squared_steps,
)
from beltrami_cli.levelling.steps import (
    RIDGE,
    ChartPlaces,
    Steps,
    positions_of,
    steps_over_edges,
    steps_over_seams,
    weighted_median,
)
from beltrami_cli.quantities import BYTE_STEP
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import OWNED, Atlas, refresh_halo
from beltrami_cli.surface.colour_values import limits_of
from beltrami_cli.surface.grouping import connected
from beltrami_cli.surface.gutters import within

Samples = Callable[[Int64s], tuple[Float32s, Indices, Float64s]]

LUMA = np.array([0.299, 0.587, 0.114])  # of BT.601, as JPEG has it


@dataclass(frozen=True)
class SeamFacts:
    """The number of seams between different charts, of those with steps, and the median of the steps."""

    seams: int = 0
    stepped: int = 0
    edges: int = 0
    before: float = 0.0
    after: float = 0.0


@dataclass(frozen=True)
class Levelled:
    """Findings on exposure steps; `exposures` is None if nothing is to be changed."""

    verdict: Verdict | None
    exposures: Exposures | None
    facts: SeamFacts
    groups: Indices  # (charts,): group of each chart; seams without outliers join charts


def judge_steps(steps: Steps, fixed: Bools | None = None) -> Verdict | None:
    """Decide whether the charts differ in exposure; None if there are no steps."""
    return judge(steps, fixed) if steps.between.any() and have_steps(steps) else None


def find_exposures(
    steps: Steps, verdict: Verdict | None, strength: float, fixed: Bools | None = None
) -> Levelled:
    """Fit the exposures of charts if the verdict is that there are any; `fixed` charts are not changed."""
    if not steps.between.any():
        return Levelled(None, None, SeamFacts(), np.arange(steps.charts))
    if verdict is None:
        return Levelled(None, None, _facts(steps, Exposures.none(steps), 0.0), np.arange(steps.charts))
    found = fit_exposures(steps, verdict.spread, fixed)
    if not verdict.is_sure:
        return Levelled(verdict, None, _facts(steps, found, 0.0), np.arange(steps.charts))
    groups = connected(steps.charts, steps.ends[found.weights > 0])
    return Levelled(verdict, found, _facts(steps, found, strength), groups)


def _facts(steps: Steps, found: Exposures, strength: float) -> SeamFacts:
    inside = steps.between
    between, outliers = steps.part(inside), found.are_outliers(steps)[inside]
    _, first, seam = np.unique(between.seams, return_index=True, return_inverse=True)
    changed = between.colours + strength * (found.sides(between) - between.colours)
    before, after = (np.sqrt(squared_steps(between, each, seam)) for each in (between.colours, changed))
    texels = np.bincount(seam, between.counts).astype(np.float64)
    return SeamFacts(
        seams=len(first),
        stepped=int(np.count_nonzero(before > VISIBLE)),
        edges=int(np.count_nonzero(outliers[first])),
        before=weighted_median(before, texels),
        after=weighted_median(after, texels),
    )


class Correction:
    """Removes exposures from colours, with a strength in [0, 1]."""

    def __init__(self, levelled: Levelled, strength: float, fixed: Bools | None = None) -> None:
        assert levelled.exposures is not None
        self._found, self._strength = levelled.exposures, strength
        channels, charts, _ = levelled.exposures.terms.shape
        self._shift = np.zeros((charts, channels))
        fixed = np.zeros(charts, bool) if fixed is None else fixed
        self._moved = np.asarray(levelled.exposures.terms.any(axis=(0, 2))) & ~fixed
        self._is_free = self._moved & ~np.isin(levelled.groups, levelled.groups[fixed])

    def of(self, colours: Float32s, charts: Indices, places: Float64s) -> Float32s:
        """Return the corrected colours, shape (K, N), at places in charts."""
        factor, offset = self._found.at(charts, places)
        moved = self._moved[charts]
        after = np.empty_like(colours)
        for channel, column in enumerate(colours.T):
            full = (column - offset[channel]) / factor[channel] + self._shift[charts, channel]
            after[:, channel] = np.where(moved, column + self._strength * (full - column), column)
        return after

    def keep_means(self, count: int, samples: Samples) -> float:
        """Preserve the mean of charts that are not joined to fixed ones; return the mean change, 0 if invisible.

        Groups of charts share one mean, even if no seam joins them. Preserving the mean of each group would preserve
        the exposures of its largest charts; that all terms are drawn to 0 is the better guess.
        """
        areas, change = np.zeros(len(self._shift)), np.zeros_like(self._shift)
        for charts, difference in self._changes(count, samples):
            areas += np.bincount(charts, minlength=len(areas))
            change += np.column_stack([np.bincount(charts, each, len(areas)) for each in difference.T])
        mean = change[self._is_free].sum(axis=0) / max(1, areas[self._is_free].sum())
        self._shift[self._is_free] = -mean / max(self._strength, np.finfo(float).tiny)
        total = sum(float(np.abs(difference).sum()) for _, difference in self._changes(count, samples))
        mean_change = total / max(1.0, float(areas.sum()) * change.shape[1])
        return mean_change if mean_change >= BYTE_STEP / 2 else 0.0

    def _changes(self, count: int, samples: Samples) -> Iterator[tuple[Indices, Float64s]]:
        """Yield the charts of evenly spread samples, and the change of their colours."""
        rows = np.arange(0, count, max(1, count // large_arrays.BLOCK))
        for block in large_arrays.blocks(len(rows), large_arrays.CACHED):
            colours, charts, places = samples(rows[block])
            yield charts, (self.of(colours, charts, places) - colours).astype(np.float64)


def level_canvas(
    atlas: Atlas, planes: Float32s, strength: float, fixed: Bools | None, spans: Sequence[int] = ()
) -> tuple[Levelled, float]:
    """Remove exposures from planes, shape (N, R, C), in place; return also the mean change, 0 without a correction.

    `spans`: the maximum number of texels per stored hue of each texture; brightness is stored for every texel.
    """
    places, flat = ChartPlaces.of(atlas), planes.reshape(len(planes), -1)
    steps = steps_over_seams(atlas, planes, places)
    verdict = judge_steps(steps, fixed)
    # Hues extrapolated over more texels are less certain; mixed hues, too, must show whether there are exposures.
    if verdict is not None and verdict.is_sure and max(spans, default=1) > 1:
        mixed = mixed_cells(atlas, spans)
        before = continue_hues(atlas, planes, mixed, max(spans))
        steps = steps_over_seams(atlas, planes, places)
        verdict = judge_steps(steps, fixed)
        flat[:, mixed] = before
    found = find_exposures(steps, verdict, strength, fixed)

    def samples(rows: Int64s | slice) -> tuple[Float32s, Indices, Float64s]:
        cells, charts = atlas.owned_cells[rows], atlas.chart_of[rows]
        return flat[:, cells].T, charts, places.at(positions_of(atlas, cells), charts)

    change = 0.0
    if found.exposures is not None:
        correction = Correction(found, strength, fixed)
        change = correction.keep_means(len(atlas.owned_cells), samples)
        for block in large_arrays.blocks(len(atlas.owned_cells) if change else 0, large_arrays.SCATTERED):
            flat[:, atlas.owned_cells[block]] = correction.of(*samples(block)).T
    refresh_halo(planes, atlas)
    return found, change


def level_mesh(
    positions: Float64s, faces: Int32s, colours: Float32s, photographs: Int64s, strength: float
) -> tuple[Levelled, float, Float32s]:
    """Remove exposures from the colours of vertices, shape (S, N), each from one photograph."""
    steps, charts, places = steps_over_edges(positions, faces, colours.astype(np.float64), photographs)
    found = find_exposures(steps, judge_steps(steps), strength)
    if found.exposures is None:
        return found, 0.0, colours
    correction = Correction(found, strength)
    change = correction.keep_means(len(colours), lambda rows: (colours[rows], charts[rows], places[rows]))
    return found, change, correction.of(colours, charts, places) if change else colours


def mixed_cells(atlas: Atlas, spans: Sequence[int]) -> Int64s:
    """Return the owned cells (flat indices) so close to a border of a chart that a decoder mixed their hue."""
    found, (rows, columns), reach = [np.zeros(0, np.int64)], atlas.kind.shape, max(spans)
    for band in large_arrays.blocks(rows, large_arrays.ROWS):
        first = max(0, band.start - reach)
        owned = atlas.kind[first : band.stop + reach] == OWNED
        near = owned & within(~owned, reach)
        inside = near[band.start - first :][: band.stop - band.start]
        found.append(np.flatnonzero(inside) + band.start * columns)
    cells = np.concatenate(found)
    texels = atlas.owned_texels[np.searchsorted(atlas.owned_cells, cells)]
    texture = np.searchsorted(atlas.texture_offsets, texels, side="right") - 1
    return np.asarray(cells[np.asarray(spans)[texture] > 1])


def continue_hues(atlas: Atlas, planes: Float32s, cells: Int64s, span: int) -> Float32s:
    """Replace the hue of mixed cells by that extrapolated from the cells behind; return the old colours."""
    flat, limits = planes.reshape(len(planes), -1), limits_of(planes)
    before = flat[:, cells]
    # The chart of each cell that is not mixed, counted from 1.
    clear = large_arrays.zeros(flat.shape[1], np.int32)
    for block in large_arrays.blocks(len(atlas.owned_cells), large_arrays.SCATTERED):
        clear[atlas.owned_cells[block]] = atlas.chart_of[block] + 1
    charts = clear[cells]
    clear[cells] = 0
    for block in large_arrays.blocks(len(cells), large_arrays.CACHED):
        colours, is_known = _continued(flat, clear, cells[block], charts[block], atlas.kind.shape[1], span)
        own = before[:, block].T
        hued = (colours + ((own - colours) @ LUMA)[:, None]).clip(*limits)
        flat[:, cells[block]] = np.where(is_known[:, None], hued, own).T
    return before


def _continued(
    flat: Float32s, clear: Int32s, cells: Int64s, charts: Int32s, columns: int, span: int
) -> tuple[Float64s, Bools]:
    """Extrapolate colours to cells by linear regression on nearby unmixed cells; return also where these suffice."""
    moments = np.zeros((len(cells), 3, 3))
    products = np.zeros((len(cells), 3, len(flat)))
    reach = 2 * span + 1  # twice the width of mixed colours
    for down, right in np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1).T.tolist():
        at = (cells + down * columns + right).clip(0, flat.shape[1] - 1)
        rows = np.flatnonzero(clear[at] == charts)
        place = np.array([1.0, down, right])
        moments[rows] += np.outer(place, place)
        products[rows] += place[:, None] * flat[:, at[rows]].T[:, None]
    is_known = moments[:, 0, 0] >= 2 * len(place)  # cells for each unknown of the regression
    drawn = RIDGE * (moments[:, 1, 1] + moments[:, 2, 2])
    for axis in (1, 2):
        moments[:, axis, axis] += drawn
    moments[~is_known] = np.eye(3)
    return np.asarray(np.linalg.solve(moments, products)[:, 0], np.float64), is_known
