"""Parameters of the kernel that are chosen from the data, so that the estimated error is least."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.flow.parameters import SMOOTHNESS
from beltrami_cli.flow.risk import Risk, RiskEstimate
from beltrami_cli.flow.schedule import Grid, Search

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from beltrami_cli.flow.parameters import KernelParameters
    from beltrami_cli.flow.risk import Trial

# Values that are tried of beta times the noise.
_CONTRASTS = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0)

# Noise that cannot be told from the steps of an 8-bit file is none.
_LEAST_NOISE = 0.5 / 255


@dataclass(frozen=True)
class Reach:
    """What to try on a kind of sampling, and where the search starts.

    Attributes
    ----------
    steps : tuple of float
        Time steps.
    growths : tuple of float
        Values of the growth of beta.
    guided : tuple of int
        Numbers of regularised iterations.
    most : int
        Iterations in one schedule.
    starts : tuple of (float, float, float, int)
        Where to start: beta times the noise, its growth, the time step, and the number of regularised iterations.
    least_gain : float
        Of an iteration after which others follow, as a share of the error; see `Grid`.
    """

    steps: tuple[float, ...]
    growths: tuple[float, ...]
    guided: tuple[int, ...]
    most: int
    starts: tuple[tuple[float, float, float, int], ...]
    least_gain: float = 0.0


# On painted, baked and photographed samples with noise of 5 to 40 of 255, other time steps and growths are hardly
# better when tuned on the truth, and worse when they are chosen: more to choose from is more to choose wrong.
# On a grid the window bounds the kernel, and a large time step only makes its weights more even.
ON_GRIDS = Reach((8.0,), (1.5, 3.0), (0, 1, 2, 3), 10, ((1.4, 1.5, 8.0, 1), (1.4, 3.0, 8.0, 2)))
# On a mesh the time step alone bounds the kernel, and larger ones take longer than they gain.
# The regularised metric takes sharp borders away, and from there a descent ends where noise is left. Iterations that
# gain less than a fiftieth lead nowhere, while on grids many small gains add up.
ON_MESHES = Reach((2.4,), (1.3, 2.0), (0, 1, 2), 8, ((1.0, 2.0, 2.4, 1), (1.4, 1.3, 2.4, 0)), least_gain=0.02)


@dataclass(frozen=True)
class Choice:
    """What was chosen, and by what estimate.

    Attributes
    ----------
    chosen : dict of str to float
        The parameters that were free, with their values.
    psnr : float or None
        Estimated PSNR of the result, against the colours without noise; before averages of clipped noise are restored.
        None: a fixed rule chose.
    error : float or None
        Its standard error in dB, if the estimate of the noise is right.
    gain : float or None
        How far that is above the estimated PSNR of the input.
    candidates : int
        Schedules that were compared.
    samples : int
        Samples of the surface that they were compared on.
    correlated : bool
        Whether neighbouring samples have noise in common, which was allowed for.
    """

    chosen: dict[str, float]
    psnr: float | None = None
    error: float | None = None
    gain: float | None = None
    candidates: int = 0
    samples: int = 0
    correlated: bool = False


def choose(
    trial: Trial,
    samples: int,
    sigma: NDArray[np.float64],
    counting: NDArray[np.float64],
    unit: float,
    beta: float,
    parameters: KernelParameters,
    reach: Reach,
    pause: Callable[[], None] | None = None,
    smoothness: float = 1.0,
) -> tuple[KernelParameters, Choice]:
    """Choose the free parameters by the least estimated error.

    Parameters
    ----------
    trial : Trial
        A sample of the surface.
    samples : int
        How many samples count there.
    sigma : ndarray of float64, shape (N,)
        Noise of all channels.
    counting : ndarray of float64
        Noise of those that enter the metric.
    unit : float
        The sample spacing in units of length.
    beta : float
        By rule, to be kept if it is not free.
    parameters : KernelParameters
        Those that are not free are kept.
    reach : Reach
        What to try.
    pause : callable, optional
        Called before every iteration that is tried; may raise to stop.
    smoothness : float
        By what factor smoothness counts, besides the strength asked for.

    Returns
    -------
    parameters : KernelParameters
        With nothing free.
    choice : Choice
    """
    from beltrami_cli.flow.noise import choose_beta

    noise = float(np.mean(np.square(sigma)))
    scale = choose_beta(counting, 1.0) * unit if len(counting) else 0.0
    grid = _grid(parameters, reach, scale, beta)
    estimate = RiskEstimate(trial, sigma)
    search = Search(estimate, grid, noise, smoothness * SMOOTHNESS[parameters.strength], pause)
    best = search.run()
    risk = search.tried[best]
    values: dict[str, Any] = {
        "iterations": best.guided + best.plain,
        "t": best.t,
        "beta": best.beta,
        "beta_growth": best.growth,
        "metric_steps": best.guided,
    }
    chosen: dict[str, Any] = {name: values[name] for name in parameters.free}
    choice = Choice(chosen, *_decibels(risk, noise), len(search.tried), samples)
    return dataclasses.replace(parameters, **chosen, free=()), choice


def is_noisy(sigma: NDArray[np.float64]) -> bool:
    """Tell whether there is noise to choose by."""
    return bool(len(sigma)) and float(np.max(sigma, initial=0.0)) > _LEAST_NOISE


def _grid(parameters: KernelParameters, reach: Reach, scale: float, by_rule: float) -> Grid:
    """Return what may be chosen; `scale` is the beta by which noise has the length 1, and 0 if no colour counts."""
    free = parameters.free
    betas = tuple(sorted({contrast * scale for contrast in _CONTRASTS}))
    growths = reach.growths
    steps = reach.steps
    guided = reach.guided
    if "beta" not in free:
        betas = (by_rule if parameters.beta is None else parameters.beta,)
    if "beta_growth" not in free or scale == 0:
        growths = (parameters.beta_growth,)
    if "t" not in free:
        steps = (parameters.t,)
    if parameters.metric_scale == 0:
        guided = (0,)
    elif "metric_steps" not in free:
        guided = (parameters.metric_steps,)
    iterations = None if "iterations" in free else parameters.iterations
    if iterations is not None:
        guided = tuple(sorted({min(count, iterations) for count in guided}))
    starts = tuple(
        (
            _nearest(betas, contrast * scale),
            _nearest(growths, growth),
            _nearest(steps, step),
            _nearest(guided, count),
        )
        for contrast, growth, step, count in reach.starts
    )
    return Grid(betas, growths, steps, guided, iterations, reach.most, starts, reach.least_gain)


def _nearest(values: tuple[float, ...], wanted: float) -> int:
    return int(np.argmin(np.abs(np.log1p(np.array(values)) - np.log1p(wanted))))


def _decibels(risk: Risk, noise: float) -> tuple[float, float, float]:
    # An estimate of a small error may be negative; it is told as the least that can be told from 0.
    value = max(risk.value, risk.error if np.isfinite(risk.error) else 0.0, 1e-12)
    in_decibels = 10 / np.log(10)
    error = in_decibels * risk.error / value
    return -10 * float(np.log10(value)), float(error), 10 * float(np.log10(noise / value))
