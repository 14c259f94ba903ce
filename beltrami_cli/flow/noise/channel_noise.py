"""The noise of three channels or one: its size, read by the networks, and its covariances, measured on residuals."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s, Int64s
from beltrami_cli.flow.noise.components import COMPONENTS, SCALES, STEPS, covariance_of_cells
from beltrami_cli.flow.noise.even_cells import even_covariances
from beltrami_cli.flow.noise.model import MAX_NO_NOISE_PROBABILITY
from beltrami_cli.flow.noise.neighbourhoods import MIN_SAMPLES, Neighbourhoods, ThreeChannels
from beltrami_cli.flow.noise.network import NetworkReading, weights_of
from beltrami_cli.flow.noise.residual import Residual, shares_of_noise
from beltrami_cli.flow.noise.size import Size
from beltrami_cli.flow.noise.structure import Structure
from beltrami_cli.flow.noise_amount import COLOURS

# Relative difference of the covariances of the finest two scales above which neighbours share noise. It is at most 0.29
# for readings of white noise, and at least 1 for filtered noise other than mosaics.
MIN_DIFFERENCE_OF_SCALES = 0.35

# Difference of covariances above which neighbours certainly share noise. Between both values, mosaics and colours that
# the network mistakes for them are distinguished by the correlation of neighbours in the residual of a pilot. It is up
# to 0.1 for white noise, also on rich texture, and 0.13 to 0.45 for filtered noise, in the kinds of
# benchmarks/bench_regret.py.
_CERTAIN_DIFFERENCE_OF_SCALES = 1.0
_MAX_CORRELATION_OF_NEIGHBOURS = 0.12

# Number of details whose mean square is as uncertain as the variance read by the network: 28 %, or 0.2 of log2 of a
# deviation.
_DETAILS_OF_READING = 26

# If values exceed full scale, as with light, this quantile becomes full scale. If the opposite quantile is outside
# of [0, 1], values are not levels, and are shifted by it.
_FULL_SCALE_QUANTILE = 0.99


@dataclass(frozen=True, eq=False)
class ChannelNoise:
    """Noise of K channels, one or three, in steps of 8 bits of their full scale."""

    channels: ThreeChannels
    order: Int64s  # of the channels, shape (K,)
    reading: NetworkReading
    size: Size
    sigma: float  # RMS of the channels; 0: no noise
    full_scale: float
    are_levels: bool

    @classmethod
    def read(cls, planes: Float32s, neighbourhoods: Neighbourhoods) -> ChannelNoise:
        """Read the noise of three channels, or of one channel, which is repeated three times."""
        channels = neighbourhoods.cut(np.broadcast_to(planes, (COLOURS, *planes.shape[1:])))
        channels, full_scale, are_levels = _in_full_scale(channels)
        reading = NetworkReading.of(channels, weights_of(neighbourhoods.kind))
        size = Size.of(channels, reading, weights_of(neighbourhoods.kind, "sizes"))
        if len(neighbourhoods.of_samples) < MIN_SAMPLES:
            size = dataclasses.replace(size, none=1.0)
        sigma = size.quantile(0.5) if size.none <= MAX_NO_NOISE_PROBABILITY else 0.0
        order = np.argsort(channels.order)[: len(planes)]
        return cls(channels, order, reading, size, sigma, full_scale, are_levels)

    @property
    def step(self) -> float:
        """A step of 8 bits."""
        return self.full_scale / float(STEPS)

    @property
    def quantiles(self) -> tuple[float, float, float]:
        """Quantiles of the size, of full scale 1, see `Reading`."""
        low, median, high = (self.size.quantile(share) * self.step for share in (0.05, 0.5, 0.95))
        return low, median, high

    @property
    def is_constant(self) -> bool:
        return not np.ptp(self.channels.colours, axis=1).any()

    def with_sigma(self, sigma: float) -> ChannelNoise:
        """Return the noise with a known RMS, of full scale 1."""
        return dataclasses.replace(self, sigma=sigma * float(STEPS) / self.full_scale)

    @cached_property
    def residual(self) -> Residual:
        """The residual of a pilot that assumes uniform noise."""
        return Residual.of(self.channels, np.full(1, self.sigma**2, np.float32))

    def covariances(self, structure: Structure) -> tuple[Float64s, float]:
        """Return the covariances of stabilised channels by scale, and the ratio of the noise to `sigma`.

        Components have the covariance of the pilot's residual. It lacks most of the noise that neighbours share.
        Such noise has the covariances that the network reads, as far as even cells have that much energy.
        """
        nothing = np.zeros((SCALES, len(self.order), len(self.order)))
        if not self.sigma:
            return nothing, 1.0
        residual, sigma = structure.residual(self.residual, self.sigma), self.sigma
        stabiliser = structure.stabiliser(self.full_scale)
        if stabiliser is not None:
            residual, sigma = residual.stabilised(stabiliser, self.step), sigma * stabiliser.scale
        of_singles = residual.even_covariance(structure.place_variances)
        if not of_singles.any():
            return nothing, 1.0
        if not self._is_shared(residual):
            return self._of_channels(_scaled(np.repeat(of_singles[None], SCALES, axis=0), sigma)), 1.0
        of_even = even_covariances(
            residual.channels.cells, self.channels.is_unclipped, structure.place_variances
        )
        covariances = _combined(_scaled(self.reading.covariances, sigma), *of_even)
        ratio = np.sqrt(np.trace(covariance_of_cells(covariances)) / COLOURS) / sigma
        return self._of_channels(covariances), float(ratio)

    def _of_channels(self, components: Float64s) -> Float64s:
        """Return the covariances of the channels from those of components."""
        mixing = COMPONENTS.astype(np.float64)[:, self.order] * self.step
        return np.asarray(np.einsum("kc,lkm,md->lcd", mixing, components, mixing), np.float64)

    def _is_shared(self, residual: Residual) -> bool:
        """Whether neighbours share noise, by the network or, if it is uncertain, by the residual."""
        difference = difference_of_scales(self.reading.covariances)
        if difference > _CERTAIN_DIFFERENCE_OF_SCALES:
            return True
        shares = residual.correlation_of_neighbours > _MAX_CORRELATION_OF_NEIGHBOURS
        return shares and difference > MIN_DIFFERENCE_OF_SCALES


def _scaled(components: Float64s, sigma: float) -> Float64s:
    """Scale covariances of components to an RMS noise of the channels."""
    return components * (COLOURS * sigma**2 / float(np.trace(covariance_of_cells(components))))


def _combined(components: Float64s, of_even: Float64s, counts: Float64s) -> Float64s:
    """Return the weighted mean of the covariance of components as read, and of that of even cells.

    Plain colours show the noise more exactly than the network reads it. The weight of even cells grows with their
    number of details, and decreases if their energy exceeds the reading, since the excess is texture.
    """
    shares = shares_of_noise(*(np.einsum("lkk->lk", own) for own in (components, of_even)))
    shares *= (counts / (counts + _DETAILS_OF_READING))[:, None]

    def part(covariances: Float64s, share: Float64s) -> Float64s:
        return covariances * np.sqrt(share[:, :, None] * share[:, None])

    return part(of_even, shares) + part(components, 1 - shares)


def difference_of_scales(covariances: Float64s) -> float:
    """Return the difference of the covariances of the finest two scales, relative to the smaller; 0: white noise."""
    # Filtering shows in the finest two scales, which have the least texture.
    fine, coarse = covariances[:2]
    least = min(float(np.linalg.norm(fine)), float(np.linalg.norm(coarse)))
    return float(np.linalg.norm(coarse - fine)) / max(1e-12, least)


def _in_full_scale(channels: ThreeChannels) -> tuple[ThreeChannels, float, bool]:
    """Scale colours to [0, 1]; return them, the full scale, and whether they are levels, which start in [0, 1]."""
    values = channels.colours / STEPS
    low, high = np.quantile(values, (1 - _FULL_SCALE_QUANTILE, _FULL_SCALE_QUANTILE))
    shift = 0.0 if 0 <= low <= 1 else float(low)
    scale = max(1.0, float(high) - shift) if values.max(initial=0) > 1 + shift else 1.0
    if shift == 0 and scale == 1:
        return channels, scale, True
    values = (values - np.float32(shift)) * (STEPS / np.float32(scale))
    # Values beyond full scale are rarely noise. Without clipping, single samples would hide the noise of all others.
    return dataclasses.replace(channels, colours=values.clip(0, STEPS)), scale, shift == 0
