"""Gains and offsets of charts, by robust least squares over the steps at their seams.

Where a chart c was exposed by a gain and an offset, it shows (1 + g_c) T + o_c in place of the colour T, channel by
channel. In a tilted fit (1 + g_c) is multiplied by 1 + h_c . x, linear in the place x in the chart and the same in all
channels, as vignetting is. On the two sides p and q of a seam T is the same:

    v_q - v_p = (g_q - g_p) T + o_q - o_p,

where T is the mean of both sides as corrected so far. So a gain common to all charts makes no difference (if T were
the colour on either side, noise would draw all gains to -1). The terms are drawn to 0, each by its expected deviation.
Weights follow the estimator of Geman and McClure, whose scale is narrowed step by step [1], so that a painted
edge counts for nothing.

Charts are few compared with texels, so the normal equations are small, and solved by a sparse factorisation on one
thread.

References
----------
.. [1] H. Yang, P. Antonante, V. Tzoumas, L. Carlone, "Graduated non-convexity for robust spatial perception", IEEE
       Robotics and Automation Letters 5 (2020), doi 10.1109/LRA.2020.2965893.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Bools, Float64s, Int64s
from beltrami_cli.levelling.steps import PARTS, STRETCH, Steps, deviations, weighted_median
from beltrami_cli.surface.atlas import Indices

GAIN, OFFSET, TILTS = 0, 1, slice(2, 4)

# Expected deviations of gains, of offsets, and of tilts if gains may change over charts.
PLAIN, TILTED = (0.1, 0.03), (0.05, 0.02, 0.06, 0.06)
# A step of more than so many of these deviations is paint. Hand-set.
_LARGEST = 2.0
# Hand-set. Painted seams are left out of the last ones.
_ITERATIONS, _SETTLED = 12, 8
# Mean weight of a seam below which it is painted. Hand-set.
_LEAST_AGREED = 0.4
# Hand-set: the scale starts so much wider, and narrows by this factor.
_WIDEST = 4.0
_NARROWING = 0.7
# Deviations at which a weight is 1/4. Hand-set.
_INLIERS = 2.5


@dataclass(frozen=True)
class Exposures:
    """The terms of charts, and how far the stretches of seams agree with them."""

    terms: Float64s  # (N, charts, 2 or 4): gain, offset, tilts along rows and columns
    weights: Float64s  # (K,): 1 where the sides agree, towards 0 where they differ by paint

    @property
    def is_tilted(self) -> bool:
        """Whether gains change over charts, so that places matter."""
        return bool(self.terms.shape[2] > 2)

    def at(self, charts: Indices, places: Float64s) -> tuple[Float64s, ...]:
        """Return the factor and the offset at places in charts, each of shape (N, K)."""
        terms = self.terms[:, charts]
        factor = 1 + terms[..., GAIN]
        if self.is_tilted:
            factor = factor * (1 + np.einsum("nkt,kt->nk", terms[..., TILTS], places))
        return np.maximum(factor, 0.25), terms[..., OFFSET]

    def sides(self, steps: Steps) -> Float64s:
        """Return the corrected colours of both sides, shape (K, 2, N)."""
        found = []
        for side in (0, 1):
            factor, offset = self.at(steps.ends[:, side], steps.places[:, side])
            found.append(((steps.colours[:, side].T - offset) / factor).T)
        return np.stack(found, axis=1)


def fit_exposures(steps: Steps, spread: tuple[float, ...], fixed: Bools | None = None) -> Exposures:
    """Fit the terms of all charts, which deviate from 0 by `spread`; `fixed` charts have none."""
    system = _System(steps, spread, fixed)
    unchanged = np.zeros((steps.colours.shape[2], steps.charts, len(spread)))
    found = Exposures(unchanged, np.ones(len(steps.seams)))
    scale = _WIDEST
    for number in range(_ITERATIONS):
        sides = found.sides(steps)
        known = known_steps(steps, sides)
        noise = deviations(steps, sides)
        if not len(noise):
            break
        squares = np.where(known, np.square(sides[:, 1] - sides[:, 0]), 0).sum(axis=1)
        squares /= np.maximum(known.sum(axis=1), 1)
        usual = weighted_median(noise, steps.counts)
        inlying = noise if number < _SETTLED else np.minimum(noise, _INLIERS * usual)
        allowed = np.square(scale * _INLIERS * inlying)
        weights = np.where(system.used & known.any(axis=1), 1 / np.square(1 + squares / allowed), 0)
        if number >= _SETTLED:
            counts = np.maximum(np.bincount(steps.seams, steps.counts), 1)
            shares = np.bincount(steps.seams, weights * steps.counts, len(counts)) / counts
            system.used &= shares[steps.seams] >= _LEAST_AGREED
            weights *= system.used
        terms = system.solve(found, sides.mean(axis=1), weights * system.trust / np.square(noise), known)
        found = Exposures(terms, weights)
        scale = max(1.0, _NARROWING * scale)
    return found


def known_steps(steps: Steps, sides: Float64s) -> Bools:
    """Return where corrected sides must agree, shape (K, N).

    A colour that was cut off is a bound of what it was, and says nothing about a side within it.
    """
    low, high = steps.low, steps.high
    may_rise, may_fall = high[:, 0] | low[:, 1], low[:, 0] | high[:, 1]  # of the first side
    return np.asarray(~np.where(sides[:, 0] < sides[:, 1], may_rise, may_fall))


def may_be_exposure(steps: Steps) -> Bools:
    """Return which stretches have steps that cameras could make, shape (K,)."""
    step = steps.colours[:, 1] - steps.colours[:, 0]
    expected = 2 * (np.square(PLAIN[GAIN] * steps.colours.max(axis=1)) + PLAIN[OFFSET] ** 2)
    return np.asarray(np.mean(np.square(step) / expected, axis=1) <= _LARGEST**2)


class _System:
    """The normal equations of a fit, whose pattern stays while their values change."""

    def __init__(self, steps: Steps, spread: tuple[float, ...], fixed: Bools | None) -> None:
        self._steps, self._terms = steps, len(spread)
        self._spread = np.array(spread)
        self._tied = np.ones(steps.charts) if fixed is None else np.where(fixed, 1e6, 1.0)
        self._place = _order_of_elimination(steps)
        self._step = steps.colours[:, 1] - steps.colours[:, 0]
        lengths = np.bincount(steps.seams, steps.counts)[steps.seams]
        self.trust = steps.counts / np.maximum(STRETCH, lengths / PARTS)
        self.used = may_be_exposure(steps)

    def solve(self, found: Exposures, colours: Float64s, weights: Float64s, known: Bools) -> Float64s:
        """Return the terms, shape (N, charts, terms), for the true colours at the steps as known so far.

        Tilts are common to all channels, as vignetting is, so that these are solved for together.
        """
        channels = np.arange(colours.shape[1])
        together = [channels] if found.is_tilted else np.split(channels, len(channels))
        return np.concatenate([self._solved(each, found, colours, weights, known) for each in together])

    def _solved(
        self, channels: Int64s, found: Exposures, colours: Float64s, weights: Float64s, known: Bools
    ) -> Float64s:
        from scipy.sparse import csr_array, diags_array, vstack
        from scipy.sparse.linalg import splu

        own, ends, count = 2 * len(channels), self._steps.ends, self._terms
        unknowns = own + count - 2
        shape = len(colours), unknowns * self._steps.charts
        starts = np.arange(0, 2 * count * len(colours) + 1, 2 * count, dtype=np.int32)
        all_rows, all_weighted, steps = [], [], []
        for number, channel in enumerate(channels):
            places = np.r_[2 * number, 2 * number + 1, own : own + count - 2]
            columns = (self._place[ends][:, :, None] * unknowns + places).astype(np.int32).ravel()
            data = self._rows(colours[:, channel], 1 + found.terms[channel, :, GAIN][ends])
            weighted = data * np.repeat(weights * known[:, channel], 2 * count)
            all_rows.append(csr_array((data, columns, starts), shape))
            all_weighted.append(csr_array((weighted, columns, starts), shape))
            steps.append(self._step[:, channel])
        rows, by_weight = vstack(all_rows, "csr"), vstack(all_weighted, "csr")
        spread = np.r_[np.tile(self._spread[:2], len(channels)), self._spread[2:]]
        drawn = np.empty((self._steps.charts, unknowns))
        drawn[self._place] = np.square(np.outer(self._tied, 1 / spread))
        matrix = (rows.T @ by_weight + diags_array(drawn.ravel())).tocsc()
        factors = splu(matrix, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        solved = factors.solve(np.asarray(by_weight.T @ np.concatenate(steps)))
        solved = solved.reshape(-1, unknowns)[self._place]
        exposed = solved[:, :own].reshape(-1, len(channels), 2).transpose(1, 0, 2)
        tilts = np.broadcast_to(solved[:, own:], (len(channels), len(solved), count - 2))
        return np.concatenate([exposed, tilts], axis=2)

    def _rows(self, colours: Float64s, factors: Float64s) -> Float64s:
        """Sum the terms of both sides of each step, with the first side's negated."""
        rows = np.empty((len(colours), 2, self._terms))
        rows[:, :, GAIN] = colours[:, None]
        rows[:, :, OFFSET] = 1
        if self._terms > 2:
            rows[:, :, TILTS] = (colours[:, None] * factors)[:, :, None] * self._steps.places
        rows[:, 0] *= -1
        return np.asarray(rows.ravel())


def _order_of_elimination(steps: Steps) -> Int64s:
    """Return the place of each chart in an order in which factors stay sparse; of charts it is sooner found."""
    from scipy.sparse import coo_array, eye_array
    from scipy.sparse.linalg import splu

    pairs = steps.ends[steps.ends[:, 0] != steps.ends[:, 1]]
    joined = coo_array((np.full(len(pairs), 1 / max(1, len(pairs))), pairs.T), shape=(steps.charts,) * 2)
    matrix = (joined + joined.T + 3 * eye_array(steps.charts)).tocsc()
    return splu(matrix, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).perm_c.astype(np.int64)
