"""What enters the metric beside positions, the colours and guides, and beta, by which each counts as distance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.parameters import SMOOTHNESS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from beltrami_cli.flow.parameters import KernelParameters

# One level of an 8-bit file, spread evenly, has the deviation 1 / (255 sqrt(12)). Below that no noise can be told.
_QUANTISATION = 1 / (255 * np.sqrt(12))

# Colour distance at which the first kernel should fall off, in units of the noise: beta sigma. A search over vertex
# colours and textures at sigma 20 of 255, with t = 2.4, a growth of 2, two regularised and three plain iterations,
# has its flat optimum here.
_BETA_SIGMA = 0.8

# A step as large as the guide's standard deviation counts so many sample spacings: nearly the reach of the kernel of
# the default time step, so that it stops there.
_SPREAD_COUNTS = 6.0

# A usual step counts no more than this share of a sample spacing, so that noise and slopes of a guide do not stop it.
_USUAL_COUNTS = 2 / 3


@dataclass(frozen=True)
class Guide:
    """Channels of a guide.

    Attributes
    ----------
    name : str
        What the user calls it.
    values : ndarray of float32, shape (S, G)
        One row a sample, finite.
    beta : float or None
        Units of length per unit of the guide, >= 0. None: from the guide, see `choose_guide_beta`.
    in_chart_frame : bool
        Whether values are components in the frame of their chart, as those of normal maps, so that values on the two
        sides of a seam of textures cannot be compared where the frames differ.
    """

    name: str
    values: NDArray[np.float32]
    beta: float | None = None
    in_chart_frame: bool = False


def centred(values: NDArray[np.float64]) -> NDArray[np.float32]:
    """Round the values of a guide, shape (S, G), near 0: only differences count, and large numbers lose theirs."""
    return np.ascontiguousarray(values - values.mean(axis=0) if len(values) else values, np.float32)


def choose_guide_beta(values: NDArray[np.float32], steps: NDArray[np.float32]) -> float:
    """Choose how much a guide counts so that usual steps hardly hinder the kernel and unusual ones stop it.

    Parameters
    ----------
    values : ndarray of float32, shape (S, G)
        The guide.
    steps : ndarray of float32, shape (K, G)
        Differences between neighbouring samples.

    Returns
    -------
    float
        Sample spacings per unit of the guide; it follows the guide's unit, so that depth in metres and in millimetres
        guides alike. 0 for a constant guide.

    Notes
    -----
    A guide is meant to be clean and is taken as it is, at every iteration. So its slopes, and its noise, must not
    stop the kernel. The scale of usual steps is their median [1]_, in units of white noise. It says nothing of a guide
    of flat regions, whose steps are mostly 0: there the standard deviation of the guide does.

    References
    ----------
    .. [1] M. Black, G. Sapiro, D. Marimont, D. Heeger, "Robust anisotropic diffusion", IEEE Trans. Image Processing
       7(3), 1998, doi:10.1109/83.661192
    """
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


def join_channels(
    parts: Sequence[tuple[NDArray[np.float32], float]], axis: int
) -> tuple[NDArray[np.float32], float]:
    """Put channels that count differently side by side as channels of one beta.

    Parameters
    ----------
    parts : sequence of (ndarray of float32, float)
        Channels and their beta, the colours first.
    axis : int
        The axis of the channels.

    Returns
    -------
    channels : ndarray of float32
        All channels that count; those of the first part as they are, if its beta allows it.
    beta : float
        Theirs; 0 if none counts.
    """
    counting = [(values, beta) for values, beta in parts if beta > 0 and values.shape[axis] > 0]
    if len(counting) < 2:
        return counting[0] if counting else (parts[0][0], 0.0)
    largest = max(beta for _, beta in counting)
    # The first part keeps its bits, unless the others would leave the range of float32.
    common = counting[0][1] if counting[0][1] > 1e-9 * largest else largest
    scaled = [values if beta == common else values * np.float32(beta / common) for values, beta in counting]
    return np.concatenate(scaled, axis=axis), common


def choose_beta(sigma: NDArray[np.float64], contrast: float = _BETA_SIGMA) -> float:
    """Choose beta, in sample spacings per unit of colour, so that noise counts `contrast` sample spacings."""
    return contrast / max(overall_noise(sigma), float(_QUANTISATION))


def overall_noise(sigma: NDArray[np.float64]) -> float:
    """Return the root mean square of the noise of channels, without those that have none, such as constant alpha."""
    noisy = sigma[sigma > 0.1 * sigma.max()] if len(sigma) else sigma
    return float(np.sqrt(np.mean(np.square(noisy)))) if len(noisy) else 0.0


def beta_of(parameters: KernelParameters, sigma: NDArray[np.float64], unit: float) -> float:
    """Return the given beta, or else the one that `choose_beta` gives, in units of length per unit of colour."""
    if parameters.beta is not None:
        return parameters.beta
    return choose_beta(sigma) * unit / float(np.sqrt(SMOOTHNESS[parameters.strength]))
