"""Estimation of the noise: its size by the trained networks, its structure from residuals of a pilot.

Three colours are read together, and all other channels one by one. A limited number of neighbourhoods is read, so that
the cost does not grow with the image.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.given_noise import GivenNoise
from beltrami_cli.flow.noise.channel_noise import (
    MIN_DIFFERENCE_OF_SCALES,
    ChannelNoise,
    difference_of_scales,
)
from beltrami_cli.flow.noise.components import SCALES, covariance_of_cells, sigma_of_covariances
from beltrami_cli.flow.noise.model import NoiseModel, Reading
from beltrami_cli.flow.noise.neighbourhoods import Neighbourhoods
from beltrami_cli.flow.noise.stabiliser import VarianceStabiliser
from beltrami_cli.flow.noise.structure import Structure
from beltrami_cli.flow.noise.structure_search import find_structure
from beltrami_cli.flow.noise_amount import COLOURS

# Correlation of channels above which they share noise. It is up to 0.1 for readings of independent noise, or 0.2 where
# they are uncertain.
MIN_CORRELATION = 0.2

# Minimum relative standard deviation of samples, as a divisor of colours.
_MIN_RELATIVE_SIGMA = 0.05


@dataclass(frozen=True)
class NoiseOfSamples:
    """Noise whose standard deviation is given for each sample."""

    relative: Float32s  # variance of each sample by the mean, a stack of one channel
    sigma: Float64s  # by channel

    @classmethod
    def of(cls, deviations: Float32s) -> NoiseOfSamples:
        """Split deviations of K channels, shape (S, K)."""
        variances = np.square(deviations, dtype=np.float64)
        sigma = np.sqrt(variances.mean(axis=0))
        mean = np.mean(np.square(sigma))
        if not mean > 0:
            return cls(np.ones((len(deviations), 1), np.float32), sigma)
        relative = np.maximum(variances.mean(axis=1, keepdims=True) / mean, _MIN_RELATIVE_SIGMA**2)
        return cls(relative.astype(np.float32), sigma)


def estimate_noise(
    channels: Float32s,
    neighbourhoods: Neighbourhoods,
    given: GivenNoise | None,
    *,
    varies: bool,
    strength: float = 1.0,
    of_samples: NoiseOfSamples | None = None,
) -> NoiseModel:
    """Estimate the noise of channels, as far as it is not given.

    With `varies`, its dependence on level and place is estimated too. A higher strength assumes more noise.
    """
    if of_samples is not None:
        return _with_given_colours(read_noise(channels, neighbourhoods, varies=False), of_samples)
    if given is None:
        return _assumed(channels, neighbourhoods, strength, varies=varies)
    if given.is_by_level:
        stabiliser = VarianceStabiliser.of_camera(given.shot, given.read)
        # Stabilised colours have the same noise at all levels.
        stable = stabiliser.stabilised(channels)
        noise = read_noise(stable, neighbourhoods, varies=False, sigma=stabiliser.scale)
        return dataclasses.replace(noise.scaled_to(stabiliser.scale), stabiliser=stabiliser, reading=None)
    if given.source:
        cause = f"noise is {given.source}, but several textures have no such file in common; choose one"
        raise UsageError(cause)
    noise = read_noise(channels, neighbourhoods, varies=varies, sigma=given.sigma)
    return dataclasses.replace(noise.scaled_to(given.sigma), reading=None)


def _with_given_colours(noise: NoiseModel, given: NoiseOfSamples) -> NoiseModel:
    """Return a noise model with the given noise of the colours, and other channels as estimated."""
    sigma = noise.sigma
    colours = sigma[:COLOURS]
    if len(given.sigma) not in (1, len(colours)):
        cause = f"noise has {len(given.sigma)} channels, but must have one, or one for each colour"
        raise UsageError(cause)
    colours[:] = given.sigma
    return dataclasses.replace(NoiseModel.independent(sigma), relative=given.relative)


def _assumed(
    channels: Float32s, neighbourhoods: Neighbourhoods, strength: float, *, varies: bool
) -> NoiseModel:
    """Read the noise, and scale it to the size that a strength assumes."""
    noise = read_noise(channels, neighbourhoods, varies=varies)
    if noise.reading is None:
        return noise
    sigma = noise.reading.assumed(strength)
    if sigma and not noise.overall:
        again = read_noise(channels, neighbourhoods, varies=varies, sigma=sigma)
        noise = dataclasses.replace(again, reading=noise.reading)
    return noise.scaled_to(sigma)


def read_noise(
    planes: Float32s,
    neighbourhoods: Neighbourhoods,
    *,
    varies: bool = True,
    sigma: float | None = None,
) -> NoiseModel:
    """Read the noise of channels on a grid, shape (N, R, C), or of vertices, shape (N, S).

    With `varies`, its dependence on level and place is read too. `sigma` is the RMS noise of the colours, if known.
    """
    count = len(planes)
    if not neighbourhoods.count:
        return NoiseModel.independent(np.zeros(count))
    singles = [slice(channel, channel + 1) for channel in range(count)]
    groups = [slice(0, COLOURS), *singles[COLOURS:]] if count >= COLOURS else singles
    noises = [ChannelNoise.read(planes[group], neighbourhoods) for group in groups]
    # Number of groups of colours; further channels, such as opacity, are not levels.
    colour_groups = 1 if count >= COLOURS else count
    if sigma is not None:
        noises[:colour_groups] = [noise.with_sigma(sigma) for noise in noises[:colour_groups]]
    colours = noises[:colour_groups]
    structure = _common_structure(colours) if varies else Structure.uniform(neighbourhoods)
    covariances, ratios = np.zeros((SCALES, count, count)), []
    for number, (group, noise) in enumerate(zip(groups, noises, strict=True)):
        of_group = structure if number < colour_groups else structure.without_levels()
        covariances[:, group, group], ratio = noise.covariances(of_group)
        ratios.append(ratio)
    # Even cells may show no noise where some was read.
    is_refuted = any(noise.sigma for noise in colours) and not covariances.any()
    if is_refuted or all(noise.is_constant for noise in colours):
        return NoiseModel(covariances[:1], reading=Reading(none=1.0, low=0.0, median=0.0, high=0.0))
    return NoiseModel(
        _simplified(covariances),
        structure.stabiliser(colours[0].full_scale),
        structure.over_samples(colours[0].residual),
        _reading_of(colours, ratios[:colour_groups]),
    )


def _common_structure(colours: Sequence[ChannelNoise]) -> Structure:
    """Find the structure of the noise of the colours; of two channels, which are read separately, that of the first."""
    first, are_levels = colours[0], all(noise.are_levels for noise in colours)
    if not all(noise.sigma for noise in colours):
        return Structure.uniform(first.channels.neighbourhoods)
    return find_structure(
        first.residual, first.sigma, first.reading.place_logs, len(first.order), are_levels=are_levels
    )


def _reading_of(colours: Sequence[ChannelNoise], ratios: Sequence[float]) -> Reading:
    """Return the RMS over the channels of the sizes read, times ratios, and the probability of no noise in any."""
    sizes = [
        [ratio * quantile for quantile in noise.quantiles]
        for noise, ratio in zip(colours, ratios, strict=True)
    ]
    low, median, high = np.sqrt(np.mean(np.square(sizes), axis=0)).tolist()
    return Reading(float(np.prod([noise.size.none for noise in colours])), low, median, high)


def _simplified(covariances: Float64s) -> Float64s:
    """Drop scales if none differs, and correlations of channels if they are nearly independent."""
    if difference_of_scales(covariances) <= MIN_DIFFERENCE_OF_SCALES:
        covariances = covariances[:1]
    single = covariance_of_cells(covariances)
    sigma = sigma_of_covariances(covariances)
    is_correlated = np.abs(single) > MIN_CORRELATION * sigma[:, None] * sigma
    np.fill_diagonal(is_correlated, val=False)
    return covariances if is_correlated.any() else covariances * np.eye(len(single))
