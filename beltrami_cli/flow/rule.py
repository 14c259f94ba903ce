"""Parameters of the kernel by a fixed rule for the noise: that takes no time, and loses more than choosing."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.flow.choice import Choice
from beltrami_cli.flow.noise import choose_beta, overall_noise
from beltrami_cli.flow.parameters import SMOOTHNESS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.flow.parameters import KernelParameters

# Noise at which the numbers of iterations are told, and at which they start to grow with its logarithm.
_SLIGHT = 5 / 255


@dataclass(frozen=True)
class Rule:
    """What to run with where nothing is chosen by the error.

    Attributes
    ----------
    contrast : float
        Beta times the noise.
    growth, step : float
        Growth of beta, and time step.
    guided : int
        Regularised iterations.
    iterations : int
        All iterations, where the noise is 5 of 255 or less: detail of the picture is lost before more noise is.
    more : int
        How many more where the noise is twice as much ...
    most : int
        ... up to so many.
    """

    contrast: float
    growth: float
    step: float
    guided: int
    iterations: int
    more: int
    most: int

    def count(self, noise: float) -> int:
        """Return the number of iterations for noise of a standard deviation, colours in [0, 1]."""
        doublings = max(0.0, float(np.log2(max(noise, _SLIGHT) / _SLIGHT)))
        return min(self.most, self.iterations + round(self.more * doublings))


# What loses least on average over noise of 5, 10, 20 and 40 of 255 on painted, baked and photographed models: ten
# textures, of which flat ones ask for more iterations and rich ones for fewer, and eleven with colours at the vertices.
RULE_ON_GRIDS = Rule(1.4, 3.0, 8.0, 1, 5, 0, 5)
RULE_ON_MESHES = Rule(0.7, 2.0, 1.6, 0, 2, 1, 6)


def choose_by_rule(
    counting: NDArray[np.float64],
    unit: float,
    beta: float,
    parameters: KernelParameters,
    rule: Rule,
) -> tuple[KernelParameters, Choice]:
    """Set what is free by a rule.

    Parameters
    ----------
    counting : ndarray of float64
        Noise of the channels that enter the metric.
    unit : float
        The sample spacing in units of length.
    beta : float
        To be kept if it is not free.
    parameters : KernelParameters
        Those that are not free are kept; strength moves a free beta.
    rule : Rule
        For the kind of sampling.

    Returns
    -------
    parameters : KernelParameters
        With nothing free.
    choice : Choice
    """
    noise = overall_noise(counting)
    if "beta" in parameters.free and len(counting):
        beta = choose_beta(counting, rule.contrast) * unit / float(np.sqrt(SMOOTHNESS[parameters.strength]))
    values: dict[str, Any] = {
        "iterations": rule.count(noise),
        "t": rule.step,
        "beta": beta,
        "beta_growth": rule.growth,
        "metric_steps": rule.guided,
    }
    chosen: dict[str, Any] = {name: values[name] for name in parameters.free}
    return dataclasses.replace(parameters, **chosen, free=()), Choice(chosen)
