"""Choice of the kernel's parameters by the estimated error of the result, and prediction of its PSNR.

The error of the result f is predicted from the variance of the noise and the divergence of f:

    E |f(y) - x|^2 = sigma^2 div f(y).

This holds where f is the mean of x given y (the second-order formula of Tweedie [1]_). It is far less sensitive to an
error of sigma^2 than Stein's estimate, which subtracts sigma^2 from what was removed: an error of a tenth of sigma^2 is
as large as the error that remains. Stein's estimate at the least and the largest plausible noise bounds the prediction.

References
----------
.. [1] B. Efron, "Tweedie's formula and selection bias", J. American Statistical Association 106(496), 2011.
   https://doi.org/10.1198/jasa.2011.tm11181
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np

from beltrami_cli.arrays import Float64s
from beltrami_cli.flow.choice.risk import Risk, RiskEstimate
from beltrami_cli.flow.choice.search import Grid, Schedule, Search
from beltrami_cli.flow.manifolds.kernel_work import LOG
from beltrami_cli.flow.manifolds.manifold import Manifold, SampleTrial
from beltrami_cli.flow.manifolds.search_range import Rule, SearchRange
from beltrami_cli.flow.noise.model import NoiseModel, choose_beta, overall_noise
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.quantities import BYTE_STEP

# Candidate values of beta times the noise.
_CONTRASTS = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0)

# The largest candidate if patches follow: with larger ones, noise that is kept as edges decides which patches are
# similar.
_MAX_BEFORE_PATCHES = 2.0

# Weight of smoothness for noise that neighbours share. Low quantiles underestimate such noise, and kernels keep its
# coarse steps as if they were edges. Enlarged pictures gain 0.9 dB by this weight, and JPEG pictures 0.5 dB.
_SHARED_NOISE_WEIGHT = 1.5

# Error of predictions in dB with a certainty of 90 %, if the noise is known. Together with the uncertainty of the noise
# it makes intervals that hold 70 of 74 results of `benchmarks/bench_regret.py`, and 94 of 126 with pictures of four
# packages. A larger value would make most intervals wider than `_MAX_INTERVAL_WIDTH`.
_PREDICTION_ERROR = 2.5

# A prediction is reported if its interval is at most this wide, in dB.
_MAX_INTERVAL_WIDTH = 8.0


@dataclass(frozen=True)
class Prediction:
    """The PSNR of a result against noise-free colours, and that of the input, in dB."""

    before: float
    psnr: float
    least: float  # `least` and `most`: interval of the PSNR with a certainty of 90 %
    most: float

    def in_unit(self, unit: float) -> Prediction:
        """Return the prediction for colours that are multiplied by `unit`."""
        shift = 20 * math.log10(unit)
        return Prediction(*(value - shift for value in dataclasses.astuple(self)))

    @property
    def is_useful(self) -> bool:
        return self.most - self.least <= _MAX_INTERVAL_WIDTH and self.least >= self.before


@dataclass(frozen=True)
class Choice:
    """The chosen parameters, and the estimates behind the choice."""

    chosen: dict[str, float]  # values of the free parameters
    # Estimated against noise-free colours, before clipped averages are restored; None: unknown.
    psnr: float | None = None
    error: float | None = None  # standard error of `psnr` in dB, given the noise
    gain: float | None = None  # in dB over the estimated PSNR of the input
    candidates: int = 0  # number of schedules compared
    samples: int = 0  # number of samples they were compared on
    correlated: bool = False  # whether neighbouring samples share noise
    # None: not known well enough. `psnr` decides, but is too high where the noise is overestimated.
    predicted: Prediction | None = None

    @property
    def interval(self) -> tuple[float, float] | None:
        """Interval of the result's PSNR with a certainty of 90 %; None: not known well enough."""
        return None if self.predicted is None else (self.predicted.least, self.predicted.most)

    def in_unit(self, unit: float) -> Choice:
        """Return the choice for colours that are multiplied by `unit`."""
        chosen = {name: value / unit if name == "beta" else value for name, value in self.chosen.items()}
        psnr = None if self.psnr is None else self.psnr - 20 * math.log10(unit)
        predicted = None if self.predicted is None else self.predicted.in_unit(unit)
        return dataclasses.replace(self, chosen=chosen, psnr=psnr, predicted=predicted)

    def improved(self, gain: float) -> Choice:
        """Return the choice with a mean square error that is less by `gain`, where it was estimated."""
        if self.psnr is None or self.error is None or self.gain is None:
            return self
        before = 10 ** (-self.psnr / 10)
        error = self.error * before / _in_decibels(1)
        after = max(before - gain, error, 1e-12)
        better = 10 * float(np.log10(before / after))
        return dataclasses.replace(
            self, psnr=self.psnr + better, gain=self.gain + better, error=_in_decibels(error / after)
        )


def choose(
    trial: SampleTrial,
    manifold: Manifold,
    parameters: KernelParameters,
    tick: Callable[[], None] | None = None,
) -> tuple[KernelParameters, Choice]:
    """Choose the free parameters with the least estimated error on a sample of the manifold."""
    metric_sigma = manifold.noise.sigma[manifold.metric_channels]
    scale = choose_beta(metric_sigma, 1.0) * manifold.unit if len(metric_sigma) else 0.0
    grid = _grid(parameters, manifold.search_range, scale, manifold.beta)
    weight = (_SHARED_NOISE_WEIGHT if manifold.noise.is_shared else 1.0) * parameters.strength
    risks = RiskEstimate.on(trial, manifold.noise.sigma, manifold.noise.stabiliser)
    search = Search(risks, grid, risks.noise, weight, tick)
    best = search.run()
    psnr, error, gain = _decibels(search.tried[best], risks.noise)
    chosen, given = _with_schedule(manifold, parameters, best)
    return chosen, Choice(
        given, psnr=psnr, error=error, gain=gain, candidates=len(search.tried), samples=trial.samples,
        correlated=manifold.noise.is_shared,
        predicted=_predicted(search.tried[best], risks.noise, manifold.noise, patches=parameters.takes_patches),
    )  # fmt: skip


def _predicted(risk: Risk, variance: float, noise: NoiseModel, *, patches: bool) -> Prediction | None:
    """Predict the PSNR of a result; None if the noise is not known well enough.

    Shared noise is never predicted: its correlation may differ from the model, and then most of it remains.
    """
    reading, low, median, high = noise.reading, 1.0, 1.0, 1.0
    if noise.is_shared or not np.isfinite(risk.error) or variance <= 0:
        return None
    if reading is not None:
        if reading.is_doubtful or not noise.overall:
            return None
        low, median, high = (size / noise.overall for size in (reading.low, reading.median, reading.high))
    share = risk.divergence / (2 * variance)
    # Stein's estimate for the least and the largest plausible noise.
    bounds = [risk.value + (2 * share - 1) * (size**2 - 1) * variance for size in (low, high)]
    chance = NormalDist().inv_cdf(0.95) * risk.error
    least = 0.0 if patches else min(bounds) - chance  # patches may have a smaller error
    error = np.clip(share * median**2 * variance, least, max(max(bounds) + chance, least))
    if not error > 0:
        return None
    psnr = -10 * math.log10(error)
    below, above = (
        math.hypot(_PREDICTION_ERROR, 20 * math.log10(ratio)) for ratio in (high / median, median / low)
    )
    before = -10 * math.log10(median**2 * variance)
    found = Prediction(before=before, psnr=psnr, least=psnr - below, most=psnr + above)
    return found if found.is_useful else None


def is_noisy(sigma: Float64s) -> bool:
    """Whether there is noise to choose parameters by."""
    # Noise within the quantisation step of 8 bits is ignored.
    return bool(len(sigma)) and float(np.max(sigma, initial=0.0)) > BYTE_STEP / 2


def _grid(parameters: KernelParameters, search_range: SearchRange, scale: float, by_rule: float) -> Grid:
    """Return the candidates. `scale`: beta at which noise has the length 1, or 0 if no colour enters the metric."""
    free = parameters.free
    most = _MAX_BEFORE_PATCHES if parameters.takes_patches else max(_CONTRASTS)
    betas = tuple(sorted({contrast * scale for contrast in _CONTRASTS if contrast <= most}))
    growths, regularised = search_range.growths, search_range.regularised
    if "beta" not in free:
        betas = (by_rule if parameters.beta is None else parameters.beta,)
    if "beta_growth" not in free or scale == 0:
        growths = (parameters.beta_growth,)
    if parameters.metric_scale == 0:
        regularised = (0,)
    elif "metric_steps" not in free:
        regularised = (parameters.metric_steps,)
    iterations = None if "iterations" in free else parameters.iterations
    if iterations is not None:
        regularised = tuple(sorted({min(count, iterations) for count in regularised}))
    starts = tuple(
        (_nearest(betas, contrast * scale), _nearest(growths, growth), _nearest(regularised, count))
        for contrast, growth, count in search_range.starts
    )
    return Grid(
        betas=betas, growths=growths, t=search_range.t if "t" in free else parameters.t,
        regularised=regularised, iterations=iterations, max_iterations=search_range.max_iterations,
        starts=starts, least_gain=search_range.least_gain,
    )  # fmt: skip


def _nearest(values: tuple[float, ...], wanted: float) -> int:
    return int(np.argmin(np.abs(np.log1p(np.array(values)) - np.log1p(wanted))))


def _in_decibels(relative: float) -> float:
    """Convert a small relative change to dB."""
    return 10 * relative / math.log(10)


def _decibels(risk: Risk, noise: float) -> tuple[float | None, float | None, float | None]:
    if not np.isfinite(risk.error) or noise <= 0:  # a single sample, or all noise was clipped
        return None, None, None
    # An estimate of a small error may be negative; it is reported as its standard error.
    value = max(risk.value, risk.error, 1e-12)
    error = _in_decibels(risk.error / value)
    return -10 * float(np.log10(value)), float(error), 10 * float(np.log10(noise / value))


def choose_by_rule(
    manifold: Manifold, parameters: KernelParameters, rule: Rule
) -> tuple[KernelParameters, Choice]:
    """Set the free parameters by a rule, from the noise of the channels in the metric."""
    metric_sigma, beta = manifold.noise.sigma[manifold.metric_channels], manifold.beta
    if "beta" in parameters.free and len(metric_sigma):
        strength = float(np.sqrt(parameters.strength))
        beta = choose_beta(metric_sigma, rule.contrast) * manifold.unit / strength
    plain = rule.count(overall_noise(metric_sigma)) - rule.regularised
    schedule = Schedule(beta, rule.growth, rule.step, rule.regularised, plain)
    chosen, given = _with_schedule(manifold, parameters, schedule)
    return chosen, Choice(given)


def _with_schedule(
    manifold: Manifold, parameters: KernelParameters, schedule: Schedule
) -> tuple[KernelParameters, dict[str, Any]]:
    """Set the free parameters; return also their values, with beta per unit of the input's colours."""
    values: dict[str, Any] = {
        "iterations": schedule.regularised + schedule.plain,
        "t": schedule.t,
        "beta": schedule.beta,
        "beta_growth": schedule.growth,
        "metric_steps": schedule.regularised,
    }
    chosen: dict[str, Any] = {name: values[name] for name in parameters.free}
    given = chosen | ({"beta": manifold.noise.beta_to_input(chosen["beta"])} if "beta" in chosen else {})
    return dataclasses.replace(parameters, **chosen, free=()), given


def tune(
    manifold: Manifold, parameters: KernelParameters, *, noisy: bool, tick: Callable[[], None] | None = None
) -> tuple[KernelParameters, Choice | None]:
    """Return fully specified parameters and the choice; without noise, no iterations."""
    closed = dataclasses.replace(parameters, free=())
    if not parameters.is_open:
        return closed, None
    unchanged = dataclasses.replace(closed, iterations=0) if "iterations" in parameters.free else closed
    if not noisy:
        return unchanged, None
    if parameters.fast or not manifold.geometry.work(manifold.unit).has_uniform_density:
        return choose_by_rule(manifold, parameters, manifold.rule)
    trial = manifold.trial()
    if not trial.samples:  # all points are isolated
        return unchanged, None
    LOG.info("parameters are tried on %d of %d samples first", trial.samples, manifold.geometry.kernels)
    return choose(trial, manifold, parameters, tick)
