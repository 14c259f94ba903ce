"""Choice of the kernel's parameters by the estimated error of the result."""

from __future__ import annotations

import dataclasses
import logging
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from beltrami_cli.arrays import Float64s
from beltrami_cli.flow.choice.prediction import Prediction, predict
from beltrami_cli.flow.choice.risk import Risk, RiskEstimate
from beltrami_cli.flow.choice.search import Candidates, Place, Schedule, Search
from beltrami_cli.flow.manifolds.beta import overall_noise
from beltrami_cli.flow.manifolds.manifold import Manifold, SampleTrial
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.quantities import BYTE_STEP

# Candidate values of beta times the noise.
_CONTRASTS = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0)

# The largest candidate if patches follow: with larger ones, noise that is kept as edges decides which patches are
# similar.
_MAX_BEFORE_PATCHES = 2.0

# Weight of smoothness for noise that neighbours share. Low quantiles underestimate such noise, and kernels keep its
# coarse steps as if they were edges. Enlarged images gain 0.9 dB by this weight, and JPEG images 0.5 dB.
_SHARED_NOISE_WEIGHT = 1.5

_LOG = logging.getLogger(__name__)


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


def tune(
    manifold: Manifold, *, noisy: bool, tick: Callable[[], None] | None = None
) -> tuple[KernelParameters, Choice | None]:
    """Choose the free parameters of a manifold; without noise, no iterations. The choice is None if there is none."""
    parameters = manifold.parameters
    closed = dataclasses.replace(parameters, free=())
    if not parameters.chooses_from_data:
        return closed, None
    unchanged = dataclasses.replace(closed, iterations=0) if "iterations" in parameters.free else closed
    if not noisy:
        return unchanged, None
    if parameters.fast or not manifold.geometry.work(manifold.unit).has_uniform_density:
        return _choose_by_rule(manifold)
    trial = manifold.trial()
    if not trial.samples:  # all points are isolated
        return unchanged, None
    _LOG.info("parameters are tried on %d of %d samples first", trial.samples, manifold.geometry.kernels)
    return _choose_by_risk(manifold, trial, tick)


def _choose_by_rule(manifold: Manifold) -> tuple[KernelParameters, Choice]:
    """Set the free parameters by a rule, from the noise of the channels in the metric."""
    rule, parameters, beta = manifold.rule, manifold.parameters, manifold.beta
    if "beta" in parameters.free:
        beta = manifold.beta_at(rule.contrast) / math.sqrt(parameters.strength)
    plain = rule.count(overall_noise(manifold.metric_sigma)) - rule.regularised
    chosen, values = _with_schedule(manifold, Schedule(beta, rule.growth, rule.t, rule.regularised, plain))
    return chosen, Choice(values)


def _choose_by_risk(
    manifold: Manifold, trial: SampleTrial, tick: Callable[[], None] | None
) -> tuple[KernelParameters, Choice]:
    """Choose the free parameters with the least estimated error on a sample of the manifold."""
    noise, parameters = manifold.noise, manifold.parameters
    weight = (_SHARED_NOISE_WEIGHT if noise.is_shared else 1.0) * parameters.strength
    risks = RiskEstimate.on(trial, noise.sigma, noise.stabiliser)
    search = Search(risks, _candidates(manifold), weight, tick)
    best = search.run()
    psnr, error, gain = _decibels(search.tried[best], risks.mean_variance)
    chosen, values = _with_schedule(manifold, best)
    return chosen, Choice(
        values, psnr=psnr, error=error, gain=gain, candidates=len(search.tried), samples=trial.samples,
        correlated=noise.is_shared,
        predicted=predict(search.tried[best], risks.mean_variance, noise, patches=parameters.takes_patches),
    )  # fmt: skip


def is_noisy(sigma: Float64s) -> bool:
    """Whether there is noise to choose parameters by."""
    # Noise within the quantisation step of 8 bits is ignored.
    return bool(len(sigma)) and float(np.max(sigma, initial=0.0)) > BYTE_STEP / 2


def _candidates(manifold: Manifold) -> Candidates:
    """Return the values to try: the search range of a free parameter, the one value of a given parameter."""
    parameters, tried, free = manifold.parameters, manifold.search_range, manifold.parameters.free
    scale = manifold.beta_at(1.0)
    most = _MAX_BEFORE_PATCHES if parameters.takes_patches else max(_CONTRASTS)
    betas = tuple(sorted({contrast * scale for contrast in _CONTRASTS if contrast <= most}))
    growths, regularised = tried.growths, tried.regularised
    if "beta" not in free:
        betas = (manifold.beta if parameters.beta is None else parameters.beta,)
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
        Place(_nearest(betas, contrast * scale), _nearest(growths, growth), _nearest(regularised, count))
        for contrast, growth, count in tried.starts
    )
    return Candidates(
        betas=betas, growths=growths, t=tried.t if "t" in free else parameters.t,
        regularised=regularised, iterations=iterations, max_iterations=tried.max_iterations,
        starts=starts, least_gain=tried.least_gain,
    )  # fmt: skip


def _nearest(values: tuple[float, ...], wanted: float) -> int:
    return int(np.argmin(np.abs(np.log1p(np.array(values)) - np.log1p(wanted))))


def _in_decibels(relative: float) -> float:
    """Convert a small relative change to dB."""
    return 10 * relative / math.log(10)


def _decibels(risk: Risk, variance: float) -> tuple[float | None, float | None, float | None]:
    """Return the PSNR, its standard error, and the gain over noise of a variance; None where they are unknown."""
    if not np.isfinite(risk.error) or variance <= 0:  # a single sample, or all noise was clipped
        return None, None, None
    # An estimate of a small error may be negative; it is reported as its standard error.
    value = max(risk.value, risk.error, 1e-12)
    error = _in_decibels(risk.error / value)
    return -10 * float(np.log10(value)), float(error), 10 * float(np.log10(variance / value))


def _with_schedule(manifold: Manifold, schedule: Schedule) -> tuple[KernelParameters, dict[str, Any]]:
    """Set the free parameters; return also their values, with beta per unit of the input's colours."""
    values: dict[str, Any] = {
        "iterations": schedule.regularised + schedule.plain,
        "t": schedule.t,
        "beta": schedule.beta,
        "beta_growth": schedule.growth,
        "metric_steps": schedule.regularised,
    }
    chosen: dict[str, Any] = {name: values[name] for name in manifold.parameters.free}
    parameters = dataclasses.replace(manifold.parameters, **chosen, free=())
    if "beta" in chosen:
        chosen["beta"] = manifold.noise.beta_to_input(chosen["beta"])
    return parameters, chosen
