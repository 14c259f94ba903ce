"""Parameters of the kernel by a fixed rule for the noise: that takes no time, and loses more than choosing."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.flow.embedding import choose_beta, overall_noise
from beltrami_cli.flow.parameters import SMOOTHNESS
from beltrami_cli.flow.tuning.choice import Choice

if TYPE_CHECKING:
    from beltrami_cli.flow.manifold import Manifold
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
    manifold: Manifold, parameters: KernelParameters, rule: Rule
) -> tuple[KernelParameters, Choice]:
    """Set what is free by a rule for the noise of the channels that enter the metric."""
    counting, beta = manifold.counting, manifold.beta
    if "beta" in parameters.free and len(counting):
        strength = float(np.sqrt(SMOOTHNESS[parameters.strength]))
        beta = choose_beta(counting, rule.contrast) * manifold.unit / strength
    values: dict[str, Any] = {
        "iterations": rule.count(overall_noise(counting)),
        "t": rule.step,
        "beta": beta,
        "beta_growth": rule.growth,
        "metric_steps": rule.guided,
    }
    chosen: dict[str, Any] = {name: values[name] for name in parameters.free}
    return dataclasses.replace(parameters, **chosen, free=()), Choice(chosen)
