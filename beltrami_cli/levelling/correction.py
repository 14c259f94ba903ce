"""Whether there are exposure steps at all, and of which kind; and colours without them.

A fit can take out any step. But only if steps are of exposure does a fit to some seams also foretell the steps at the
others, for each chart has several seams, and one exposure: each seam is foretold from the others. Of charts that hang
together the mean stays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.levelling.fit import SHORT, fit_exposures, known_channels, may_be_exposure
from beltrami_cli.levelling.steps import ChartPlaces, steps_over_edges, steps_over_seams, weighted_median
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import refresh_halo

if TYPE_CHECKING:
    from collections.abc import Callable

    from beltrami_cli.arrays import Bools, Float32s, Float64s, Int32s, Int64s
    from beltrami_cli.levelling.fit import Exposures
    from beltrami_cli.levelling.steps import Steps
    from beltrami_cli.surface.atlas import Atlas, Indices

    Samples = Callable[[Int64s], tuple[Float32s, Indices, Float64s]]

# Expected deviations of gains, offsets, and tilts if any: strong and faint.
STRONG, FAINT = (0.1, 0.03), (0.03, 0.01)
_TILTS = 0.8  # of the gains
_FOLDS = 4
_FEWEST_SEAMS = 8  # below, parts of seams are foretold from the others
_STRETCHES = 4  # whose mean step is foretold: the pattern on it is averaged away
_SATURATED = 14 / 255  # steps count no more than this
_SURE = 0.25  # strong steps that are foretold so well are not tried as faint ones
# What is left must fall to this for another kind than the first: others have more terms, or fainter ones.
_BETTER = 7 / 8
# Shares of the energy of steps that must be foretold, and in how many standard errors over the seams: where it is more,
# one will do, as there may be few seams.
_ENOUGH = ((0.12, 2.0), (0.2, 0.9))
# Painted models have faint steps of which some is foretold, by shading that was painted too: unless most is, what is
# foretold must be larger.
_LEAST_REMOVED, _MOST = 3.2 / 255, 0.5
# Seams with a mean weight below this are painted, with a step above the other have one at all.
_PAINTED, _STEP = 0.3, 2 / 255
# A mean change below this is none that anybody could see: the colours stay.
LEAST_CHANGE = 0.5 / 255
_PROBED = 1 << 21  # samples from which means are taken
_BLOCK = 1 << 18
_NOWHERE = np.zeros((0, 2))  # places, where they make no difference


@dataclass(frozen=True)
class Verdict:
    """The deviations that foretell the steps best, and what share of their energy they do foretell."""

    spread: tuple[float, ...]
    share: float
    errors: float
    removed: float  # root mean square of what is foretold of the steps

    @property
    def is_sure(self) -> bool:
        """Whether there are exposure steps."""
        is_large = self.removed >= _LEAST_REMOVED or self.share >= _MOST
        return is_large and any(self.share >= share and self.errors >= errors for share, errors in _ENOUGH)


def judge(steps: Steps, fixed: Bools | None = None) -> Verdict:
    """Choose the kind of exposure steps by cross-validation over the seams."""
    seams, groups = np.unique(steps.seams), _groups(steps)
    # A stretch is of the fold of its seam; if there are few of those, folds follow each other along each.
    folds = np.arange(len(steps.seams)) // (2 * _STRETCHES) % _FOLDS
    if len(seams) >= _FEWEST_SEAMS:
        drawn = np.random.default_rng(0).permutation(len(seams)) % _FOLDS
        folds = drawn[np.searchsorted(seams, steps.seams)]

    def tried(base: tuple[float, float]) -> list[Verdict]:
        tilt = _TILTS * base[0]
        return [_foretold(steps, each, folds, groups, fixed) for each in (base, (*base, tilt, tilt))]

    found = tried(STRONG)
    if max(each.share for each in found) < _SURE:
        found += tried(FAINT)
    best = found[0]
    for other in found[1:]:
        if other.is_sure > best.is_sure or 1 - other.share < _BETTER * (1 - best.share):
            best = other
    return best


def _groups(steps: Steps) -> Int64s:
    """Divide stretches into groups of neighbours on a seam, with the same two charts, and return their numbers."""
    keys = np.column_stack([steps.seams, steps.ends])
    starts = np.flatnonzero(np.r_[True, np.any(keys[1:] != keys[:-1], axis=1)][: len(keys)])
    within = np.arange(len(keys)) - np.repeat(starts, np.diff(np.r_[starts, len(keys)]))
    return np.cumsum(within % _STRETCHES == 0) - 1


def _foretold(
    steps: Steps, spread: tuple[float, ...], folds: Int64s, groups: Int64s, fixed: Bools | None
) -> Verdict:
    after = np.empty_like(steps.colours)
    for fold in range(_FOLDS):
        held = folds == fold
        others = fit_exposures(steps.part(~held), spread, SHORT, fixed)
        after[held] = others.sides(steps.part(held))
    seam_of = np.zeros(int(groups.max(initial=-1)) + 1, np.int64)
    seam_of[groups] = steps.seams
    part = steps.counts * (may_be_exposure(steps) & known_channels(steps).any(axis=1))
    before, left = (_energy(sides, groups, part) for sides in (steps.colours, after))
    units = seam_of if len(np.unique(seam_of)) >= _FEWEST_SEAMS else np.arange(len(seam_of))
    each = np.bincount(units, before - left)
    error, gained, total = float(np.sqrt(np.square(each).sum())), float(each.sum()), float(before.sum())
    if not total or not error:
        return Verdict(spread, 0.0, 0.0, 0.0)
    return Verdict(spread, gained / total, gained / error, float(np.sqrt(max(0.0, gained) / part.sum())))


def _energy(sides: Float64s, groups: Int64s, counts: Float64s) -> Float64s:
    """Return the squared mean step of each group, of which paint cannot make much, times its texels."""
    texels = np.bincount(groups, counts)
    step = sides[:, 1] - sides[:, 0]
    means = [np.bincount(groups, each * counts) / np.maximum(texels, 1) for each in step.T]
    return np.asarray(texels * np.minimum(np.mean(np.square(means), axis=0), _SATURATED**2))


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
    """What is known of exposure steps; without exposures nothing is to be changed."""

    verdict: Verdict | None
    exposures: Exposures | None
    facts: SeamFacts
    groups: Indices  # (charts,): charts that are joined by seams without paint


def find_exposures(steps: Steps, strength: float, fixed: Bools | None = None) -> Levelled:
    """Decide whether the charts differ in exposure, and find how; `fixed` charts stay as they are."""
    apart = np.arange(steps.charts)
    if not np.any(steps.ends[:, 0] != steps.ends[:, 1]):
        return Levelled(None, None, SeamFacts(0, 0, 0, 0.0, 0.0), apart)
    verdict = judge(steps, fixed)
    found = fit_exposures(steps, verdict.spread, fixed=fixed)
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
        self._groups = levelled.groups
        self._moved = np.asarray(levelled.exposures.terms.any(axis=(0, 2)))
        self._anchored = np.zeros(charts, bool)
        if fixed is not None:
            self._moved &= ~fixed
            self._anchored = np.isin(self._groups, self._groups[fixed])

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
        """Let the mean of each group of charts stay; return the mean change of a value, 0 if it could not be seen."""
        rows = np.arange(0, count, max(1, count // _PROBED))
        change = np.zeros_like(self._shift)
        areas, total = np.zeros(len(change)), 0.0
        for block in np.array_split(rows, max(1, len(rows) // _BLOCK)):
            colours, charts, places = samples(block)
            difference = (self.of(colours, charts, places) - colours).astype(np.float64)
            areas += np.bincount(charts, minlength=len(areas))
            for channel, column in enumerate(difference.T):
                change[:, channel] += np.bincount(charts, column, len(areas))
        for channel in range(change.shape[1]):
            weights = np.where(self._moved, areas, 0)
            sums = np.bincount(self._groups, np.where(self._moved, change[:, channel], 0))
            means = sums / np.maximum(np.bincount(self._groups, weights), 1)
            shift = -means[self._groups] / max(self._strength, 1e-9)
            self._shift[:, channel] = np.where(self._anchored, 0, shift)
        for block in np.array_split(rows, max(1, len(rows) // _BLOCK)):
            colours, charts, places = samples(block)
            total += float(np.abs(self.of(colours, charts, places) - colours).sum(dtype=np.float64))
        mean = total / max(1, len(rows) * change.shape[1])
        return mean if mean >= LEAST_CHANGE else 0.0


def level_canvas(
    atlas: Atlas, planes: Float32s, strength: float, fixed: Bools | None
) -> tuple[Levelled, float]:
    """Take exposures out of planes, shape (N, R, C), in place; return also the mean change, 0 if they stay."""
    places, columns = ChartPlaces.of(atlas), atlas.kind.shape[1]
    found = find_exposures(steps_over_seams(atlas, planes, places), strength, fixed)
    flat = planes.reshape(len(planes), -1)

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
