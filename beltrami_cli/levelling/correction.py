"""Correction of exposure steps, which preserves the mean of the corrected colours."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s, Indices, Int32s, Int64s
from beltrami_cli.levelling.exposures import Exposures, fit_exposures, squared_steps
from beltrami_cli.levelling.hues import continue_hues_in_place, mixed_cells
from beltrami_cli.levelling.judgement import VISIBLE, Verdict, judge_steps
from beltrami_cli.levelling.steps import (
    ChartPlaces,
    Steps,
    positions_of,
    steps_over_edges,
    steps_over_seams,
    weighted_median,
)
from beltrami_cli.quantities import BYTE_STEP
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import Atlas, refresh_halo
from beltrami_cli.surface.grouping import connected

Samples = Callable[[Int64s], tuple[Float32s, Indices, Float64s]]


@dataclass(frozen=True)
class SeamFacts:
    """Numbers of seams between different charts, and the medians of their steps."""

    seams: int
    stepped: int
    edges: int
    before: float
    after: float


@dataclass(frozen=True)
class Levelled:
    """Findings on exposure steps; `exposures` is None if nothing is to be changed."""

    verdict: Verdict | None
    exposures: Exposures | None
    facts: SeamFacts
    groups: Indices  # (charts,): group of each chart; seams without outliers join charts


def find_exposures(steps: Steps, verdict: Verdict | None, strength: float) -> Levelled:
    """Fit the exposures of charts if the verdict is that there are any."""
    exposures = Exposures.none(steps) if verdict is None else fit_exposures(steps, verdict.spread)
    if verdict is None or not verdict.is_sure:
        return Levelled(verdict, None, _facts(steps, exposures, 0.0), np.arange(steps.charts))
    groups = connected(steps.charts, steps.ends[exposures.weights > 0])
    return Levelled(verdict, exposures, _facts(steps, exposures, strength), groups)


def _facts(steps: Steps, exposures: Exposures, strength: float) -> SeamFacts:
    inside = steps.between
    between, outliers = steps.select(inside), exposures.are_outliers(steps)[inside]
    _, first, seam = np.unique(between.seams, return_index=True, return_inverse=True)
    changed = between.colours + strength * (exposures.sides(between) - between.colours)
    before, after = (np.sqrt(squared_steps(between, each, seam)) for each in (between.colours, changed))
    texels = np.bincount(seam, between.counts).astype(np.float64)
    return SeamFacts(
        seams=len(first),
        stepped=int(np.count_nonzero(before > VISIBLE)),
        edges=int(np.count_nonzero(outliers[first])),
        before=weighted_median(before, texels),
        after=weighted_median(after, texels),
    )


@dataclass(frozen=True)
class Correction:
    """Removes exposures from colours, with a strength in [0, 1]."""

    exposures: Exposures
    strength: float
    is_moved: Bools  # (charts,): whether a chart is corrected
    is_free: Bools  # (charts,): whether it is corrected, and not joined to a fixed one
    shift: Float64s  # (charts, N): added to the corrected colours

    @classmethod
    def of(cls, exposures: Exposures, groups: Indices, strength: float, fixed: Bools) -> Correction:
        """Return the correction without shifts, given the group of each chart, see `Levelled`."""
        channels, charts, _ = exposures.terms.shape
        is_moved = np.asarray(exposures.terms.any(axis=(0, 2))) & ~fixed
        is_free = is_moved & ~np.isin(groups, groups[fixed])
        return cls(exposures, strength, is_moved, is_free, np.zeros((charts, channels)))

    def corrected(self, colours: Float32s, charts: Indices, places: Float64s) -> Float32s:
        """Return the corrected colours, shape (K, N), at places in charts."""
        factor, offset = self.exposures.at(charts, places)
        is_moved = self.is_moved[charts]
        after = np.empty_like(colours)
        for channel, column in enumerate(colours.T):
            whole = (column - offset[channel]) / factor[channel] + self.shift[charts, channel]
            after[:, channel] = np.where(is_moved, column + self.strength * (whole - column), column)
        return after

    def preserving_means(self, count: int, samples: Samples) -> tuple[Correction, float]:
        """Preserve the mean of charts that are not joined to fixed ones; return also the mean change, 0 if invisible.

        Groups of charts share one mean, even if no seam joins them. Preserving the mean of each group would preserve
        the exposures of its largest charts; that all terms are drawn to 0 is the better guess.
        """
        areas, change = np.zeros(len(self.shift)), np.zeros_like(self.shift)
        for charts, difference in self._changes(count, samples):
            areas += np.bincount(charts, minlength=len(areas))
            change += np.column_stack([np.bincount(charts, each, len(areas)) for each in difference.T])
        mean = change[self.is_free].sum(axis=0) / max(1, areas[self.is_free].sum())
        shift = self.shift.copy()
        shift[self.is_free] = -mean / max(self.strength, np.finfo(float).tiny)
        shifted = replace(self, shift=shift)
        total = sum(float(np.abs(difference).sum()) for _, difference in shifted._changes(count, samples))
        mean_change = total / max(1.0, float(areas.sum()) * change.shape[1])
        return shifted, mean_change if mean_change >= BYTE_STEP / 2 else 0.0

    def _changes(self, count: int, samples: Samples) -> Iterator[tuple[Indices, Float64s]]:
        """Yield the charts of evenly spread samples, and the change of their colours."""
        rows = np.arange(0, count, max(1, count // large_arrays.BLOCK))
        for block in large_arrays.blocks(len(rows), large_arrays.CACHED):
            colours, charts, places = samples(rows[block])
            yield charts, (self.corrected(colours, charts, places) - colours).astype(np.float64)


def level_canvas_in_place(
    atlas: Atlas, planes: Float32s, strength: float, fixed: Bools | None, spans: Sequence[int] = ()
) -> tuple[Levelled, float]:
    """Remove exposures from planes, shape (N, R, C); return also the mean change, 0 without a correction.

    `fixed` charts keep theirs. `spans`: the maximum number of texels per stored hue of each texture; brightness is
    stored for every texel.
    """
    fixed = np.zeros(atlas.charts, bool) if fixed is None else fixed
    places, flat = ChartPlaces.of(atlas), planes.reshape(len(planes), -1)
    steps = steps_over_seams(atlas, planes, places, fixed)
    verdict = judge_steps(steps)
    # Hues extrapolated over more texels are less certain; mixed hues, too, must show whether there are exposures.
    if verdict is not None and verdict.is_sure and max(spans, default=1) > 1:
        mixed = mixed_cells(atlas, spans)
        before = continue_hues_in_place(atlas, planes, mixed, max(spans))
        steps = steps_over_seams(atlas, planes, places, fixed)
        verdict = judge_steps(steps)
        flat[:, mixed] = before
    levelled = find_exposures(steps, verdict, strength)

    def samples(rows: Int64s | slice) -> tuple[Float32s, Indices, Float64s]:
        cells, charts = atlas.owned_cells[rows], atlas.chart_of[rows]
        return flat[:, cells].T, charts, places.at(positions_of(atlas, cells), charts)

    change = 0.0
    if levelled.exposures is not None:
        correction = Correction.of(levelled.exposures, levelled.groups, strength, fixed)
        correction, change = correction.preserving_means(len(atlas.owned_cells), samples)
        for block in large_arrays.blocks(len(atlas.owned_cells) if change else 0, large_arrays.SCATTERED):
            flat[:, atlas.owned_cells[block]] = correction.corrected(*samples(block)).T
    refresh_halo(planes, atlas)
    return levelled, change


def level_mesh(
    positions: Float64s, faces: Int32s, colours: Float32s, photographs: Int64s, strength: float
) -> tuple[Levelled, float, Float32s]:
    """Remove exposures from the colours of vertices, shape (S, N), each from one photograph."""
    steps, charts, places = steps_over_edges(positions, faces, colours.astype(np.float64), photographs)
    levelled = find_exposures(steps, judge_steps(steps), strength)
    if levelled.exposures is None:
        return levelled, 0.0, colours
    correction = Correction.of(levelled.exposures, levelled.groups, strength, steps.fixed)
    correction, change = correction.preserving_means(
        len(colours), lambda rows: (colours[rows], charts[rows], places[rows])
    )
    return levelled, change, correction.corrected(colours, charts, places) if change else colours
