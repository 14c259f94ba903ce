"""What enters the metric besides positions: colours in their working space and guides, each scaled by its beta.

A guide is meant to be clean and is used as it is, in every iteration. So its slopes, and its noise, must not stop the
kernel. The scale of usual steps is their median [1]_, in units of white noise. It carries no information for a guide of
flat regions, whose steps are mostly 0: there the standard deviation of the guide is used. Beta follows the guide's
unit, so that depth in metres and in millimetres guides equally.

References
----------
.. [1] M. Black, G. Sapiro, D. Marimont, D. Heeger, "Robust anisotropic diffusion", IEEE Trans. Image Processing 7(3),
   1998, doi:10.1109/83.661192
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s
from beltrami_cli.errors import UsageError
from beltrami_cli.fields import BYTE_STEP
from beltrami_cli.flow.parameters import Space
from beltrami_cli.surface.records import Encoding, linear_to_srgb, srgb_to_linear

# Colour distance at which the first kernel should fall off, in units of the noise: beta sigma. A search over vertex
# colours and textures at sigma 20 of 255, with t = 2.4, a growth of 2, two regularised and three plain iterations,
# has its flat optimum here.
_BETA_SIGMA = 0.8

# Length of a step as large as the guide's standard deviation, in sample spacings: nearly the radius of the kernel of
# the default time step, so that it stops there.
_SPREAD_COUNTS = 6.0

# A usual step counts no more than this share of a sample spacing, so that noise and slopes of a guide do not stop it.
_USUAL_COUNTS = 2 / 3
# B. Ottosson, "A perceptual color space for image processing" (2020): linear sRGB -> cone response -> Lab.
_CONES = np.array(
    [
        [0.4122214708, 0.5363325363, 0.0514459929],
        [0.2119034982, 0.6806995451, 0.1073969566],
        [0.0883024619, 0.2817188376, 0.6299787005],
    ]
)
_LAB = np.array(
    [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ]
)


@dataclass(frozen=True)
class Guide:
    """Channels of a guide; `beta`: units of length per unit of the guide, None: by `choose_guide_beta`."""

    name: str
    values: Float32s  # shape (S, G), one row per sample, finite
    beta: float | None = None
    # Values are components in the frame of their chart, as in normal maps, and cannot be compared across seams.
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
    # The deviation of an even distribution over a step; less noise cannot be measured.
    rounding = BYTE_STEP / math.sqrt(12)
    return contrast / max(overall_noise(sigma), rounding)


def overall_noise(sigma: Float64s) -> float:
    """Return the root mean square of the channels' noise, without channels that have none, such as constant alpha."""
    noisy = sigma[sigma > 0.1 * sigma.max()] if len(sigma) else sigma
    return float(np.sqrt(np.mean(np.square(noisy)))) if len(noisy) else 0.0


def to_space(colours: Float32s, encoding: Encoding, space: Space) -> Float32s:
    """Convert stored colours, shape (S, C), full scale 1, to the working space; "data" keeps the numbers."""
    if space in ("data", encoding):
        return colours
    if space == "oklab":
        _require_three(colours)
        linear = srgb_to_linear(colours) if encoding == "srgb" else colours
        return np.asarray(np.cbrt(linear @ _CONES.T) @ _LAB.T, np.float32)
    return np.asarray(srgb_to_linear(colours) if space == "linear" else linear_to_srgb(colours), np.float32)


def from_space(colours: Float32s, encoding: Encoding, space: Space) -> Float32s:
    """Convert working colours, shape (S, C), back to what the file stores; the inverse of `to_space`."""
    if space in ("data", encoding):
        return colours
    if space == "oklab":
        _require_three(colours)
        linear = (colours @ np.linalg.inv(_LAB).T) ** 3 @ np.linalg.inv(_CONES).T
        converted = linear_to_srgb(linear) if encoding == "srgb" else linear
    else:
        converted = linear_to_srgb(colours) if encoding == "srgb" else srgb_to_linear(colours)
    return np.asarray(converted, np.float32)


def _require_three(colours: Float32s) -> None:
    if colours.shape[1] != 3:
        raise UsageError(
            f"the space oklab needs red, green and blue, but there are {colours.shape[1]} channels; "
            "choose --space srgb, linear or data"
        )
