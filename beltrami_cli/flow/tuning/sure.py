"""How far smoothed colours are from the colours without noise, told without knowing these.

Stein's unbiased risk estimate: for y = x + noise of variance sigma^2, and any smooth map f,

    E |f(y) - x|^2 = E |f(y) - y|^2 - sigma^2 + 2 sigma^2 div f(y)        (mean over samples)

and the divergence is the answer to a small random perturbation, div f(y) = E b . (f(y + eps b) - f(y)) / eps with
independent signs b [1]_. Where samples and channels have noise in common, of covariance C, sigma^2 div f is the trace
of C times the derivative of f, and that is the same mean with perturbations b of covariance C.

References
----------
.. [1] S. Ramani, T. Blu, M. Unser, "Monte-Carlo SURE: a black-box optimization of regularization parameters for general
   denoising algorithms", IEEE Trans. Image Processing 17(9), 2008, eqs. (4) and (13).
   https://doi.org/10.1109/TIP.2008.2001404
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from beltrami_cli.flow.clipping import variance_of_clipped
from beltrami_cli.flow.manifold import Step

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.flow.manifold import Manifold

# The perturbation, in units of the noise: far above the rounding of float32. Distances on meshes bend where their paths
# change, so a smaller one meets a derivative that changes from sample to sample, and a larger one changes the kernels:
# on painted and photographed samples, half or twice as much chooses worse.
PERTURBATION = 0.3

# Of few samples the divergence is uncertain by one perturbation: so many samples, or so many perturbations, are enough.
_ENOUGH_SAMPLES, _MOST_PROBES = 5_000, 4

# Less power than a channel that has any noise gives its perturbation.
_LEAST_POWER = 1e-12

# The share of samples at a limit is averaged by a Gaussian on the surface: so many iterations of such a time step.
_MARK_STEPS, _MARK_TIME = 2, 2.4

# Parts of the sample whose estimates are compared, to tell how sure their mean is.
_PARTS = 16


class Trial(Protocol):
    """A sample of a surface on which iterations can be tried.

    States are arrays of any layout, which only the trial knows.
    """

    @property
    def start(self) -> NDArray[np.float32]:
        """The noisy colours."""

    @property
    def signs(self) -> NDArray[np.float32]:
        """States of perturbations, one after the other; equal where two entries are one sample.

        Independent signs, 1 or -1; or, where noise is not independent, what is like it and has a mean square of 1.
        """

    def step(self, state: NDArray[np.float32], step: Step) -> NDArray[np.float32]:
        """Return the state after an iteration."""

    def scored(self, state: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the colours, shape (S, N), of those samples that are as they would be on the whole surface."""


@dataclass(frozen=True)
class Risk:
    """An estimate of a mean square error.

    Attributes
    ----------
    value : float
        Mean over samples and channels, in squared units of colour. Estimates of small errors may be below 0.
    error : float
        Standard error of `value`, from how parts of the sample differ.
    divergence : float
        The part of `value` that the divergence makes.
    """

    value: float
    error: float
    divergence: float

    def weighted(self, weight: float) -> float:
        """Return `value`, but with the divergence counting more, which asks for smoother results, or less."""
        return self.value + (weight - 1) * self.divergence


@dataclass(frozen=True)
class State:
    """Colours after some iterations, and what the perturbed ones became, for each state of signs."""

    plain: NDArray[np.float32]
    perturbed: tuple[NDArray[np.float32], ...]


def wanted_probes(samples: int) -> int:
    """Return by how many states of signs the divergence on so many samples should be told."""
    return min(_MOST_PROBES, -(-_ENOUGH_SAMPLES // max(1, samples)))


class RiskEstimate:
    """Monte Carlo SURE on a trial.

    Parameters
    ----------
    trial : Trial
        Where to estimate it.
    sigma : ndarray of float64, shape (N,)
        Standard deviation of the noise of each channel.
    """

    def __init__(self, trial: Trial, sigma: NDArray[np.float64]) -> None:
        self._trial = trial
        self._epsilon = PERTURBATION * float(np.sqrt(np.square(sigma).mean()))
        self._noisy = trial.scored(trial.start)
        self._variance = np.square(sigma) * self._left_by_clipping()
        self._signs = [trial.scored(signs) for signs in trial.signs]
        # Of signs 1; perturbations like the noise have its size, channel by channel, and so need no weights.
        power = np.mean([np.mean(np.square(signs), axis=0) for signs in self._signs], axis=0)
        self._answering = self._variance / np.maximum(power, _LEAST_POWER)

    @property
    def start(self) -> State:
        """The state before any iteration."""
        start = self._trial.start
        return State(start, tuple(start + np.float32(self._epsilon) * signs for signs in self._trial.signs))

    def _left_by_clipping(self) -> NDArray[np.float64] | float:
        """Tell which part of the noise's variance was not cut off at 0 and at full scale, sample by sample.

        There y is what the estimate takes for y: not x plus noise, but what the mean of clipped noise adds to x. That
        is what averages tend to, until they are restored.
        """
        start = self._trial.start
        left: NDArray[np.float64] | float = 1.0
        limits = (
            (start <= 0, self._noisy.min(initial=1) == 0),
            (start >= 1, self._noisy.max(initial=0) == 1),
        )
        for beyond, is_limit in limits:
            if is_limit:
                marks = beyond.astype(np.float32)
                for _ in range(_MARK_STEPS):
                    marks = self._trial.step(marks, Step(0.0, _MARK_TIME, regularised=False))
                left = left * variance_of_clipped(self._trial.scored(marks).astype(np.float64))
        return left

    def step(self, state: State, step: Step) -> State:
        """Return the state after an iteration."""
        perturbed = tuple(self._trial.step(colours, step) for colours in state.perturbed)
        return State(self._trial.step(state.plain, step), perturbed)

    def of(self, state: State) -> Risk:
        """Estimate the error of a state."""
        smoothed = self._trial.scored(state.plain).astype(np.float64)
        answer = np.zeros_like(smoothed)
        for signs, colours in zip(self._signs, state.perturbed, strict=True):
            answer += signs * (self._trial.scored(colours) - smoothed)
        answer /= len(self._signs) * self._epsilon
        misfit = np.square(smoothed - self._noisy) - self._variance
        divergence = 2 * self._answering * answer
        each = (misfit + divergence).mean(axis=1)
        parts = np.array([part.mean() for part in np.array_split(each, _PARTS) if len(part)])
        error = float(parts.std(ddof=1) / np.sqrt(len(parts))) if len(parts) > 1 else float("inf")
        return Risk(float(each.mean()), error, float(divergence.mean()))


@dataclass(frozen=True)
class SampleTrial:
    """A `Trial` on a part of a manifold.

    `start` is the stack of its noisy colours, and `signs` are stacks like it. Samples in `scored` count; None: all.
    `correlated`: neighbours have noise in common, and so have the perturbations.
    """

    part: Manifold
    start: NDArray[np.float32]
    signs: NDArray[np.float32]
    scored_samples: NDArray[np.int64] | None
    correlated: bool = False

    @property
    def samples(self) -> int:
        """How many samples count."""
        return len(self.scored(self.start))

    def step(self, state: NDArray[np.float32], step: Step) -> NDArray[np.float32]:
        """Return the colours after an iteration."""
        self.part.measure(state, step)
        return self.part.average([state]).stacks[0]

    def scored(self, state: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the colours of the samples that count, shape (S, N)."""
        return state if self.scored_samples is None else self.part.take(state, self.scored_samples)
