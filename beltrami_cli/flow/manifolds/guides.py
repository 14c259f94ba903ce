"""Guides: clean channels that enter the metric besides the colours.

Each guide is scaled by its own beta. It is used unsmoothed in every iteration, so its slopes and noise must not stop
the kernel. The unit of usual steps is their median [1]_, as a multiple of that of white noise. For a guide with flat
regions, whose steps are mostly 0, the standard deviation of the guide is used instead. Beta follows the unit of the
guide, so that depth in metres and in millimetres has the same effect.

References
----------
.. [1] M. Black, G. Sapiro, D. Marimont, D. Heeger, "Robust anisotropic diffusion", IEEE Trans. Image Processing 7(3),
   1998, doi:10.1109/83.661192
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s
from beltrami_cli.flow.manifolds.geometry import Geometry, Stack

# Length, in sample spacings, of a step of one standard deviation of the guide. It is nearly the radius of the kernel at
# the default time step, so that the kernel stops there.
_SPREAD_COUNTS = 6.0

# Maximum length of a usual step in sample spacings, so that noise and slopes of a guide do not stop the kernel.
_USUAL_STEP_LENGTH = 2 / 3


@dataclass(frozen=True)
class Guide:
    """Channels of a guide; `beta`: units of length per unit of the guide, None: by `choose_guide_beta`."""

    name: str
    values: Float32s  # shape (S, G), one row per sample, finite
    beta: float | None = None
    # Values are components in the frame of their chart, as in normal maps, and are not comparable across seams.
    in_chart_frame: bool = False


@dataclass(frozen=True)
class GuideStack:
    """A guide as a stack, with its beta."""

    name: str
    stack: Stack
    beta: float

    @classmethod
    def of(cls, guide: Guide, stack: Stack, geometry: Geometry, unit: float) -> GuideStack:
        """Convert a guide to a stack; without a given beta, choose it from the usual steps."""
        beta = guide.beta
        if beta is None:
            beta = choose_guide_beta(guide.values, geometry.differences(stack)) * unit
        return cls(guide.name, stack, beta)


def choose_guide_beta(values: Float32s, steps: Float32s) -> float:
    """Choose beta so that usual steps, shape (K, G), hardly affect the kernel and unusual ones stop it."""
    if not values.size:
        return 0.0
    channels = values.shape[1]
    spread = float(np.sqrt(np.mean(values.var(axis=0, dtype=np.float64))))
    usual = 0.0
    if len(steps):
        # The median length of a vector of k normal variables is nearly sqrt(k) (1 - 2 / (9 k))^(3 / 2).
        median = np.sqrt(2 * channels * (1 - 2 / (9 * channels)) ** 3)
        usual = float(np.median(np.linalg.norm(steps.astype(np.float64), axis=1)) / median)
    scale = max(usual / _USUAL_STEP_LENGTH, spread / _SPREAD_COUNTS)
    return 1 / scale if scale > 0 else 0.0


def centred(values: Float64s) -> Float32s:
    """Subtract the mean of a guide, shape (S, G), so that rounding to float32 keeps its differences."""
    return np.ascontiguousarray(values - values.mean(axis=0) if len(values) else values, np.float32)
