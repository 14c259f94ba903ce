"""Whether there are exposure steps at all, and of which kind: each seam is foretold from the others.

A fit can take out any step. But only if steps are of exposure does a fit to some seams also foretell the steps at the
others, for each chart has several seams, and one exposure.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.levelling.fit import SHORT, fit_exposures, known_channels, may_be_exposure
from beltrami_cli.levelling.steps import weighted_median

if TYPE_CHECKING:
    from beltrami_cli.arrays import Bools, Float64s, Int64s
    from beltrami_cli.levelling.fit import Exposures
    from beltrami_cli.levelling.steps import Steps
    from beltrami_cli.surface.atlas import Indices

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
    folds, groups = _folds(steps), _groups(steps)

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


def _folds(steps: Steps) -> Int64s:
    """Return the fold of each stretch: by its seam, or if there are few of those along each."""
    seams = np.unique(steps.seams)
    if len(seams) >= _FEWEST_SEAMS:
        drawn = np.random.default_rng(0).permutation(len(seams)) % _FOLDS
        return drawn[np.searchsorted(seams, steps.seams)]
    return np.arange(len(steps.seams)) // (2 * _STRETCHES) % _FOLDS


def _groups(steps: Steps) -> Int64s:
    """Divide stretches into groups of neighbours on a seam, with the same two charts, and return their numbers."""
    keys = np.column_stack([steps.seams, steps.ends])
    starts = np.flatnonzero(np.r_[True, np.any(keys[1:] != keys[:-1], axis=1)][: len(keys)])
    within = np.arange(len(keys)) - np.repeat(starts, np.diff(np.r_[starts, len(keys)]))
    begins = within % _STRETCHES == 0
    return np.cumsum(begins) - 1


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
    gained = np.bincount(units, before - left)
    error = float(np.sqrt(np.square(gained).sum()))
    total = float(before.sum())
    if not total or not error:
        return Verdict(spread, 0.0, 0.0, 0.0)
    removed = max(0.0, float(gained.sum()))
    return Verdict(
        spread, float(gained.sum()) / total, float(gained.sum()) / error, float(np.sqrt(removed / part.sum()))
    )


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


def find_exposures(steps: Steps, strength: float = 1.0, fixed: Bools | None = None) -> Levelled:
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
    return SeamFacts(
        len(counts),
        int(np.count_nonzero(before > _STEP)),
        int(np.count_nonzero(agreed < _PAINTED)),
        weighted_median(before, counts),
        weighted_median(after, counts),
    )


def _joined(steps: Steps, found: Exposures) -> Indices:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    used = steps.ends[found.weights > 0]
    pairs = coo_array((np.ones(len(used)), (used[:, 0], used[:, 1])), shape=(steps.charts,) * 2)
    return np.asarray(connected_components(pairs, directed=False)[1])
