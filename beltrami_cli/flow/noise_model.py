"""What was found of the noise, in numbers that people know."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from beltrami_cli.flow.manifold import Manifold

# Levels of dark, middle and bright colours.
_LEVELS = {"dark": 0.1, "middle": 0.5, "bright": 0.9}

# The quantiles of places that are said to be quiet and loud.
_QUIET, _LOUD = 0.05, 0.95


def describe_noise(manifold: Manifold) -> dict[str, float]:
    """Return standard deviations, the mean of colour channels, full scale 1, and over how many samples they are shared.

    "dark", "middle" and "bright" are those at these levels, "quiet" and "loud" those of such places, where they differ.
    "grain" is the width of the area that samples share noise over: 1 where each has its own.
    """
    model: dict[str, float] = {}
    if not len(manifold.sigma):
        return model
    sigma = float(np.sqrt(np.mean(np.square(manifold.sigma[:3]))))
    if manifold.stabiliser is not None:
        for name, level in _LEVELS.items():
            model[name] = manifold.stabiliser.sigma_at(level, sigma)
    if manifold.differing is not None:
        mean = float(np.sqrt(np.mean(np.square(manifold.noise[:3]))))
        quiet, loud = np.quantile(manifold.differing, (_QUIET, _LOUD))
        model |= {"quiet": mean * float(np.sqrt(quiet)), "loud": mean * float(np.sqrt(loud))}
    return {**model, "grain": manifold.grain}
