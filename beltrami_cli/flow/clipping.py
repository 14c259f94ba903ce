"""Averages of colours whose noise was cut off at 0 and at full scale.

Where a surface is white, noise can only darken it: what would be brighter than full scale is stored as full scale. An
average over such samples is too dark, by up to 0.4 standard deviations of the noise, however many samples it has. But
the share of the samples that stand at the limit tells how close the true colour is to it: samples are a normal
variable censored at the limit, of which mean and share are known.

References
----------
.. [1] J. Tobin, "Estimation of relationships for limited dependent variables", Econometrica 26 (1958): the mean of a
   censored normal variable. https://doi.org/10.2307/1907382
.. [2] A. Foi, "Clipped noisy images: heteroskedastic modeling and practical denoising", Signal Processing 89 (2009):
   denoised images need this correction. https://doi.org/10.1016/j.sigpro.2009.04.035
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.surface import large_arrays

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Fewer samples at a limit, as a share of all, change no mean that is worth a plane of memory.
_WORTH_RESTORING = 1e-3

# Local noise is believed up to so many times the estimated one, which is too low where many samples are cut off.
_TRUSTED = 1.2

# Entries of the tables over the share of samples at a limit, up to one half.
_TABLE = 1024


@dataclass(frozen=True)
class ClippedChannels:
    """Which channels of noisy colours were cut off at a limit, and what turns their averages back.

    Attributes
    ----------
    low, high : tuple of bool
        For each of N channels, whether samples were cut off at 0, and at 1.
    sigma : ndarray of float64, shape (N,)
        Standard deviation of the noise, which bounds the correction.
    """

    low: tuple[bool, ...]
    high: tuple[bool, ...]
    sigma: NDArray[np.float64]

    @property
    def clipped(self) -> list[int]:
        """The channels that were cut off at either limit."""
        return [k for k, (low, high) in enumerate(zip(self.low, self.high, strict=True)) if low or high]

    def marks(self, channels: NDArray[np.float32]) -> NDArray[np.float32]:
        """Mark the samples at the limits, to be averaged by the same kernels as the colours.

        Parameters
        ----------
        channels : ndarray of float32, shape (N, ...)
            Noisy colours, channel by channel.

        Returns
        -------
        ndarray of float32, shape (number of clipped channels, ...)
            1 at full scale, -1 at 0, and 0 between. Both in one, because no average holds many of either at once.
        """
        found = np.zeros((len(self.clipped), *channels.shape[1:]), np.float32)
        for mark, k in zip(found, self.clipped, strict=True):
            if self.high[k]:
                mark[channels[k] >= 1] = 1
            if self.low[k]:
                mark[channels[k] <= 0] = -1
        return found

    def restore(self, channels: NDArray[np.float32], marks: NDArray[np.float32]) -> None:
        """Turn averages of clipped colours, in place, into estimates of the colours without noise.

        Parameters
        ----------
        channels : ndarray of float32, shape (N, ...)
            Averages of colours; those of the clipped channels change.
        marks : ndarray of float32, shape (number of clipped channels, ...)
            Averages, with the same weights, of what `marks` gave.
        """
        for share, k in zip(marks, self.clipped, strict=True):
            sigma = np.float32(_TRUSTED * self.sigma[k])
            high, low = share > 0, share < 0
            mean = channels[k][high]
            raised = mean + _towards_limit(1 - mean, share[high], sigma)
            channels[k][high] = np.minimum(raised, np.maximum(mean, 1))
            mean = channels[k][low]
            lowered = mean - _towards_limit(mean, -share[low], sigma)
            channels[k][low] = np.maximum(lowered, np.minimum(mean, 0))


def find_clipped(colours: NDArray[np.float32], sigma: NDArray[np.float64]) -> ClippedChannels | None:
    """Find which channels were cut off at 0 or at full scale.

    Parameters
    ----------
    colours : ndarray of float32, shape (S, N)
        Noisy colours.
    sigma : ndarray of float64, shape (N,)
        Estimated standard deviation of their noise.

    Returns
    -------
    ClippedChannels or None
        None if no channel was: a channel with values beyond a limit is not cut off there, nor is one without noise.
    """
    from beltrami_cli._native import find_limits

    found = [find_limits(colours[block]) for block in large_arrays.blocks(len(colours))]
    return _clipped(found, len(colours), sigma)


def find_clipped_on_canvas(
    planes: NDArray[np.float32], filled: int, sigma: NDArray[np.float64]
) -> ClippedChannels | None:
    """Do so for colours on a canvas.

    Parameters
    ----------
    planes : ndarray of float32, shape (N, R, C)
        Noisy colours, halo included; 0 where cells are empty.
    filled : int
        Cells that are not.
    sigma : ndarray of float64, shape (N,)
        Estimated standard deviation of their noise.

    Returns
    -------
    ClippedChannels or None
        As `find_clipped`.
    """
    from beltrami_cli._native import find_limits

    rows = max(1, large_arrays.BLOCK // max(1, planes.shape[2]))
    found = [
        [find_limits(plane[block].reshape(-1, 1))[0] for plane in planes]
        for block in large_arrays.blocks(planes.shape[1], rows)
    ]
    return _clipped(found, filled, sigma, empty=planes[0].size - filled)


def _clipped(
    found: list[list[tuple[float, float, int, int]]], count: int, sigma: NDArray[np.float64], empty: int = 0
) -> ClippedChannels | None:
    """Judge by the least and largest values, and by how many are 0 and 1, part by part, channel by channel."""
    if not count:
        return None
    parts = np.array(found)
    least, most = parts[:, :, 0].min(axis=0), parts[:, :, 1].max(axis=0)
    at_0, at_1 = parts[:, :, 2].sum(axis=0) - empty, parts[:, :, 3].sum(axis=0)
    worth, noisy = _WORTH_RESTORING * count, np.asarray(sigma) > 0
    low = (noisy & (least == 0) & (at_0 >= worth)).tolist()
    high = (noisy & (most == 1) & (at_1 >= worth)).tolist()
    if not (any(low) or any(high)):
        return None
    return ClippedChannels(tuple(low), tuple(high), np.asarray(sigma, np.float64))


def sigma_of_clipped(gap: NDArray[np.float64], share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Tell the standard deviation of noise from samples of one colour, some of which were cut off at a limit.

    Parameters
    ----------
    gap : ndarray of float64
        From the mean of the samples to the limit.
    share : ndarray of float64
        Share of the samples that stand at the limit, above 0 and below 1.

    Returns
    -------
    ndarray of float64
        Of the noise before it was cut off [1]_.
    """
    table = _censored_normal()
    told: NDArray[np.float64] = gap / np.interp(share, table.share, table.gap)
    return told


def variance_of_clipped(share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Tell how much of the variance of noise is left after it was cut off at a limit.

    Parameters
    ----------
    share : ndarray of float64
        Share of the samples of one colour that stand at the limit, in [0, 1].

    Returns
    -------
    ndarray of float64
        Variance of a normal variable censored at the limit [1]_, as a share of the variance without.
    """
    table = _censored_normal()
    left: NDArray[np.float64] = np.interp(share, table.share, table.variance)
    return left


def _towards_limit(
    gap: NDArray[np.float32], share: NDArray[np.float32], sigma: np.float32
) -> NDArray[np.float32]:
    """Return how much closer to a limit the true value is than the average.

    With alpha = (limit - true) / sigma, the share at the limit is 1 - Phi(alpha), and the mean lies below the limit
    by sigma (alpha Phi(alpha) + phi(alpha)) [1]_. The share gives alpha, and the gap the local sigma; that is not
    believed beyond `sigma`, for then colours differ and not only noise.
    """
    table = _censored_normal()
    # The share of a true colour within the limits is at most one half.
    share = np.minimum(share, np.float32(0.5))
    alpha = np.interp(share, table.share, table.alpha).astype(np.float32)
    gap_of_one = np.interp(share, table.share, table.gap).astype(np.float32)
    local = np.minimum(gap / gap_of_one, sigma)
    closer: NDArray[np.float32] = local * (gap_of_one - alpha)
    return np.maximum(closer, 0)


@dataclass(frozen=True)
class _CensoredNormal:
    """What is true of a normal variable with sigma = 1 that is censored at a limit, by the share that stands there.

    Attributes
    ----------
    share : ndarray of float64, shape (M,)
        Ascending from 0 to 1.
    alpha : ndarray of float64, shape (M,)
        From the mean before it was censored to the limit.
    gap : ndarray of float64, shape (M,)
        From the mean after it was censored to the limit.
    variance : ndarray of float64, shape (M,)
        After it was censored.
    """

    share: NDArray[np.float64]
    alpha: NDArray[np.float64]
    gap: NDArray[np.float64]
    variance: NDArray[np.float64]


@cache
def _censored_normal() -> _CensoredNormal:
    # SciPy has these functions, and takes longer to be imported than a small mesh takes to be smoothed.
    normal = NormalDist()
    share = np.linspace(0, 1, 2 * _TABLE - 1)
    # Shares of 0 and 1 are an alpha without bound; what the table has there makes no difference to the mean.
    least = share[1] / 100
    inside = np.clip(share, least, 1 - least)
    alpha = -np.array([normal.inv_cdf(part) for part in inside])
    density = np.exp(-(alpha**2) / 2) / np.sqrt(2 * np.pi)
    gap = alpha * (1 - inside) + density
    variance = 1 - inside - alpha * density + alpha**2 * inside - (alpha - gap) ** 2
    variance[[0, -1]] = 1, 0
    return _CensoredNormal(share, alpha, gap, variance)
