"""Exposures of charts: fitted to the steps at seams, and tested on seams that were held out.

On the two sides p and q of a seam between charts of gains 1 + g and offsets o the true colour T is the same:

    v_q - v_p = (g_q - g_p) T + o_q - o_p,

where T is the mean of both sides as corrected so far. So a gain common to all charts makes no difference (if T were
the colour on either side, noise would draw all gains to -1). The terms are drawn to 0, each by its expected deviation.
Weights follow the estimator of Geman and McClure, whose scale is narrowed step by step [1], so that an edge
of colour counts for nothing.

A fit can remove any step. But only under exposures does a fit to some seams predict the steps at the others, since a
chart has one exposure at all of its seams. Each held-out seam gives its gain x = (b - a) / (b + a), where b and a are
its mean squared step before and after the prediction is removed. The F-test is of the mean evidence, which is x, or
where a seam has no pattern x - (1 - x): one colour per chart predicts some of the steps as well. It is
weighted by the length of seams, with 1 and n - 1 degrees of freedom, n = (sum w)^2 / sum w^2. Two seams predict each
other by the product of their steps, which enters both of their x, so that the variance of the mean is up to twice that
of independent x; twice is taken. Seams are held out fold by fold, until it is all but certain how the test of all of
them would end [2].

References
----------
.. [1] H. Yang, P. Antonante, V. Tzoumas, L. Carlone, "Graduated non-convexity for robust spatial perception", IEEE
       Robotics and Automation Letters 5 (2020), doi 10.1109/LRA.2020.2965893.
.. [2] K. K. G. Lan, R. Simon, M. Halperin, "Stochastically curtailed tests in long-term clinical trials", Sequential
       Analysis 1 (1982), doi 10.1080/07474948208836014.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from beltrami_cli.arrays import Bools, Float64s, Indices, Int64s
from beltrami_cli.levelling.steps import PARTS, STRETCH, Steps, deviations, weighted_median
from beltrami_cli.quantities import BYTE_STEP
from beltrami_cli.surface.grouping import connected

# Expected deviations of gains and offsets of cameras; and, if gains vary linearly over charts, also of tilts.
SPREADS = {"plain": (0.1, 0.03), "tilted": (0.05, 0.02, 0.06, 0.06)}
# Number of deviations beyond which a step is an outlier: larger than cameras make, or an edge of colour along the seam.
OUTLIER = 2.5
# Scales of the weights, narrowed to 1 and kept there; in the last third, seams of outliers are left out.
SCALES = (4.0, 2.8, 2.0, 1.4, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
# Of the F-test. At 0.975 no model without exposure steps is changed, and all exposures of the fox are found; at 0.99
# clipped ones are missed: bench_levelling.py.
CONFIDENCE = 0.975
# A seam has a step if it exceeds the rounding of both sides and so many deviations of its error. Exposures make steps
# on nearly all seams; on the samples, which have no exposures, up to 0.11 of the length of seams has some.
VISIBLE, BEYOND_NOISE = 2 * BYTE_STEP, 3.0
MIN_STEPPED = 0.05
# A test ends early if only an error of so many standard deviations could reverse the result.
CURTAILMENT = 3.0
# Means of so many standard deviations above 0 have that confidence.
NORMAL_QUANTILE = 1.96
# Mean correlation along seams across which patterns continue: 0.24 or more on the samples and the fox, and
# 0.05 or less where charts have unrelated textures: tests/levelling.
MIN_CORRELATION = 0.15
# Up to so many seams are held out singly, and more in `PARTS` folds: of the fox, 8 folds of its 19 seams leave too few
# to predict the others; of 66 and more seams, 8 suffice. Of as few, no test ends early.
FEW_SEAMS = 32
# Minimum number of seams that close loops of charts. With fewer, too few are predicted by others, and parts of seams
# are held out.
MIN_LOOPS = 4


@dataclass(frozen=True)
class Exposures:
    """The exposure terms of charts, and the agreement of the stretches of seams with them."""

    terms: Float64s  # (N, charts, 2 or 4): gain - 1, offset, tilts of the gain along rows and columns
    weights: Float64s  # (K,): 1 where sides agree, 1/4 at an outlier, near 0 at an edge of colour

    @classmethod
    def none(cls, steps: Steps, terms: int = 2) -> Exposures:
        """Return equal exposures of all charts, with weights of 1."""
        return cls(np.zeros((steps.colours.shape[2], steps.charts, terms)), np.ones(len(steps.seams)))

    def at(self, charts: Indices, places: Float64s) -> tuple[Float64s, Float64s]:
        """Return the factor and the offset at places in charts, each of shape (N, K)."""
        terms = self.terms[:, charts]
        factor = 1 + terms[..., 0]
        if terms.shape[2] > 2:
            factor = factor * (1 + np.einsum("nkt,kt->nk", terms[..., 2:], places))
        return np.maximum(factor, 0.25), terms[..., 1]

    def sides(self, steps: Steps) -> Float64s:
        """Return the corrected colours of both sides, shape (K, 2, N)."""
        found = []
        for side in (0, 1):
            factor, offset = self.at(steps.ends[:, side], steps.places[:, side])
            found.append(((steps.colours[:, side].T - offset) / factor).T)
        return np.stack(found, axis=1)

    def are_outliers(self, steps: Steps) -> Bools:
        """Return for each stretch whether the steps of its seam are mostly outliers."""
        return steps.means(self.weights, steps.seams)[steps.seams] < 1 / 4


def fit_exposures(steps: Steps, spread: tuple[float, ...], fixed: Bools | None = None) -> Exposures:
    """Fit the terms of all charts, whose deviation from 0 is `spread`; `fixed` charts have terms of 0."""
    found = Exposures.none(steps, len(spread))
    if not len(steps.seams):
        return found
    used, lengths = may_be_exposure(steps), np.bincount(steps.seams, steps.counts)[steps.seams]
    trust = steps.counts / np.maximum(STRETCH, lengths / PARTS)
    for number, scale in enumerate(SCALES):
        is_settled = 3 * number >= 2 * len(SCALES)
        sides = found.sides(steps)
        known = known_steps(steps, sides)
        noise = deviations(steps, sides)
        squares = np.where(known, np.square(sides[:, 1] - sides[:, 0]), 0).sum(axis=1)
        squares /= np.maximum(known.sum(axis=1), 1)
        # A seam that varies far more than others is an outlier.
        limit = OUTLIER * weighted_median(noise, steps.counts) if is_settled else np.inf
        allowed = np.square(scale * OUTLIER * np.minimum(noise, limit))
        weights = np.where(used & known.any(axis=1), 1 / np.square(1 + squares / allowed), 0)
        if is_settled:
            used &= ~Exposures(found.terms, weights).are_outliers(steps)
            weights *= used
        by_channel = (weights * trust / np.square(noise))[:, None] * known
        found = Exposures(_solved(steps, found, by_channel, spread, fixed), weights)
    return found


def known_steps(steps: Steps, sides: Float64s) -> Bools:
    """Return where corrected sides must agree, shape (K, N).

    A clipped colour is only a bound of the true one, and does not constrain a side within it.
    """
    low, high = steps.low, steps.high
    may_rise, may_fall = high[:, 0] | low[:, 1], low[:, 0] | high[:, 1]  # the first side
    return np.asarray(~np.where(sides[:, 0] < sides[:, 1], may_rise, may_fall))


def may_be_exposure(steps: Steps) -> Bools:
    """Return which stretches have steps of a size that cameras make, shape (K,)."""
    gain, offset = SPREADS["plain"]
    step = steps.colours[:, 1] - steps.colours[:, 0]
    expected = 2 * (np.square(gain * steps.colours.max(axis=1)) + offset**2)
    return np.asarray(np.mean(np.square(step) / expected, axis=1) <= OUTLIER**2)


def squared_steps(steps: Steps, sides: Float64s, units: Int64s) -> Float64s:
    """Return the squared mean step of each unit of stretches; the mean reduces noise."""
    step = np.where(known_steps(steps, sides), sides[:, 1] - sides[:, 0], 0)
    return np.asarray(np.mean([np.square(steps.means(each, units)) for each in step.T], axis=0))


def _solved(
    steps: Steps, found: Exposures, weights: Float64s, spread: tuple[float, ...], fixed: Bools | None
) -> Float64s:
    """Solve for the terms, shape (N, charts, terms), that explain steps with weights of shape (K, N).

    Tilts are common to all channels, as with vignetting, so that channels are solved for together.
    """
    from scipy.sparse import csr_array, diags_array
    from scipy.sparse.linalg import splu

    colours, (channels, charts, terms) = found.sides(steps).mean(axis=1), found.terms.shape
    unknowns = 2 * channels + terms - 2  # of a chart
    index = np.empty((channels, terms), np.int64)  # indices of a channel's terms among them
    index[:, :2], index[:, 2:] = np.arange(2 * channels).reshape(-1, 2), np.arange(2 * channels, unknowns)
    # A row sums the terms of both sides, with those of the first side negated.
    rows = np.ones((len(colours), channels, 2, terms))
    rows[..., 0] = colours[:, :, None]
    by_gain = colours[:, :, None] * (1 + found.terms[:, steps.ends, 0].transpose(1, 0, 2))
    rows[..., 2:] = by_gain[..., None] * steps.places[:, None, :, : terms - 2]
    rows[:, :, 0] *= -1
    if fixed is not None:
        rows *= ~fixed[steps.ends][:, None, :, None]
    columns = (steps.ends[:, None, :, None] * unknowns + index[:, None]).ravel()
    starts, shape = np.arange(0, rows.size + 1, 2 * terms), (len(colours) * channels, charts * unknowns)
    weighted = rows * weights[:, :, None, None]
    system, by_weight = (csr_array((each.ravel(), columns, starts), shape) for each in (rows, weighted))
    drawn = np.tile(np.r_[np.tile(spread[:2], channels), spread[2:]], charts) ** -2.0
    matrix = (system.T @ by_weight + diags_array(drawn)).tocsc()
    # A panel size of one column suits so sparse a matrix: up to twice as fast as the default.
    symmetric = {"SymmetricMode": True}
    factors = splu(matrix, "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, panel_size=1, options=symmetric)
    solved = factors.solve(by_weight.T @ (steps.colours[:, 1] - steps.colours[:, 0]).ravel())
    return np.asarray(solved.reshape(charts, unknowns)[:, index].transpose(1, 0, 2))


@dataclass(frozen=True)
class Verdict:
    """Result of the test on held-out seams."""

    spread: tuple[float, ...]  # expected deviations of the terms of the better model
    share: float  # of the mean step explained by one exposure per chart
    confidence: float  # of the F-test, that exposures cause the steps
    correlation: float  # mean correlation of the colours along both sides of a seam
    is_flat: bool  # whether seams have no pattern on most of their length
    is_clear: bool  # whether seams not yet held out could hardly change the result

    @property
    def is_rejected(self) -> bool:
        """Whether it is clear that exposures do not explain the steps."""
        return self.is_clear and self.confidence < CONFIDENCE

    @property
    def is_sure(self) -> bool:
        """Whether there are exposure steps, with patterns, if any, that continue across them."""
        return self.confidence >= CONFIDENCE and (self.is_flat or self.correlation >= MIN_CORRELATION)


def have_steps(steps: Steps) -> bool:
    """Whether enough of the length of seams between charts has steps for these to be due to exposures."""
    between, noise = steps.part(steps.between), np.square(deviations(steps, steps.colours))[steps.between]
    _, seam, stretches = np.unique(between.seams, return_inverse=True, return_counts=True)
    error = np.bincount(seam, noise) / stretches / np.minimum(stretches, PARTS)  # squared, of the mean
    limit = np.maximum(VISIBLE**2, BEYOND_NOISE**2 * error)
    is_stepped = squared_steps(between, between.colours, seam) > limit
    return bool(np.average(is_stepped[seam], weights=between.counts) >= MIN_STEPPED)


def judge(steps: Steps, fixed: Bools | None = None) -> Verdict:
    """Test by cross-validation whether exposures explain the steps, and whether gains vary within charts."""
    held_out, verdicts = _CrossValidation.of(steps), dict[tuple[float, ...], Verdict]()
    folds = np.unique(held_out.folds)
    sides = {spread: held_out.steps.colours.copy() for spread in SPREADS.values()}
    for fold in folds:
        for spread, each in sides.items():
            held_out.predict(each, fold, spread, fixed)
        tested = held_out.up_to(fold)
        if tested.count <= FEW_SEAMS and fold != folds[-1]:
            continue
        verdicts |= {spread: tested.verdict(spread, each) for spread, each in sides.items()}
        sides = {spread: each for spread, each in sides.items() if not verdicts[spread].is_rejected}
        change = [_gains(*map(tested.squares, sides.values()))] if len(sides) == 2 else []
        is_clear = [verdicts[each].is_clear for each in sides]
        if all(is_clear) and all(tested.is_clear(each, NORMAL_QUANTILE) for each in change):
            break
    plain, tilted = verdicts.values()
    is_better = any(tested.confidence(each) >= CONFIDENCE for each in change)
    return tilted if is_better or tilted.is_sure > plain.is_sure else plain


def _gains(before: Float64s, after: Float64s) -> Float64s:
    """Return the relative reduction of squared steps: 1 to 0, 0 if unchanged, -1 from 0."""
    return np.asarray((before - after) / np.maximum(before + after, np.finfo(float).tiny))


@dataclass(frozen=True)
class _CrossValidation:
    """Stretches between different charts, their folds of cross-validation, and the units of the test."""

    whole: Steps
    folds: Int64s  # of all stretches
    steps: Steps  # stretches between charts
    units: Int64s  # (K,): the units of the test, numbered from 0
    weights: Float64s  # (units,): texels
    inflation: float  # of the variance of their mean evidence, relative to independent units
    share: float = 1.0  # of the texels at seams that have been held out

    @classmethod
    def of(cls, steps: Steps) -> _CrossValidation:
        """Assign folds to seams, or to parts of seams, which share errors, if few seams close a loop."""
        between, inflation = steps.between, 2.0
        seams, first, number = np.unique(steps.seams, return_index=True, return_inverse=True)
        pairs = steps.ends[first][between[first]]
        if len(pairs) - steps.charts + connected(steps.charts, pairs).max(initial=-1) + 1 < MIN_LOOPS:
            units, inflation = steps.parts(), inflation * PARTS
            folds = units % PARTS
        else:
            count = len(seams) if len(seams) <= FEW_SEAMS else PARTS
            units, folds = number, (np.random.default_rng(0).permutation(len(seams)) % count)[number]
        units = np.unique(units[between], return_inverse=True)[1]
        weights = np.bincount(units, steps.counts[between]).astype(np.float64)
        return cls(steps, folds, steps.part(between), units, weights, inflation)

    def predict(self, sides: Float64s, fold: int, spread: tuple[float, ...], fixed: Bools | None) -> None:
        """Correct the stretches of a fold in `sides` by the exposures fitted to the other folds."""
        held = self.folds == fold
        rows = held[self.whole.between]
        sides[rows] = fit_exposures(self.whole.part(~held), spread, fixed).sides(self.steps.part(rows))

    def up_to(self, fold: int) -> _CrossValidation:
        """Return the test restricted to the units of the first folds."""
        is_held = np.zeros(len(self.weights), bool)
        is_held[self.units] = self.folds[self.whole.between] <= fold
        weights = self.weights * is_held
        return replace(self, weights=weights, share=float(weights.sum() / self.weights.sum()))

    @property
    def count(self) -> float:
        """Effective number of units: that of equal weights with the same information."""
        squares = float(np.square(self.weights).sum())
        return float(np.square(self.weights.sum())) / squares if squares else 0.0

    def mean(self, evidence: Float64s) -> tuple[float, float]:
        """Return the mean evidence and its variance."""
        total, count = self.weights.sum(), self.count
        mean = float(self.weights @ evidence / total)
        spread = float(np.square(self.weights * (evidence - mean)).sum()) / total**2
        variance = self.inflation * (spread * count / max(count - 1, 1))
        return mean, max(variance, np.finfo(float).tiny)

    def confidence(self, evidence: Float64s) -> float:
        """Return the confidence, by an F-test, that the mean evidence is positive."""
        from scipy.special import fdtr

        mean, variance = self.mean(evidence)
        if mean <= 0 or self.count <= 1:
            return 0.0
        return (1 + float(fdtr(1, self.count - 1, mean**2 / variance))) / 2

    def is_clear(self, evidence: Float64s, needed: float) -> bool:
        """Whether the final mean evidence is clearly above or below `needed` errors."""
        mean, variance = self.mean(evidence)
        left = abs(mean / np.sqrt(variance) - needed * np.sqrt(self.share))
        return bool(left >= CURTAILMENT * np.sqrt(1 - self.share))

    def squares(self, sides: Float64s) -> Float64s:
        """Return the mean squared step of the parts of each unit."""
        parts = np.unique(self.steps.parts(), return_inverse=True)[1]
        return self.steps.means(squared_steps(self.steps, sides, parts)[parts], self.units)

    def verdict(self, spread: tuple[float, ...], sides: Float64s) -> Verdict:
        """Test whether the predicted sides explain the steps, by the squared steps before and after."""
        steps, (correlations, has_pattern) = self.steps, self.continuity(sides)
        before, after = (self.squares(each) for each in (self.steps.colours, sides))
        gains = _gains(before, after)
        # Steps that no camera makes count as unexplained.
        possible = steps.means(may_be_exposure(steps), self.units)
        evidence = possible * np.where(has_pattern, gains, gains - (1 - gains))
        confidence = self.confidence(evidence)
        left, whole = (float(self.weights @ np.sqrt(each)) for each in (after, before))
        looks = (evidence, NORMAL_QUANTILE), (correlations - MIN_CORRELATION, 0.0), (has_pattern - 0.5, 0.0)
        is_clear = [self.is_clear(*each) for each in looks]
        return Verdict(
            spread=spread,
            share=max(0.0, 1 - left / whole) if whole else 0.0,
            confidence=confidence,
            correlation=float(np.average(correlations, weights=self.weights)),
            is_flat=bool(np.average(has_pattern, weights=self.weights) < 0.5),
            is_clear=all(is_clear) or (is_clear[0] and confidence < CONFIDENCE),
        )

    def continuity(self, sides: Float64s) -> tuple[Float64s, Bools]:
        """Return for each unit the correlation of colours along its two sides, and whether they vary."""
        follows = self.units[1:] == self.units[:-1]
        unit, changes = self.units[1:][follows], np.diff(sides, axis=0)[follows]
        count = np.maximum(np.bincount(unit, minlength=len(self.weights)), 1)

        def mean(values: Float64s) -> Float64s:
            return np.stack([np.bincount(unit, each, len(count)) / count for each in values.T], axis=1)

        # Slopes, as of gains that vary over charts, are not patterns; neither is rounding.
        first, second = (side - mean(side)[unit] for side in changes.transpose(1, 0, 2))
        both, one, other = (mean(each).mean(axis=1) for each in (first * second, first**2, second**2))
        correlation = both / np.sqrt((one + BYTE_STEP**2) * (other + BYTE_STEP**2))
        return correlation, (one + other) / 2 > (2 * BYTE_STEP) ** 2
