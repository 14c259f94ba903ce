"""Exposures of charts, fitted to the steps at seams.

On the two sides p and q of a seam between charts of gains 1 + g and offsets o the true colour T is the same:

    v_q - v_p = (g_q - g_p) T + o_q - o_p,

where T is the mean of both sides as corrected so far. So a gain common to all charts makes no difference (if T were
the colour on either side, noise would draw all gains to -1). The terms are drawn to 0, each by its expected deviation.
Weights follow the estimator of Geman and McClure, whose scale is narrowed step by step [1], so that an edge
of colour counts for nothing.

References
----------
.. [1] H. Yang, P. Antonante, V. Tzoumas, L. Carlone, "Graduated non-convexity for robust spatial perception", IEEE
       Robotics and Automation Letters 5 (2020), doi 10.1109/LRA.2020.2965893.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Bools, Float64s, Indices, Int64s
from beltrami_cli.levelling.steps import PARTS, STRETCH, Steps, deviations, weighted_median

# Expected deviations of gains and offsets of cameras; and, if gains vary linearly over charts, also of tilts. With half
# of them, these, and twice, the error of exposed samples (tests/levelling/exposure_scene.py) falls by 28.5, 29.2 and
# 29.0 dB, and with gains that vary by 16.2, 19.4 and 20.0 dB.
SPREADS = {"plain": (0.1, 0.03), "tilted": (0.05, 0.02, 0.06, 0.06)}
# Number of deviations beyond which a step is an outlier: larger than cameras make, or an edge of colour along the seam.
# With 2 and 5 errors as above fall by 29.2 and 29.0 dB, and with gains that vary by 19.7 and 18.0 dB.
OUTLIER = 2.5
# Scales of the weights, narrowed to 1 and kept there; in the last third, seams of outliers are left out.
SCALES = (4.0, 2.8, 2.0, 1.4, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)


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
        corrected = []
        for side in (0, 1):
            factor, offset = self.at(steps.ends[:, side], steps.places[:, side])
            corrected.append(((steps.colours[:, side].T - offset) / factor).T)
        return np.stack(corrected, axis=1)

    def are_outliers(self, steps: Steps) -> Bools:
        """Return for each stretch whether the steps of its seam are mostly outliers."""
        return steps.means(self.weights, steps.seams)[steps.seams] < 1 / 4


def fit_exposures(steps: Steps, spread: tuple[float, ...]) -> Exposures:
    """Fit the terms of all charts, whose deviation from 0 is `spread`; fixed charts have terms of 0."""
    exposures = Exposures.none(steps, len(spread))
    if not len(steps.seams):
        return exposures
    used, lengths = may_be_exposure(steps), np.bincount(steps.seams, steps.counts)[steps.seams]
    trust = steps.counts / np.maximum(STRETCH, lengths / PARTS)
    for number, scale in enumerate(SCALES):
        is_settled = 3 * number >= 2 * len(SCALES)
        sides = exposures.sides(steps)
        known = known_steps(steps, sides)
        noise = deviations(steps, sides)
        squares = np.where(known, np.square(sides[:, 1] - sides[:, 0]), 0).sum(axis=1)
        squares /= np.maximum(known.sum(axis=1), 1)
        # A seam that varies far more than others is an outlier.
        limit = OUTLIER * weighted_median(noise, steps.counts) if is_settled else np.inf
        allowed = np.square(scale * OUTLIER * np.minimum(noise, limit))
        weights = np.where(used & known.any(axis=1), 1 / np.square(1 + squares / allowed), 0)
        if is_settled:
            used &= ~Exposures(exposures.terms, weights).are_outliers(steps)
            weights *= used
        by_channel = (weights * trust / np.square(noise))[:, None] * known
        exposures = Exposures(_solved(steps, exposures, by_channel, spread), weights)
    return exposures


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


def _solved(steps: Steps, exposures: Exposures, weights: Float64s, spread: tuple[float, ...]) -> Float64s:
    """Solve for the terms, shape (N, charts, terms), that explain steps with weights of shape (K, N).

    Tilts are common to all channels, as with vignetting, so that channels are solved for together.
    """
    from scipy.sparse import csr_array, diags_array
    from scipy.sparse.linalg import splu

    colours, (channels, charts, terms) = exposures.sides(steps).mean(axis=1), exposures.terms.shape
    unknowns = 2 * channels + terms - 2  # of a chart
    index = np.empty((channels, terms), np.int64)  # indices of a channel's terms among them
    index[:, :2], index[:, 2:] = np.arange(2 * channels).reshape(-1, 2), np.arange(2 * channels, unknowns)
    # A row sums the terms of both sides; the terms of the first side are negated.
    rows = np.ones((len(colours), channels, 2, terms))
    rows[..., 0] = colours[:, :, None]
    by_gain = colours[:, :, None] * (1 + exposures.terms[:, steps.ends, 0].transpose(1, 0, 2))
    rows[..., 2:] = by_gain[..., None] * steps.places[:, None, :, : terms - 2]
    rows[:, :, 0] *= -1
    rows *= ~steps.fixed[steps.ends][:, None, :, None]
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
