"""Estimate the noise of colours: how it depends on the level and the place, and what neighbouring samples share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.noise.by_scale import FoundNoise
from beltrami_cli.flow.noise.haar_noise import sigma_of_covariances
from beltrami_cli.flow.noise.model import NoiseModel
from beltrami_cli.flow.noise.stabilising import COLOURS, VarianceStabiliser
from beltrami_cli.flow.parameters import KernelParameters

# Noise that is assumed at least where colours are to be smoothed strongly: a step of an 8-bit file.
_LEAST_STRONG = 1 / 255


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
    parameters: KernelParameters,
    *,
    measured: tuple[Float32s, Float64s] | None = None,
    known: FoundNoise | None = None,
    is_searched: bool = True,
) -> NoiseModel:
    """Estimate what is not given of the noise, and stabilise the colours, in place.

    `measured` is noise given for each sample: relative variances and sigma by channel; `known` is that of the surface
    that the samples are a part of. If it `is_searched`, noise that differs by level or place is looked for.
    """
    given, place, found = parameters.given_noise, NoiseByPlace(), known or FoundNoise()
    if known is None and measured is not None:
        place = NoiseByPlace(measured[0])
    elif known is None and given is not None:
        found = FoundNoise(given.stabiliser() if given.is_by_level else None)
    elif known is None:
        evens = parameters.evens_noise and is_searched
        place = samples.noise_by_place() if evens else place
        found = samples.noise_by_scale(place.relative, by_level=evens)
    if found.stabiliser is not None:
        samples.stabilise(found.stabiliser)
    sigma = samples.sigma(place.relative) if found.sigma is None else found.sigma
    if known is None:
        sigma = np.minimum(sigma, place.most) * place.scale
        colours = np.minimum(sigma[:COLOURS], found.most)
        sigma[:COLOURS] = _noise_to_assume(
            parameters, colours, None if measured is None else measured[1], found.stabiliser
        )
        if found.covariances is not None:
            sigma = sigma_of_covariances(found.covariances)
    return NoiseModel(sigma, found.covariances, found.stabiliser, place.relative, found.doubt)


def _noise_to_assume(
    parameters: KernelParameters,
    estimated: Float64s,
    measured: Float64s | None,
    stabiliser: VarianceStabiliser | None,
) -> Float64s | float:
    """Return the noise of colours that smoothing assumes: measured or given, or else estimated."""
    given = parameters.given_noise
    if measured is not None:
        if len(measured) not in (1, len(estimated)):
            cause = f"noise has {len(measured)} channels, but must have one, or one for each colour"
            raise UsageError(cause)
        return measured
    if given is not None and given.source:
        cause = f"noise is {given.source}, but several textures have no such file in common; choose one"
        raise UsageError(cause)
    if given is not None:
        return given.sigma if stabiliser is None else stabiliser.scale
    return np.maximum(estimated, _LEAST_STRONG) if parameters.strength == "strong" else estimated
