"""Colours without exposure steps, if there are any. The mean of all that is changed stays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s, Int32s, Int64s
from beltrami_cli.levelling.fit import Exposures, fit_exposures
from beltrami_cli.levelling.hues import continue_hues, mixed_cells
from beltrami_cli.levelling.steps import (
    ChartPlaces,
    Steps,
    steps_over_edges,
    steps_over_seams,
    weighted_median,
)
from beltrami_cli.levelling.verdict import Verdict, judge
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import Atlas, Indices, refresh_halo
from beltrami_cli.surface.records import limits_of

Samples = Callable[[Int64s], tuple[Float32s, Indices, Float64s]]

# Seams with a mean weight below this are painted, with a step above the other have one at all.
_PAINTED, _STEP = 0.3, 2 / 255
# A mean change below this is none that anybody could see: the colours stay.
LEAST_CHANGE = 0.5 / 255
_PROBED = 1 << 21  # samples from which means are taken
_BLOCK = 1 << 18
_NOWHERE = np.zeros((0, 2))  # places, where they make no difference


@dataclass(frozen=True)
class SeamFacts:
    """The seams between different charts: how many, which have steps, and how large these are in the median."""

    seams: int
    stepped: int
    painted: int
    before: float
    after: float


@dataclass(frozen=True)
class Levelled:
    """Findings on exposure steps; without exposures nothing is to be changed."""

    verdict: Verdict | None
    exposures: Exposures | None
    facts: SeamFacts
    groups: Indices  # (charts,): charts that are joined by seams without paint


def _without_seams(charts: int) -> Levelled:
    return Levelled(None, None, SeamFacts(0, 0, 0, 0.0, 0.0), np.arange(charts))


def find_exposures(steps: Steps, strength: float, fixed: Bools | None = None) -> Levelled:
    """Decide whether the charts differ in exposure, and find how; `fixed` charts stay as they are."""
    apart = np.arange(steps.charts)
    if not np.any(steps.ends[:, 0] != steps.ends[:, 1]):
        return _without_seams(steps.charts)
    verdict = judge(steps, fixed)
    found = fit_exposures(steps, verdict.spread, fixed)
    facts = _facts(steps, found, strength if verdict.is_sure else 0.0)
    if not verdict.is_sure:
        return Levelled(verdict, None, facts, apart)
    return Levelled(verdict, found, facts, _joined(steps, found))


def _facts(steps: Steps, found: Exposures, strength: float) -> SeamFacts:
    between = steps.ends[:, 0] != steps.ends[:, 1]
    _, seam = np.unique(steps.seams[between], return_inverse=True)
    signs = np.where(steps.ends[between, 0] < steps.ends[between, 1], 1.0, -1.0)
    counts = np.bincount(seam, steps.counts[between])

    def sizes(sides: Float64s) -> Float64s:
        step = signs[:, None] * (sides[between, 1] - sides[between, 0])
        means = [np.bincount(seam, each * steps.counts[between]) / counts for each in step.T]
        return np.asarray(np.sqrt(np.mean(np.square(means), axis=0)))

    before = sizes(steps.colours)
    after = sizes(steps.colours + strength * (found.sides(steps) - steps.colours))
    agreed = np.bincount(seam, found.weights[between] * steps.counts[between]) / counts
    stepped, painted = (int(np.count_nonzero(each)) for each in (before > _STEP, agreed < _PAINTED))
    medians = (weighted_median(each, counts) for each in (before, after))
    return SeamFacts(len(counts), stepped, painted, *medians)


def _joined(steps: Steps, found: Exposures) -> Indices:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    used = steps.ends[found.weights > 0]
    pairs = coo_array((np.ones(len(used)), (used[:, 0], used[:, 1])), shape=(steps.charts,) * 2)
    return np.asarray(connected_components(pairs, directed=False)[1])


class Correction:
    """Takes exposures out of colours, by a strength from 0 to 1."""

    def __init__(self, levelled: Levelled, strength: float, fixed: Bools | None = None) -> None:
        assert levelled.exposures is not None
        self._found, self._strength = levelled.exposures, strength
        channels, charts, _ = levelled.exposures.terms.shape
        self._shift = np.zeros((charts, channels))
        self._moved = np.asarray(levelled.exposures.terms.any(axis=(0, 2)))
        self._anchored = np.zeros(charts, bool)
        if fixed is not None:
            self._moved &= ~fixed
            self._anchored = np.isin(levelled.groups, levelled.groups[fixed])

    def of(self, colours: Float32s, charts: Indices, places: Float64s) -> Float32s:
        """Return the colours, shape (K, N), at places in charts without the exposures."""
        factor, offset = self._found.at(charts, places)
        moved = self._moved[charts]
        after = np.empty_like(colours)
        for channel, column in enumerate(colours.T):
            full = (column - offset[channel]) / factor[channel] + self._shift[charts, channel]
            after[:, channel] = np.where(moved, column + self._strength * (full - column), column)
        return after

    def keep_means(self, count: int, samples: Samples) -> float:
        """Let the mean of charts that are not joined to fixed ones stay; return the mean change, 0 if too small to see.

        Groups of charts share that mean, also if no seam joins them. To keep the mean of each would keep the exposures
        of its largest charts, and that all terms are drawn to 0 is the better guess.
        """
        rows = np.arange(0, count, max(1, count // _PROBED))
        change = np.zeros_like(self._shift)
        areas, total = np.zeros(len(change)), 0.0
        for block in np.array_split(rows, max(1, len(rows) // _BLOCK)):
            colours, charts, places = samples(block)
            difference = (self.of(colours, charts, places) - colours).astype(np.float64)
            areas += np.bincount(charts, minlength=len(areas))
            for channel, column in enumerate(difference.T):
                change[:, channel] += np.bincount(charts, column, len(areas))
        is_free = self._moved & ~self._anchored
        mean = change[is_free].sum(axis=0) / max(1, areas[is_free].sum())
        self._shift[is_free] = -mean / max(self._strength, 1e-9)
        for block in np.array_split(rows, max(1, len(rows) // _BLOCK)):
            colours, charts, places = samples(block)
            total += float(np.abs(self.of(colours, charts, places) - colours).sum(dtype=np.float64))
        mean = total / max(1, len(rows) * change.shape[1])
        return mean if mean >= LEAST_CHANGE else 0.0


def level_canvas(
    atlas: Atlas, planes: Float32s, strength: float, fixed: Bools | None, halved: Sequence[bool] = ()
) -> tuple[Levelled, float]:
    """Take exposures out of planes, shape (N, R, C), in place; return also the mean change, 0 if they stay.

    `halved`: textures that store colour, red, green and blue, at half the resolution.
    """
    if not atlas.seams:
        return _without_seams(atlas.charts), 0.0
    places, columns = ChartPlaces.of(atlas), atlas.kind.shape[1]
    flat = planes.reshape(len(planes), -1)
    found = find_exposures(steps_over_seams(atlas, planes, places), strength, fixed)
    # Hues continued over more texels are less sure: whether there are exposures at all, mixed ones must tell, too.
    if found.exposures is not None and any(halved):
        mixed = mixed_cells(atlas, halved)
        own = continue_hues(atlas, planes, mixed, limits_of(planes))
        found = find_exposures(steps_over_seams(atlas, planes, places), strength, fixed)
        flat[:, mixed] = own

    def samples(rows: Int64s | slice) -> tuple[Float32s, Indices, Float64s]:
        cells, charts = atlas.owned_cells[rows], atlas.chart_of[rows]
        is_tilted = found.exposures is not None and found.exposures.is_tilted
        return flat[:, cells].T, charts, places.at(cells, charts, columns) if is_tilted else _NOWHERE

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
    """Take exposures out of the colours of vertices, shape (S, N), each of one photograph."""
    steps, charts, places = steps_over_edges(positions, faces, colours.astype(np.float64), photographs)
    found = find_exposures(steps, strength)
    if found.exposures is None:
        return found, 0.0, colours
    correction = Correction(found, strength)
    change = correction.keep_means(len(colours), lambda rows: (colours[rows], charts[rows], places[rows]))
    return found, change, correction.of(colours, charts, places) if change else colours
