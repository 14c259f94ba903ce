"""Whether there are exposure steps at all, and of which kind.

A fit can take out any step. But only if steps are of exposure does a fit to some seams also foretell the steps at the
others, for each chart has several seams, and one exposure: each seam is foretold from the others. A seam that alone
joins two parts of a surface is foretold from its other stretches, if the same pattern is on both of its sides.

Charts that were painted in one colour each foretell their seams as well. But only under an exposure do colours go up
and down alike on both sides of a seam: such seams must vouch for what is foretold, or else nearly all of it must fit.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from beltrami_cli.arrays import Bools, Float64s, Int64s
from beltrami_cli.levelling.fit import SHORT, fit_exposures, known_steps, may_be_exposure
from beltrami_cli.levelling.steps import Steps

# Expected deviations of gains, offsets, and tilts if any: strong and faint. Of more terms less can be known, so that
# with tilts all are drawn to 0 more strongly.
STRONG, FAINT = (0.1, 0.03), (0.03, 0.01)
STRONG_TILTED, FAINT_TILTED = (0.05, 0.02, 0.06, 0.06), (0.03, 0.01, 0.024, 0.024)
_FOLDS = 4
_MANY_SEAMS, _MORE_FOLDS = (
    64,
    12,
)  # of fewer seams so many folds, or too much that tells of others is left out
_PATTERN = 3.0  # times as far do colours vary along a seam as steps
_FEWEST_SEAMS = 8  # below, parts of seams are foretold from the others
_STRETCHES = 4  # whose mean step is foretold: the pattern on it is averaged away
_SATURATED = 14 / 255  # steps count no more than this
_SURE = 0.25  # strong steps that are foretold so well are not tried as faint ones
_NEARLY_ALL = 0.95  # nor, if so well, with gains that change over charts, of which steps would be left
# What is left must fall to this for another kind than the first: others have more terms, or fainter ones. Less will do
# where it falls by more than so many standard errors over the seams.
_BETTER, _CLEARLY_BETTER, _CLEAR = 0.85, 0.95, 4.0
# Shares of the energy of steps that must be foretold, and in how many standard errors over the seams: a smaller share
# in more of them. Of few seams errors cannot be many, and a larger share makes up for it. That share must not come of
# few among many seams: errors are at most the root of the number of seams that tell anything.
_ENOUGH = ((0.12, 2.7), (0.08, 4.0))
_ENOUGH_OF_FEW, _LEAST_ERRORS, _TELLING = 0.25, 0.9, 0.18
# Painted models have faint steps of which some is foretold, by shading that was painted too: unless most is, what is
# foretold must be larger.
_LEAST_REMOVED, _MOST = 3.2 / 255, 0.5
# Colours of both sides, less their means over so many stretches, have at least this covariance and correlation along a
# seam over which a pattern goes on.
_RUN, _COVARIANCE, _CORRELATION = 8, (1.5 / 255) ** 2, 0.5
_FEWEST_FREE = 1.5  # stretches of it, less its means
# Of the length of seams so much must have a pattern, and so much of the energy there must be foretold.
_LEAST_WITH_PATTERN, _VOUCHED = 0.1, 0.12
# Without a pattern so much of the energy must be foretold, as of few exposures on a surface of few colours.
_FLAT = 0.95


@dataclass(frozen=True)
class Verdict:
    """The deviations that foretell the steps best, and what share of their energy they do foretell."""

    spread: tuple[float, ...]
    share: float
    errors: float
    removed: float  # root mean square of what is foretold of the steps
    seams: int  # between different charts
    is_vouched: bool  # by seams over which a pattern goes on
    left: Float64s = field(repr=False, compare=False)  # of their energy, for each seam

    @property
    def is_sure(self) -> bool:
        """Whether there are exposure steps."""
        if not self.is_vouched and self.share < _FLAT:
            return False
        is_large = self.removed >= _LEAST_REMOVED or self.share >= _MOST
        few = _ENOUGH_OF_FEW, max(_LEAST_ERRORS, _TELLING * np.sqrt(self.seams))
        return is_large and any(
            self.share >= share and self.errors >= errors for share, errors in (*_ENOUGH, few)
        )


def judge(steps: Steps, fixed: Bools | None = None) -> Verdict:
    """Choose the kind of exposure steps by cross-validation over the seams."""
    groups, folds, is_told = _runs(steps, _STRETCHES), *_folds(steps)

    def tried(plain: tuple[float, ...], tilted: tuple[float, ...]) -> Verdict:
        first = _foretold(steps, plain, folds, groups, is_told, fixed)
        if first.is_sure and first.share >= _NEARLY_ALL:
            return first
        second = _foretold(steps, tilted, folds, groups, is_told, fixed)
        chosen, other = (second, first) if _is_better(second, first) else (first, second)
        # Whichever of the two foretells the steps, these are of exposure.
        return replace(other, spread=chosen.spread) if other.is_sure > chosen.is_sure else chosen

    strong = tried(STRONG, STRONG_TILTED)
    if strong.share >= _SURE:
        return strong
    faint = tried(FAINT, FAINT_TILTED)
    return faint if faint.is_sure > strong.is_sure or _is_better(faint, strong) else strong


def _is_better(other: Verdict, first: Verdict) -> bool:
    """Whether another kind than the first leaves so much less of the steps that its terms are worth it."""
    gained = first.left - other.left
    total, limit = float(other.left.sum()), float(first.left.sum())
    is_clear = gained.sum() > _CLEAR * np.sqrt(np.square(gained).sum())
    return total < (_CLEARLY_BETTER if is_clear else _BETTER) * limit


def _folds(steps: Steps) -> tuple[Int64s, Bools]:
    """Return the fold of each stretch, and of which the others tell anything."""
    seams, first, seam = np.unique(steps.seams, return_index=True, return_inverse=True)
    along = np.arange(len(seam)) // (2 * _STRETCHES)
    if len(seams) < _FEWEST_SEAMS:
        return along % _FOLDS, np.ones(len(seam), bool)
    count = _FOLDS if len(seams) >= _MANY_SEAMS else _MORE_FOLDS
    drawn = np.random.default_rng(0).permutation(len(seams)) % count
    # What joins two parts of a model is foretold by nothing but its other stretches. They tell an exposure from paint
    # only where the same pattern is on both sides.
    alone = bridges(steps.ends[first], steps.charts)
    return np.where(alone[seam], along % count, drawn[seam]), ~alone[seam] | _continues(steps)


def _continues(steps: Steps) -> Bools:
    """Return which stretches are of seams along which colours vary alike on both sides, by far more than steps do."""
    starts = np.flatnonzero(np.r_[True, steps.seams[1:] != steps.seams[:-1]])
    lengths = np.diff(np.r_[starts, len(steps.seams)])
    middle = steps.colours.mean(axis=1)

    def mean(values: Float64s) -> Float64s:
        sums = np.add.reduceat(values * steps.counts[:, None], starts)
        return np.asarray(np.repeat(sums / np.add.reduceat(steps.counts, starts)[:, None], lengths, axis=0))

    spread = mean(np.abs(middle - mean(middle))).mean(axis=1)
    return np.asarray(spread >= _PATTERN * steps.noise)


def _runs(steps: Steps, most: int) -> Int64s:
    """Divide stretches into runs of neighbours on a seam, with the same two charts, and return their numbers."""
    keys = np.column_stack([steps.seams, steps.ends])
    starts = np.flatnonzero(np.r_[True, np.any(keys[1:] != keys[:-1], axis=1)][: len(keys)])
    within = np.arange(len(keys)) - np.repeat(starts, np.diff(np.r_[starts, len(keys)]))
    return np.cumsum(within % most == 0) - 1


def _foretold(
    steps: Steps,
    spread: tuple[float, ...],
    folds: Int64s,
    groups: Int64s,
    is_told: Bools,
    fixed: Bools | None,
) -> Verdict:
    after = np.empty_like(steps.colours)
    for fold in np.unique(folds):
        held = folds == fold
        others = fit_exposures(steps.part(~held), spread, SHORT, fixed)
        after[held] = others.sides(steps.part(held))
    seam_of = np.zeros(int(groups.max(initial=-1)) + 1, np.int64)
    seam_of[groups] = steps.seams
    part = steps.counts * (may_be_exposure(steps) & is_told)
    before, left = (_energy(steps, sides, groups, part) for sides in (steps.colours, after))
    is_vouched = _is_vouched(steps, groups, before, left)
    units = seam_of if len(np.unique(seam_of)) >= _FEWEST_SEAMS else np.arange(len(seam_of))
    each, kept = (np.bincount(units, energy).astype(np.float64) for energy in (before - left, left))
    seams = len(np.unique(steps.seams[steps.ends[:, 0] != steps.ends[:, 1]]))
    error, gained, total = float(np.sqrt(np.square(each).sum())), float(each.sum()), float(before.sum())
    if not total or not error:
        return Verdict(spread, 0.0, 0.0, 0.0, seams, False, kept)
    removed = float(np.sqrt(max(0.0, gained) / part.sum()))
    return Verdict(spread, gained / total, gained / error, removed, seams, is_vouched, kept)


def _is_vouched(steps: Steps, groups: Int64s, before: Float64s, left: Float64s) -> bool:
    """Return whether steps are foretold where a pattern goes on over the seam, too, of groups of stretches."""
    between = steps.ends[:, 0] != steps.ends[:, 1]
    goes_on = pattern_goes_on(steps) & between
    if np.average(goes_on, weights=steps.counts * between) < _LEAST_WITH_PATTERN:
        return False
    with_pattern = np.zeros(len(before), bool)
    with_pattern[groups[goes_on]] = True
    return bool((before - left)[with_pattern].sum() > _VOUCHED * before[with_pattern].sum())


def pattern_goes_on(steps: Steps) -> Bools:
    """Return which stretches are of seams along which colours go up and down alike on both sides."""
    back = (steps.ends[:, 0] > steps.ends[:, 1])[:, None, None]
    sides = np.where(back, steps.colours[:, ::-1], steps.colours)
    runs, (_, seam) = _runs(steps, _RUN), np.unique(steps.seams, return_inverse=True)
    lengths = np.bincount(runs)
    # Slopes of the colours, and of gains, make sides of a long seam go alike, or not, whatever is on them.
    apart = sides.reshape(len(seam), -1)
    apart = apart - (np.stack([np.bincount(runs, each) for each in apart.T]) / lengths)[:, runs].T
    first, second = apart.reshape(sides.shape).transpose(1, 0, 2)
    free = np.bincount(seam, 1 - 1 / lengths[runs])
    both, *own = (
        np.bincount(seam, np.mean(each, axis=1)) / np.maximum(free, 1)
        for each in (first * second, np.square(first), np.square(second))
    )
    found = (both >= _COVARIANCE) & (both >= _CORRELATION * np.sqrt(own[0] * own[1]))
    return np.asarray((found & (free > _FEWEST_FREE))[seam])


def _energy(steps: Steps, sides: Float64s, groups: Int64s, counts: Float64s) -> Float64s:
    """Return the squared mean step of each group, of which paint cannot make much, times its texels."""
    texels = np.bincount(groups, counts)
    step = np.where(known_steps(steps, sides), sides[:, 1] - sides[:, 0], 0)
    means = [np.bincount(groups, each * counts) / np.maximum(texels, 1) for each in step.T]
    return np.asarray(texels * np.minimum(np.mean(np.square(means), axis=0), _SATURATED**2))


def bridges(ends: Int64s, charts: int) -> Bools:
    """Return which seams, between the charts `ends` of shape (K, 2), are on no closed way over seams.

    Each seam outside a spanning tree gets a random number, and each seam of the tree the exclusive or of those of the
    closed ways that it is on: that is 0 for a bridge, and for another with a probability of 2 ** -62.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import breadth_first_order, connected_components

    between = ends[:, 0] != ends[:, 1]
    pairs, which, times = np.unique(
        np.sort(ends[between], axis=1), axis=0, return_inverse=True, return_counts=True
    )
    shape = (charts + 1,) * 2
    joined = coo_array((np.ones(len(pairs)), pairs.T), shape=shape)
    roots = np.unique(connected_components(joined, directed=False)[1], return_index=True)[1]
    # One more chart, which joins all parts, makes one tree of them.
    links = np.concatenate([pairs, np.column_stack([np.full(len(roots), charts), roots])])
    joined = coo_array((np.ones(len(links)), links.T), shape=shape)
    order, parents = breadth_first_order(joined.tocsr(), charts, directed=False)
    of_tree = (parents[pairs[:, 0]] == pairs[:, 1]) | (parents[pairs[:, 1]] == pairs[:, 0])
    labels = np.zeros(charts + 1, np.int64)
    random = np.random.default_rng(0).integers(1, 1 << 62, len(pairs))
    for side in pairs.T:
        np.bitwise_xor.at(labels, side[~of_tree], random[~of_tree])
    for chart in order[:0:-1]:
        labels[parents[chart]] ^= labels[chart]
    lower = np.where(parents[pairs[:, 0]] == pairs[:, 1], pairs[:, 0], pairs[:, 1])
    alone = of_tree & (labels[lower] == 0) & (times == 1)
    found = np.zeros(len(ends), bool)
    found[between] = alone[which.reshape(-1)]
    return found
