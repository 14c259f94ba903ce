"""Beta that is chosen for a level of noise."""

from __future__ import annotations

import math

import numpy as np

from beltrami_cli.arrays import Float64s
from beltrami_cli.quantities import BYTE_STEP


def choose_beta(sigma: Float64s, contrast: float) -> float:
    """Choose beta, in spacings per unit of colour, so that noise has a length of `contrast` spacings."""
    # Standard deviation of rounding to 8 bits; less noise cannot be measured.
    rounding = BYTE_STEP / math.sqrt(12)
    return contrast / max(overall_noise(sigma), rounding)


def overall_noise(sigma: Float64s) -> float:
    """Return the RMS noise of the channels that have any; others may be constant alpha."""
    noisy = sigma[sigma > 0.1 * sigma.max()] if len(sigma) else sigma
    return float(np.sqrt(np.mean(np.square(noisy)))) if len(noisy) else 0.0
