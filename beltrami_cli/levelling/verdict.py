"""Whether one exposure per chart explains the steps at seams that were held out.

A fit can take out any step. But only under exposures does a fit to some seams predict the steps at the others, since a
chart has one exposure at all of its seams. Each held-out seam gives its gain

    x = (b - a) / (b + a),

where b and a are its mean squared step before and after the prediction is taken out: 1 if it is explained, 0 or less
on average if the steps at seams are unrelated. The F-test is of the mean of x, weighted by the length of seams, with 1
and n - 1 degrees of freedom, where n = (sum w)^2 / sum w^2 is the effective number of seams. Two seams predict each
other by the product of their steps, which enters both of their x, so that the variance of the mean is up to twice that
of independent x; twice is taken.

Charts that were painted in one colour each predict their seams as well. But only under exposures does the pattern
continue across a seam: the correlation of the changes of colour along its two sides has to pass the same test.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Bools, Float64s, Int64s
from beltrami_cli.levelling.fit import PLAIN, TILTED, fit_exposures, known_steps, may_be_exposure
from beltrami_cli.levelling.steps import FINEST, PARTS, Steps, oriented, parts_of, runs

# Of the F-test. At 0.975 no model without exposure steps is changed, and all exposures of the fox are found; at 0.99
# cut-off ones are missed: bench_levelling.py.
CONFIDENCE = 0.975
# Mean correlation along seams across which patterns continue: 0.24 or more on the samples and the fox, and
# 0.05 or less where charts have unrelated textures: tests/levelling.
_LEAST_CORRELATION = 0.15
# Where seams have no pattern, an exposure has to explain this share of the steps: 0.77 or more on spot.
_FLAT_SHARE = 0.75
# Seams are held out one by one if they are few, or in folds. bench_levelling.py: of the fox, 8 folds of its 19 seams
# leave too few to predict the others; of 66 and more seams, 8 suffice.
_FOLDS, _FEW_SEAMS = 8, 32
# Seams that close loops over charts; of fewer, too few seams are predicted by others, and parts of them are held out.
_FEWEST_LOOPS = 4


@dataclass(frozen=True)
class Verdict:
    """What the held-out seams say."""

    spread: tuple[float, ...]  # the expected deviations of the terms that explain most
    share: float  # of the mean step that one exposure per chart explains
    confidence: float  # of the F-test, that it explains any
    correlation: float  # mean, of the changes of colour along both sides of a seam
    is_flat: bool  # whether most of the length of seams has no pattern

    @property
    def continues(self) -> bool:
        """Whether patterns continue across seams, or exposures explain nearly all where there are no patterns."""
        return self.correlation >= _LEAST_CORRELATION or (self.is_flat and self.share >= _FLAT_SHARE)

    @property
    def is_sure(self) -> bool:
        """Whether there are exposure steps."""
        return self.confidence >= CONFIDENCE and self.continues


def judge(steps: Steps, fixed: Bools | None = None) -> Verdict:
    """Test by cross-validation whether exposures explain the steps at seams, and whether gains change over charts."""
    seams = _HeldOut.of(steps)
    sides = [seams.predicted(spread, fixed) for spread in (PLAIN, TILTED)]
    plain, tilted = (_verdict(seams, *each) for each in zip((PLAIN, TILTED), sides, strict=True))
    is_better = seams.confidence(_gains(*(seams.squared_steps(each) for each in sides))) >= CONFIDENCE
    return tilted if is_better or tilted.is_sure > plain.is_sure else plain


def _verdict(seams: _HeldOut, spread: tuple[float, ...], sides: Float64s) -> Verdict:
    before, after = (seams.squared_steps(each) for each in (seams.steps.colours, sides))
    # Steps that no camera makes count as unexplained.
    gains = _gains(before, after) * seams.mean(may_be_exposure(seams.steps))
    correlations, has_pattern = seams.continuity(sides)
    left, whole = (float(seams.weights @ np.sqrt(each)) for each in (after, before))
    return Verdict(
        spread,
        max(0.0, 1 - left / whole) if whole else 0.0,
        seams.confidence(gains),
        float(np.average(correlations, weights=seams.weights)),
        bool(np.average(has_pattern, weights=seams.weights) < 0.5),
    )


def _gains(before: Float64s, after: Float64s) -> Float64s:
    return (before - after) / np.maximum(before + after, np.finfo(float).tiny)


@dataclass(frozen=True)
class _HeldOut:
    """Units of the test: seams, or parts of them where too few seams close a loop, so that none predicts another."""

    steps: Steps
    folds: Int64s  # (K,)
    between: Bools  # (K,): stretches between different charts; the others are in no unit
    units: Int64s  # (stretches between charts,)
    weights: Float64s  # (units,): texels
    inflation: float  # of the variance of their mean gain, relative to independent units

    @classmethod
    def of(cls, steps: Steps) -> _HeldOut:
        starts, _, run = runs(steps)
        between = steps.ends[:, 0] != steps.ends[:, 1]
        if _loops(steps.ends[starts], steps.charts) < _FEWEST_LOOPS:
            units, folds, inflation = parts_of(steps), parts_of(steps) % PARTS, 2.0 * PARTS
        else:
            count = len(starts) if len(starts) <= _FEW_SEAMS else _FOLDS
            units, inflation = run, 2.0
            folds = (np.random.default_rng(0).permutation(len(starts)) % count)[run]
        numbers = np.unique(units[between], return_inverse=True)[1]
        return cls(
            steps,
            folds,
            between,
            numbers,
            np.bincount(numbers, steps.counts[between]).astype(np.float64),
            inflation,
        )

    def confidence(self, gains: Float64s) -> float:
        """Return the confidence that the mean gain is above 0, by an F-test."""
        from scipy.stats import f

        total = self.weights.sum()
        mean = float(self.weights @ gains / total)
        count = float(np.square(total) / np.square(self.weights).sum())
        if mean <= 0 or count <= 1:
            return 0.0
        spread = float(np.square(self.weights * (gains - mean)).sum()) / total**2 * count / (count - 1)
        ratio = mean**2 / max(self.inflation * spread, np.finfo(float).tiny)
        return 1 - float(f.sf(ratio, 1, count - 1)) / 2

    def predicted(self, spread: tuple[float, ...], fixed: Bools | None) -> Float64s:
        """Return the colours of both sides without the exposures that the other folds say."""
        after = np.empty_like(self.steps.colours)
        for fold in np.unique(self.folds):
            held = self.folds == fold
            found = fit_exposures(self.steps.part(~held), spread, fixed)
            after[held] = found.sides(self.steps.part(held))
        return after

    def mean(self, values: Bools | Float64s) -> Float64s:
        """Return the mean of values of stretches over each unit."""
        counts = self.steps.counts[self.between]
        return np.bincount(self.units, values[self.between] * counts, len(self.weights)) / self.weights

    def squared_steps(self, sides: Float64s) -> Float64s:
        """Return for each unit the mean over its parts of the squared mean step, in which noise is averaged away."""
        step = np.where(known_steps(self.steps, sides), oriented(self.steps, sides[:, 1] - sides[:, 0]), 0)
        _, part = np.unique(parts_of(self.steps), return_inverse=True)
        texels = np.bincount(part, self.steps.counts)
        means = [np.bincount(part, each * self.steps.counts) / texels for each in step.T]
        return self.mean(np.square(means).mean(axis=0)[part])

    def continuity(self, sides: Float64s) -> tuple[Float64s, Bools]:
        """Return for each unit the correlation of the changes along its two sides, and whether there are any."""
        ends = self.steps.ends[self.between]
        sides = np.where(
            (ends[:, 0] > ends[:, 1])[:, None, None], sides[self.between][:, ::-1], sides[self.between]
        )
        follows = (self.units[1:] == self.units[:-1]) & np.all(ends[1:] == ends[:-1], axis=1)
        changes = np.diff(sides, axis=0)
        bends = np.zeros(len(follows), bool)
        bends[1:] = follows[1:] & follows[:-1]
        turns = np.square(np.diff(changes, axis=0)).mean(axis=(1, 2))[bends[1:]]
        first, second = changes[follows].transpose(1, 0, 2)

        def mean(values: Float64s, of: Bools) -> Float64s:
            unit = self.units[1:][of]
            count = np.bincount(unit, minlength=len(self.weights))
            return np.asarray(np.bincount(unit, values, len(self.weights)) / np.maximum(count, 1))

        # Rounding makes no pattern; neither do slopes, as of gains that change over charts.
        both, one, other = (
            mean(each.mean(axis=1), follows) for each in (first * second, first**2, second**2)
        )
        correlation = both / np.sqrt((one + FINEST**2) * (other + FINEST**2))
        has_turns = mean(turns, bends) > (2 * FINEST) ** 2
        return correlation, has_turns


def _loops(ends: Int64s, charts: int) -> int:
    """Return how many seams close a loop over charts."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    ends = ends[ends[:, 0] != ends[:, 1]]
    joined = coo_array((np.ones(len(ends)), ends.T), shape=(charts, charts))
    return len(ends) - charts + int(connected_components(joined, directed=False)[0])
