"""An estimate of the error of smoothed colours that does not need the noise-free colours.

Stein's unbiased risk estimate: for y = x + noise of variance sigma^2, and any smooth map f,

    E |f(y) - x|^2 = E |f(y) - y|^2 - sigma^2 + 2 sigma^2 div f(y)        (mean over samples)

and the divergence is the response to a small random perturbation, div f(y) = E b . (f(y + eps b) - f(y)) / eps with
independent signs b [1]_. Where samples and channels share noise, of covariance C, sigma^2 div f is the trace of C times
the derivative of f, which is the same mean with perturbations b of covariance C.

References
----------
.. [1] S. Ramani, T. Blu, M. Unser, "Monte-Carlo SURE: a black-box optimization of regularization parameters for general
   denoising algorithms", IEEE Trans. Image Processing 17(9), 2008, eqs. (4) and (13).
   https://doi.org/10.1109/TIP.2008.2001404
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s
from beltrami_cli.flow.corrections.normal_tables import variance_of_clipped
from beltrami_cli.flow.manifolds.iteration import Step
from beltrami_cli.flow.manifolds.manifold import SampleTrial
from beltrami_cli.flow.noise.stabiliser import VarianceStabiliser
from beltrami_cli.surface.colour_values import limits_of

# Size of the perturbation in units of the noise, far above the rounding of float32. Distances on meshes have kinks
# where their paths change: the derivative of a smaller perturbation varies from sample to sample, and a larger one
# changes the kernels. On hand-painted and photographed samples, half or twice this size chooses worse.
KERNEL_PERTURBATION = 0.3

# Time steps of the Gaussian on the surface that averages the share of samples at a limit.
_MARK_TIMES = (2.4, 2.4)

# Number of parts of the sample. The differences of their estimates give the standard error of the mean.
_PARTS = 16


@dataclass(frozen=True)
class Risk:
    """Estimate of a mean square error over samples and channels."""

    value: float  # in squared units of colour; estimates of small errors may be below 0
    error: float  # standard error of `value`, from the differences between parts of the sample
    divergence: float  # contribution of the divergence to `value`

    def weighted(self, weight: float) -> float:
        """Return `value` with another weight of the divergence; larger ones prefer smoother results."""
        return self.value + (weight - 1) * self.divergence


@dataclass(frozen=True)
class State:
    """Colours after some iterations, and the perturbed colours for each stack of signs."""

    plain: Float32s
    perturbed: tuple[Float32s, ...]


@dataclass(frozen=True, eq=False)
class RiskEstimate:
    """Monte Carlo SURE on a sample of a manifold."""

    trial: SampleTrial
    noisy: Float32s  # the scored colours, shape (S, N)
    variance: Float64s  # of the noise
    to_input: Float32s | float  # factors that convert squared errors to the unit of the input
    weights: tuple[Float64s, ...]  # from the response to each stack of signs to the divergence
    size: np.float32  # of the perturbation

    @classmethod
    def on(
        cls, trial: SampleTrial, sigma: Float64s, stabiliser: VarianceStabiliser | None = None
    ) -> RiskEstimate:
        """Prepare the estimate for noise of standard deviation `sigma` by channel, shape (N,)."""
        noisy, size = trial.scored(trial.start), KERNEL_PERTURBATION * float(np.sqrt(np.square(sigma).mean()))
        variance = np.square(sigma) * _unclipped_variance(trial, noisy) * trial.relative_variance
        to_input = 1.0 if stabiliser is None else np.square(stabiliser.slopes(noisy.T)).T
        signs = [trial.scored(drawn) for drawn in trial.signs]
        # Weights are 1 for signs. Correlated perturbations have the size of the noise in each channel, and need no
        # weights.
        power = np.mean([np.mean(np.square(drawn), axis=0) for drawn in signs], axis=0)
        weight = 2 * variance * to_input / np.maximum(power, np.finfo(float).tiny)
        weights = tuple(weight / (len(signs) * size) * drawn for drawn in signs)
        return cls(trial, noisy, variance, to_input, weights, np.float32(size))

    @property
    def mean_variance(self) -> float:
        """Mean variance of the noise, in squared units of the input's colours."""
        return float(np.mean(np.broadcast_to(self.variance, self.noisy.shape) * self.to_input))

    @property
    def start(self) -> State:
        start = self.trial.start
        return State(start, tuple(start + self.size * signs for signs in self.trial.signs))

    def step(self, state: State, step: Step) -> State:
        perturbed = tuple(self.trial.step(colours, step) for colours in state.perturbed)
        return State(self.trial.step(state.plain, step), perturbed)

    def risk(self, state: State) -> Risk:
        smoothed = self.trial.scored(state.plain).astype(np.float64)
        divergence = np.zeros_like(smoothed)
        for weights, colours in zip(self.weights, state.perturbed, strict=True):
            divergence += weights * (self.trial.scored(colours) - smoothed)
        misfit = (np.square(smoothed - self.noisy) - self.variance) * self.to_input
        # `mean` along so short an axis takes three times as long.
        each = np.einsum("sn->s", misfit + divergence) / misfit.shape[1]
        parts = np.array([part.mean() for part in np.array_split(each, _PARTS) if len(part)])
        error = float(parts.std(ddof=1) / np.sqrt(len(parts))) if len(parts) > 1 else float("inf")
        return Risk(float(each.mean()), error, float(divergence.mean()))


def _unclipped_variance(trial: SampleTrial, noisy: Float32s) -> Float64s | float:
    """Return the share of the noise variance that was not clipped at 0 and full scale, by sample."""
    # The limits are relative to x plus the mean of clipped noise, to which averages tend until they are restored.
    remaining: Float64s | float = 1.0
    low, high = limits_of(noisy)
    for beyond, is_reached in (
        (trial.start <= low, (noisy == low).any()),
        (trial.start >= high, (noisy == high).any()),
    ):
        if is_reached:
            marks = beyond.astype(np.float32)
            for t in _MARK_TIMES:
                marks = trial.step(marks, Step(0.0, t, regularised=False))
            remaining = remaining * variance_of_clipped(trial.scored(marks).astype(np.float64))
    return remaining
