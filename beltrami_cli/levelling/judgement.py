"""Judgement whether exposures cause the steps at seams, by a test on seams that were held out.

A fit can remove any step. But only under exposures does a fit to some seams predict the steps at the others, since a
chart has one exposure at all of its seams. Each held-out seam gives its gain x = (b - a) / (b + a), where b and a are
its mean squared step before and after the prediction is removed. The F-test is of the mean evidence, which is x, or
where a seam has no pattern x - (1 - x): one colour per chart predicts some of the steps as well. It is weighted by the
length of seams, with 1 and n - 1 degrees of freedom, n = (sum w)^2 / sum w^2. Two seams predict each other by the
product of their steps, which enters both of their x, so that the variance of the mean is up to twice that of
independent x; twice is taken. Seams are held out fold by fold, until the result of the test of all seams is all but
certain [1]_.

References
----------
.. [1] K. K. G. Lan, R. Simon, M. Halperin, "Stochastically curtailed tests in long-term clinical trials", Sequential
       Analysis 1 (1982), doi 10.1080/07474948208836014.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from beltrami_cli.arrays import Bools, Float64s, Int64s
from beltrami_cli.levelling.exposures import SPREADS, fit_exposures, may_be_exposure, squared_steps
from beltrami_cli.levelling.steps import PARTS, Steps, deviations
from beltrami_cli.quantities import BYTE_STEP
from beltrami_cli.surface.grouping import connected

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
    between, noise = steps.select(steps.between), np.square(deviations(steps, steps.colours))[steps.between]
    _, seam, stretches = np.unique(between.seams, return_inverse=True, return_counts=True)
    error = np.bincount(seam, noise) / stretches / np.minimum(stretches, PARTS)  # squared, of the mean
    limit = np.maximum(VISIBLE**2, BEYOND_NOISE**2 * error)
    is_stepped = squared_steps(between, between.colours, seam) > limit
    return bool(np.average(is_stepped[seam], weights=between.counts) >= MIN_STEPPED)


def judge_steps(steps: Steps) -> Verdict | None:
    """Decide whether the charts differ in exposure; None if there are no steps."""
    return judge(steps) if steps.between.any() and have_steps(steps) else None


def judge(steps: Steps) -> Verdict:
    """Test by cross-validation whether exposures explain the steps, and whether gains vary within charts."""
    held_out, verdicts = _CrossValidation.of(steps), dict[str, Verdict]()
    folds = np.unique(held_out.folds)
    # The corrected sides by each model that is not rejected.
    sides = {model: held_out.steps.colours.copy() for model in SPREADS}
    for fold in folds:
        for model, corrected in sides.items():
            held_out.predict_in_place(corrected, fold, SPREADS[model])
        tested = held_out.up_to(fold)
        if tested.count <= FEW_SEAMS and fold != folds[-1]:
            continue
        verdicts |= {model: tested.verdict(SPREADS[model], corrected) for model, corrected in sides.items()}
        sides = {model: corrected for model, corrected in sides.items() if not verdicts[model].is_rejected}
        by_tilts = _gains(*map(tested.squares, sides.values())) if len(sides) == len(SPREADS) else None
        is_clear = by_tilts is None or tested.is_clear(by_tilts, NORMAL_QUANTILE)
        if is_clear and all(verdicts[model].is_clear for model in sides):
            break
    plain, tilted = verdicts["plain"], verdicts["tilted"]
    is_better = by_tilts is not None and tested.confidence(by_tilts) >= CONFIDENCE
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
        return cls(steps, folds, steps.select(between), units, weights, inflation)

    def predict_in_place(self, sides: Float64s, fold: int, spread: tuple[float, ...]) -> None:
        """Correct the stretches of a fold in `sides` by the exposures fitted to the other folds."""
        is_held = self.folds == fold
        rows = is_held[self.whole.between]
        sides[rows] = fit_exposures(self.whole.select(~is_held), spread).sides(self.steps.select(rows))

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
