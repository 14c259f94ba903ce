"""What enters the metric besides positions: the colours and guides, each scaled by its beta.

A guide is meant to be clean and is used as it is, in every iteration. So its slopes, and its noise, must not stop the
kernel. The scale of usual steps is their median [1]_, in units of white noise. It carries no information for a guide of
flat regions, whose steps are mostly 0: there the standard deviation of the guide is used. Beta follows the guide's
unit, so that depth in metres and in millimetres guides alike.

References
----------
.. [1] M. Black, G. Sapiro, D. Marimont, D. Heeger, "Robust anisotropic diffusion", IEEE Trans. Image Processing 7(3),
   1998, doi:10.1109/83.661192
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.parameters import SMOOTHNESS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from beltrami_cli.arrays import Float32s, Float64s
    from beltrami_cli.flow.parameters import KernelParameters

# One level of an 8-bit file, spread evenly, has the deviation 1 / (255 sqrt(12)). Noise below that cannot be measured.
_QUANTISATION = 1 / (255 * np.sqrt(12))

# Colour distance at which the first kernel should fall off, in units of the noise: beta sigma. A search over vertex
# colours and textures at sigma 20 of 255, with t = 2.4, a growth of 2, two regularised and three plain iterations,
# has its flat optimum here.
_BETA_SIGMA = 0.8

# Length of a step as large as the guide's standard deviation, in sample spacings: nearly the radius of the kernel of
# the default time step, so that it stops there.
_SPREAD_COUNTS = 6.0

# A usual step counts no more than this share of a sample spacing, so that noise and slopes of a guide do not stop it.
_USUAL_COUNTS = 2 / 3


@dataclass(frozen=True)
class Guide:
    """Channels of a guide; `beta`: units of length per unit of the guide, None: by `choose_guide_beta`."""

    name: str
    values: Float32s  # shape (S, G), one row per sample, finite
    beta: float | None = None
    # Values are components in the frame of their chart, as those of normal maps, and cannot be compared across seams.
    in_chart_frame: bool = False


def centred(values: Float64s) -> Float32s:
    """Subtract the mean of a guide, shape (S, G), before rounding: only differences count."""
    return np.ascontiguousarray(values - values.mean(axis=0) if len(values) else values, np.float32)


def choose_guide_beta(values: Float32s, steps: Float32s) -> float:
    """Choose beta so that usual steps, shape (K, G), hardly hinder the kernel and unusual ones stop it."""
    if not values.size:
        return 0.0
    channels = values.shape[1]
    spread = float(np.sqrt(np.mean(values.var(axis=0, dtype=np.float64))))
    usual = 0.0
    if len(steps):
        # The length of a vector of k normal numbers has the median sqrt(k) (1 - 2 / (9 k))^(3 / 2), nearly.
        median = np.sqrt(2 * channels * (1 - 2 / (9 * channels)) ** 3)
        usual = float(np.median(np.linalg.norm(steps.astype(np.float64), axis=1)) / median)
    scale = max(usual / _USUAL_COUNTS, spread / _SPREAD_COUNTS)
    return 1 / scale if scale > 0 else 0.0


def join_channels(parts: Sequence[tuple[Float32s, float]], axis: int) -> tuple[Float32s, float]:
    """Concatenate channels of different beta, colours first, as channels of one beta; it is 0 if none has any."""
    weighted = [(values, beta) for values, beta in parts if beta > 0 and values.shape[axis] > 0]
    if len(weighted) < 2:
        return weighted[0] if weighted else (parts[0][0], 0.0)
    largest = max(beta for _, beta in weighted)
    # The first part keeps its bits, unless the others would leave the range of float32.
    common = weighted[0][1] if weighted[0][1] > 1e-9 * largest else largest
    scaled = [values if beta == common else values * np.float32(beta / common) for values, beta in weighted]
    return np.concatenate(scaled, axis=axis), common


def choose_beta(sigma: Float64s, contrast: float = _BETA_SIGMA) -> float:
    """Choose beta, in spacings per unit of colour, so that noise has a length of `contrast` spacings."""
    return contrast / max(overall_noise(sigma), float(_QUANTISATION))


def overall_noise(sigma: Float64s) -> float:
    """Return the root mean square of the channels' noise, without channels that have none, such as constant alpha."""
    noisy = sigma[sigma > 0.1 * sigma.max()] if len(sigma) else sigma
    return float(np.sqrt(np.mean(np.square(noisy)))) if len(noisy) else 0.0


def beta_of(parameters: KernelParameters, sigma: Float64s, unit: float) -> float:
    """Return the given beta, or else the one that `choose_beta` gives, in units of length per unit of colour."""
    if parameters.beta is not None:
        return parameters.beta
    return choose_beta(sigma) * unit / float(np.sqrt(SMOOTHNESS[parameters.strength]))
