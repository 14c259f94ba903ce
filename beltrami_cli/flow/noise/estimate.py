"""Estimate the noise of colours: how it depends on the level and the place, and what neighbouring samples share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.noise.by_scale import FoundNoise
from beltrami_cli.flow.noise.given import GivenNoise
from beltrami_cli.flow.noise.haar_noise import sigma_of_covariances
from beltrami_cli.flow.noise.model import NoiseModel
from beltrami_cli.flow.noise.stabilising import COLOURS, VarianceStabiliser


@dataclass(frozen=True)
class NoiseByPlace:
    """Noise that differs from place to place; sigma of all is `scale` times that of quiet places, which is bounded."""

    relative: Float32s | None = None  # variance by its mean, a stack of one channel
    most: float = np.inf
    scale: float = 1.0


class NoisySamples(Protocol):
    """Colours with the neighbourhoods of their samples."""

    def noise_by_place(self) -> NoiseByPlace: ...

    def noise_by_scale(self, relative: Float32s | None, *, by_level: bool) -> FoundNoise: ...

    def sigma(self, relative: Float32s | None) -> Float64s:
        """Return sigma of independent noise, by channel."""

    def stabilise(self, stabiliser: VarianceStabiliser) -> None:
        """Transform the colours, in place."""


def estimate_noise(
    samples: NoisySamples,
    given: GivenNoise | None,
    *,
    varies: bool,
    least: float = 0.0,
    measured: tuple[Float32s, Float64s] | None = None,
    known: FoundNoise | None = None,
) -> NoiseModel:
    """Estimate the noise, as far as it is not given, and stabilise the colours, in place.

    If it `varies`, its dependence on level and place is estimated, too; the standard deviation that is assumed is at
    least `least`. `measured` is noise given for each sample: relative variances, and sigma by channel. `known` is the
    noise of the surface that the samples are a part of.
    """
    place, found = NoiseByPlace(), known or FoundNoise()
    if known is None and measured is not None:
        place = NoiseByPlace(measured[0])
    elif known is None and given is not None:
        found = FoundNoise(given.stabiliser() if given.is_by_level else None)
    elif known is None:
        place = samples.noise_by_place() if varies else place
        found = samples.noise_by_scale(place.relative, by_level=varies)
    if found.stabiliser is not None:
        samples.stabilise(found.stabiliser)
    sigma = samples.sigma(place.relative) if found.sigma is None else found.sigma
    if known is None:
        sigma = np.minimum(sigma, place.most) * place.scale
        colours = np.minimum(sigma[:COLOURS], found.most)
        if measured is not None:
            sigma[:COLOURS] = _checked(measured[1], len(colours))
        elif given is not None:
            sigma[:COLOURS] = _sigma_of(given, found.stabiliser)
        else:
            sigma[:COLOURS] = np.maximum(colours, least)
        if found.covariances is not None:
            sigma = sigma_of_covariances(found.covariances)
    return NoiseModel(sigma, found.covariances, found.stabiliser, place.relative, found.doubt)


def _checked(sigma: Float64s, channels: int) -> Float64s:
    if len(sigma) not in (1, channels):
        cause = f"noise has {len(sigma)} channels, but must have one, or one for each colour"
        raise UsageError(cause)
    return sigma


def _sigma_of(given: GivenNoise, stabiliser: VarianceStabiliser | None) -> float:
    if given.source:
        cause = f"noise is {given.source}, but several textures have no such file in common; choose one"
        raise UsageError(cause)
    return given.sigma if stabiliser is None else stabiliser.scale
