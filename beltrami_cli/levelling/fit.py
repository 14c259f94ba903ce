"""Gains and offsets of charts, by robust least squares over the steps at their seams.

Where a chart c was exposed by a gain and an offset, it shows (1 + g_c) T + o_c in place of the colour T, channel by
channel. In a tilted fit (1 + g_c) is multiplied by 1 + h_c . x, linear in the place x in the chart and the same in all
channels, as vignetting is. On the two sides p and q of a seam T is the same:

    v_q - v_p = (g_q - g_p) T + o_q - o_p,

where T is the mean of both sides as corrected so far. So a gain common to all charts makes no difference (if T were
the colour on either side, noise would draw all gains to -1), and at the fixed point the two sides of a seam have equal
means and variances, whether or not their patterns fit together to a texel. The terms are drawn to 0, each by the
deviation that is expected of it. Weights fall with the residual: first as for the sum of distances [1], which has one
minimum, then as for the estimator of Geman and McClure [2], under which a painted edge counts for nothing.

Charts are few beside texels, so the normal equations are small, and solved by a sparse factorisation on one thread.

References
----------
.. [1] P. Holland, R. Welsch, "Robust regression using iteratively reweighted least-squares", Communications in
       Statistics 6 (1977), doi 10.1080/03610927708827533.
.. [2] S. Geman, D. McClure, "Statistical methods for tomographic image reconstruction", Bulletin of the International
       Statistical Institute 52 (1987).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from beltrami_cli.arrays import Bools, Float64s, Int64s
from beltrami_cli.levelling.steps import Steps, with_noise
from beltrami_cli.surface.atlas import Indices

GAIN, OFFSET, TILTS = 0, 1, slice(2, 4)

# Iterations with each of the two weights; fewer where the fit only has to be judged.
FULL, SHORT = (7, 6), (4, 2)
_DAMPING = 0.7
# Residual, beside its usual size, at which weights fall; the scale of the second ones is narrowed from wide.
_ALLOWED = 3 / 255
_WIDEST, _NARROWING = 4.0, 0.7
_DEVIATIONS = 2.5
# Then seams are dropped that agree with the others less than this, and the rest is fitted again.
_STRICTER = (0.3, 0.5)
# So are all seams of charts of which less than this share agrees.
_LEAST_AGREED = 0.25
# A step of so many deviations is none of exposure, if gains and offsets of cameras deviate by these.
_LARGEST, _USUAL = 2.0, (0.1, 0.03)
# Exposures are at all seams: where less than this share of their length agrees, paint decides what is fitted.
_LEAST_EXPLAINED = 0.53
# Neighbouring texels of a seam share errors: so many say as much as one, and a whole seam as so many of these.
_ALIKE, _MOST = 15.0, 8.0
_GAINS = (-0.45, 0.8)
_SYMMETRIC = {"SymmetricMode": True}  # of a factorisation


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


def fit_exposures(
    steps: Steps, spread: tuple[float, ...], iterations: tuple[int, int] = FULL, fixed: Bools | None = None
) -> Exposures:
    """Fit the terms of all charts, of which `spread` are the expected deviations; `fixed` charts have none."""
    system, noise, scale = _System(steps, spread, fixed), steps.noise, _WIDEST
    unchanged = np.zeros((steps.colours.shape[2], steps.charts, len(spread)))
    found = Exposures(unchanged, np.ones(len(steps.seams)))
    for number in range(iterations[0] + (1 + len(_STRICTER)) * iterations[1]):
        rounds, place = divmod(number - iterations[0], iterations[1])
        sides = found.sides(steps)
        if place == 0 and rounds >= 0:
            # What varies along a seam by exposure is no noise.
            noise = np.minimum(noise, with_noise(replace(steps, colours=sides)).noise)
        if place == 0 and rounds > 0:
            system.drop(found, _STRICTER[rounds - 1])
        system.known = known_steps(steps, sides)
        residual = _distances(sides[:, 1] - sides[:, 0], system.known)
        if rounds < 0:
            weights = 1 / (1 + residual / (noise + _ALLOWED))
        else:
            scale = max(1.0, _NARROWING * scale)
            allowed = scale * (_DEVIATIONS * noise + _ALLOWED)
            weights = 1 / np.square(1 + np.square(residual / allowed))
        weights = np.where(system.used & system.known.any(axis=1), weights, 0)
        terms = system.solve(found, sides.mean(axis=1), weights * system.trust / np.square(noise))
        terms = found.terms + _DAMPING * (terms - found.terms)
        terms[..., GAIN] = terms[..., GAIN].clip(*_GAINS)
        found = Exposures(terms, weights)
    return found


def known_steps(steps: Steps, sides: Float64s) -> Bools:
    """Return where corrected sides must agree, shape (K, N).

    A colour that was cut off is a bound of what it was, and tells nothing of a side within it.
    """
    low, high = steps.low, steps.high
    may_rise, may_fall = high[:, 0] | low[:, 1], low[:, 0] | high[:, 1]  # the first side beside the second
    return np.asarray(~np.where(sides[:, 0] < sides[:, 1], may_rise, may_fall))


def may_be_exposure(steps: Steps) -> Bools:
    """Return which stretches have steps that cameras could make, shape (K,)."""
    step = steps.colours[:, 1] - steps.colours[:, 0]
    expected = 2 * (np.square(_USUAL[0] * steps.colours.max(axis=1)) + _USUAL[1] ** 2)
    return np.asarray((np.mean(np.square(step) / expected, axis=1) <= _LARGEST**2) & ~steps.is_paint)


def may_be_of_cameras(steps: Steps, found: Exposures) -> bool:
    """Return whether most of the length of seams agrees with a fit, and its gains deviate no more than cameras' do."""
    explained = np.average(found.weights, weights=steps.counts)
    gains = found.terms[:, steps.ends, GAIN]
    # What is common to all charts tells nothing: charts that stay as they are may have any exposure.
    gains = gains - np.average(gains.mean(axis=2), axis=1, weights=steps.counts)[:, None, None]
    deviation = np.sqrt(np.average(np.square(gains).mean(axis=(0, 2)), weights=steps.counts))
    return bool(explained >= _LEAST_EXPLAINED and deviation <= _LARGEST * _USUAL[GAIN])


class _System:
    """The normal equations of a fit, whose pattern stays while their values change."""

    def __init__(self, steps: Steps, spread: tuple[float, ...], fixed: Bools | None) -> None:
        self._steps, self._terms = steps, len(spread)
        self._spread = np.array(spread)
        self._tied = np.ones(steps.charts) if fixed is None else np.where(fixed, 1e6, 1.0)
        self._place = _order_of_elimination(steps)
        before, after = steps.colours[:, 0], steps.colours[:, 1]
        self._step = after - before
        lengths = np.bincount(steps.seams, steps.counts)[steps.seams]
        self.trust = steps.counts / np.maximum(_ALIKE, lengths / _MOST)
        self.known = known_steps(steps, steps.colours)
        self.used = may_be_exposure(steps)

    def drop(self, found: Exposures, least: float) -> None:
        """Use no seam any more whose mean weight is below the least, and none of charts that are painted themselves."""
        steps = self._steps
        counts = steps.counts * self.known.any(axis=1)
        totals = np.maximum(np.bincount(steps.seams, counts), 1)
        shares = np.bincount(steps.seams, found.weights * counts) / totals
        self.used &= shares[steps.seams] >= least
        between = steps.ends[:, 0] != steps.ends[:, 1]
        lengths, agreed = np.zeros((2, steps.charts))
        for side in steps.ends[between].T:
            lengths += np.bincount(side, counts[between], steps.charts)
            agreed += np.bincount(side, (counts * self.used)[between], steps.charts)
        is_painted = agreed < _LEAST_AGREED * lengths
        self.used &= ~is_painted[steps.ends].any(axis=1)

    def solve(self, found: Exposures, colours: Float64s, weights: Float64s) -> Float64s:
        """Return the terms, shape (N, charts, terms), for the true colours at the steps as known so far.

        Tilts are common to all channels, as vignetting is, so that these are solved for together.
        """
        channels = np.arange(colours.shape[1])
        together = [channels] if found.is_tilted else np.split(channels, len(channels))
        return np.concatenate([self._solved(each, found, colours, weights) for each in together])

    def _solved(self, channels: Int64s, found: Exposures, colours: Float64s, weights: Float64s) -> Float64s:
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
            weighted = data * np.repeat(weights * self.known[:, channel], 2 * count)
            all_rows.append(csr_array((data, columns, starts), shape))
            all_weighted.append(csr_array((weighted, columns, starts), shape))
            steps.append(self._step[:, channel])
        rows, by_weight = vstack(all_rows, "csr"), vstack(all_weighted, "csr")
        spread = np.r_[np.tile(self._spread[:2], len(channels)), self._spread[2:]]
        drawn = np.empty((self._steps.charts, unknowns))
        drawn[self._place] = np.square(np.outer(self._tied, 1 / spread))
        matrix = (rows.T @ by_weight + diags_array(drawn.ravel())).tocsc()
        factors = splu(matrix, permc_spec="NATURAL", diag_pivot_thresh=0.0, options=_SYMMETRIC)
        solved = factors.solve(np.asarray(by_weight.T @ np.concatenate(steps)))
        solved = solved.reshape(-1, unknowns)[self._place]
        exposed = solved[:, :own].reshape(-1, len(channels), 2).transpose(1, 0, 2)
        tilts = np.broadcast_to(solved[:, own:], (len(channels), len(solved), count - 2))
        return np.concatenate([exposed, tilts], axis=2)

    def _rows(self, colours: Float64s, factors: Float64s) -> Float64s:
        """Return what the terms of both sides of each step, of which those of the first are negative, add to it."""
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
    return splu(matrix, permc_spec="MMD_AT_PLUS_A", options=_SYMMETRIC).perm_c.astype(np.int64)


def _distances(difference: Float64s, known: Bools) -> Float64s:
    """Return the root mean square over the channels that are known."""
    squares = np.where(known, np.square(difference), 0).sum(axis=1)
    return np.asarray(np.sqrt(squares / np.maximum(known.sum(axis=1), 1)))
