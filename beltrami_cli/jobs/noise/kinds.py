"""Noise of four kinds, as functions of a colour and of a uniform random number of the sample.

Each is the inverse of a distribution function, so that samples with one colour and one number change alike, and samples
at one place with different colours change in the same direction.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.jobs.settings import NoiseSettings


def add_noise(
    colours: NDArray[np.float32],
    sample_of: NDArray[np.integer],
    settings: NoiseSettings,
    stream: int = 0,
    grey: NDArray[np.bool_] | None = None,
) -> NDArray[np.float32]:
    """Add noise to colours.

    Parameters
    ----------
    colours : ndarray of float32, shape (S, N)
        Full scale 1.
    sample_of : ndarray of int, shape (S,)
        Numbers of the samples, from 0. Rows with the same number get the same random numbers.
    settings : NoiseSettings
        What noise.
    stream : int
        Which of several images of one file these are: each has random numbers of its own.
    grey : ndarray of bool, shape (S,), optional
        Rows whose channels are one, and stay equal.

    Returns
    -------
    ndarray of float32, shape (S, N)
        Colours that all lie within 0 and 1 are cut off there, as a camera does; others are not cut off on the side
        on which some of them lie beyond.
    """
    if not colours.size or settings.sigma == 0:
        return colours.copy()
    rows, channels = int(sample_of.max()) + 1, colours.shape[1]
    columns = 1 if settings.kind == "salt-pepper" else channels
    generator = np.random.Generator(np.random.Philox(np.random.SeedSequence([settings.seed, stream])))
    numbers = generator.random((rows, columns), dtype=np.float32)
    noisy = np.empty_like(colours)
    for channel in range(channels):
        drawn = numbers[sample_of, min(channel, columns - 1)]
        if grey is not None:
            drawn = np.where(grey, numbers[sample_of, 0], drawn)
        # Multiples of 2^-24; half of that keeps them off 0, where distributions without bound have no inverse.
        drawn = drawn.astype(np.float64) + 2.0**-25
        noisy[:, channel] = _changed(colours[:, channel].astype(np.float64), drawn, settings)
    return noisy.clip(*bounds(colours))


def bounds(colours: NDArray[np.float32]) -> tuple[float, float]:
    """Return where colours are cut off: at 0 and 1, unless some of them lie beyond."""
    low = 0.0 if colours.min(initial=0) >= 0 else -np.inf
    return low, 1.0 if colours.max(initial=1) <= 1 else np.inf


def _changed(
    colours: NDArray[np.float64], numbers: NDArray[np.float64], settings: NoiseSettings
) -> NDArray[np.float64]:
    from scipy.special import ndtri

    sigma = settings.sigma
    if settings.kind == "gaussian":
        return np.asarray(colours + sigma * ndtri(numbers), np.float64)
    if settings.kind == "speckle":
        return np.asarray(colours * (1 + sigma * ndtri(numbers)), np.float64)
    if settings.kind == "poisson":
        return _counted(colours, numbers, sigma)
    return np.where(numbers < sigma / 2, 0.0, np.where(numbers > 1 - sigma / 2, 1.0, colours))


def _counted(colours: NDArray[np.float64], numbers: NDArray[np.float64], sigma: float) -> NDArray[np.float64]:
    """Count photons: full scale is 1 / sigma^2 of them, so that their deviation is sigma of full scale there."""
    from scipy.stats import poisson

    counts = poisson.ppf(numbers, np.maximum(colours, 0) / sigma**2)
    return np.where(colours < 0, colours, counts * sigma**2)
