"""Estimation of the noise: its size by the trained network, its structure from residuals of a pilot.

Three colours are read together, and all other channels one by one. At most `MAX_SQUARES` squares are read, so that the
cost does not grow with the picture.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s, Int64s
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.noise import features
from beltrami_cli.flow.noise.features import COMPONENTS, SCALES, STEPS, even_covariances
from beltrami_cli.flow.noise.model import (
    MAX_NO_NOISE_PROBABILITY,
    NoiseModel,
    Reading,
    covariance_of_cells,
    sigma_of_covariances,
)
from beltrami_cli.flow.noise.neighbourhoods import Neighbourhoods, Samples
from beltrami_cli.flow.noise.network import (
    OFFSET,
    QUANTILES,
    Layers,
    Weights,
    candidates_of,
    quiet_of,
    read,
    readings,
    weights_of,
)
from beltrami_cli.flow.noise.residual import Residual
from beltrami_cli.flow.noise.size import Size, evidence, removal_curve, size_weights
from beltrami_cli.flow.noise.stabiliser import COLOURS, VarianceStabiliser
from beltrami_cli.flow.noise.structure import MAX_CLIPPED_SHARE, Structure, shares_of_noise, structure_of
from beltrami_cli.flow.parameters import GivenNoise

# Relative difference of the covariances of the finest two scales above which neighbours share noise. It is at most 0.29
# for readings of white noise, and at least 1 for filtered noise other than mosaics.
MIN_DIFFERENCE_OF_SCALES = 0.35

# Correlation of channels above which they share noise. It is up to 0.1 for readings of independent noise, or 0.2 where
# they are uncertain.
MIN_CORRELATION = 0.2

# Difference of covariances above which neighbours certainly share noise. Between both values, mosaics and colours that
# the network mistakes for them are distinguished by the correlation of neighbours in the residual of a pilot. It is up
# to 0.1 for white noise, also on rich texture, and 0.13 to 0.45 for filtered noise, in the kinds of
# benchmarks/bench_regret.py.
_CERTAIN_DIFFERENCE_OF_SCALES = 1.0
_MAX_CORRELATION_OF_NEIGHBOURS = 0.12

# Number of details whose mean square is as uncertain as the variance read by the network: 28 %, or 0.2 of log2 of a
# deviation.
_DETAILS_OF_READING = 26

# Number of samples of the smallest training pictures; with fewer, hard-edged paint is not distinguishable from noise.
_MIN_SAMPLES = 256

# If values exceed full scale, as with light, this quantile becomes full scale. If the opposite quantile is outside
# of [0, 1], values are not levels, and are shifted by it.
_FULL_SCALE_QUANTILE = 0.99


def estimate_noise(
    channels: Float32s,
    where: Neighbourhoods,
    given: GivenNoise | None,
    *,
    varies: bool,
    strength: float = 1.0,
    measured: tuple[Float32s, Float64s] | None = None,
) -> NoiseModel:
    """Estimate the noise of channels, as far as it is not given.

    With `varies`, its dependence on level and place is estimated too. A higher strength assumes more noise. `measured`
    is noise that is given for each sample: relative variances, and sigma by channel.
    """
    if measured is None and given is not None and given.is_by_level:
        stabiliser = VarianceStabiliser.of_camera(given.shot, given.read)
        # Stabilised colours have the same noise at all levels.
        stable = stabiliser.stabilised(channels)
        found = read_noise(stable, where, varies=False, sigma=stabiliser.scale).scaled_to(stabiliser.scale)
        return dataclasses.replace(found, stabiliser=stabiliser)
    if measured is not None:
        found = _measured(read_noise(channels, where, varies=False), *measured)
    else:
        sigma = None if given is None else _sigma_of(given)
        found = read_noise(channels, where, varies=varies, sigma=sigma)
        if sigma is not None:
            found = dataclasses.replace(found.scaled_to(sigma), reading=None)
        elif found.reading is not None:
            assumed = found.reading.assumed(strength)
            if assumed and not found.overall:
                found = dataclasses.replace(
                    read_noise(channels, where, varies=varies, sigma=assumed), reading=found.reading
                )
            found = found.scaled_to(assumed)
    return found


def _measured(found: NoiseModel, relative: Float32s, sigma: Float64s) -> NoiseModel:
    """Return a noise model with given standard deviations of the colours, and other channels as estimated."""
    channels = min(COLOURS, len(found.sigma))
    if len(sigma) not in (1, channels):
        cause = f"noise has {len(sigma)} channels, but must have one, or one for each colour"
        raise UsageError(cause)
    every = found.sigma
    every[:channels] = sigma
    return dataclasses.replace(NoiseModel.independent(every), relative=relative)


def _sigma_of(given: GivenNoise) -> float:
    if given.source:
        cause = f"noise is {given.source}, but several textures have no such file in common; choose one"
        raise UsageError(cause)
    return given.sigma


def read_noise(
    planes: Float32s,
    where: Neighbourhoods,
    *,
    varies: bool = True,
    sigma: float | None = None,
    weights: Weights | None = None,
) -> NoiseModel:
    """Read the noise of channels on a grid, shape (N, R, C), or of vertices, shape (N, S).

    With `varies`, its dependence on level and place is read too. `sigma` is the RMS noise of the colours, if known.
    `weights` of the network default to those of the package.
    """
    weights, count = weights or weights_of(where.kind), len(planes)
    if not where.count:
        return NoiseModel.independent(np.zeros(count))
    together = [list(range(COLOURS))] if count >= COLOURS else []
    groups = [*together, *([channel] for channel in range(len(together) * COLOURS, count))]
    sizes = [_read_size(planes[own[0] : own[-1] + 1], where, weights) for own in groups]
    if sigma is not None:
        sizes[: 1 if together else COLOURS] = [
            own.of_sigma(sigma) for own in sizes[: 1 if together else COLOURS]
        ]
    colours = sizes[: 1 if together else None]
    structure = Structure.even(where)
    if varies and all(own.sigma for own in colours):
        # Two channels are read separately, and both get the structure of the first.
        first, are_levels = colours[0], all(own.are_levels for own in colours)
        structure = structure_of(
            first.residual, first.sigma, first.places, len(first.order), are_levels=are_levels
        )
    covariances, parts = np.zeros((SCALES, count, count)), []
    for own, size in zip(groups, sizes, strict=True):
        varying = structure if size in colours else dataclasses.replace(structure, curve=None)
        found, factor = size.covariances(varying)
        covariances[:, np.array(own)[:, None], own] = found
        if size in colours:
            parts.append([size.size.none, *(factor * quantile for quantile in size.quantiles)])
    stabiliser = None if structure.curve is None else structure.curve.stabiliser(colours[0].full_scale)
    relative = structure.over_samples(colours[0].residual) if structure.is_by_place else None
    is_constant = not any(np.ptp(own.samples.colours, axis=1).any() for own in colours)
    # Even cells may show no noise where some was read.
    if is_constant or (any(own.sigma for own in colours) and not covariances.any()):
        return NoiseModel(covariances[:1], reading=Reading(1.0, 0.0, 0.0, 0.0))
    # RMS over the channels, except the probability of no noise in any of them.
    none, *quantiles = np.array(parts).T
    reading = Reading(float(none.prod()), *(float(np.sqrt(np.mean(np.square(own)))) for own in quantiles))
    return NoiseModel(_simplified(covariances), stabiliser, relative, reading)


def difference_of_scales(covariances: Float64s) -> float:
    """Return the difference of the covariances of the finest two scales, relative to the smaller; 0: white noise."""
    # Filtering shows in the finest two scales, which have the least texture.
    fine, coarse = covariances[:2]
    least = min(float(np.linalg.norm(fine)), float(np.linalg.norm(coarse)))
    return float(np.linalg.norm(coarse - fine)) / max(1e-12, least)


def _simplified(covariances: Float64s) -> Float64s:
    """Drop scales if none differs, and correlations of channels if they are nearly independent."""
    if difference_of_scales(covariances) <= MIN_DIFFERENCE_OF_SCALES:
        covariances = covariances[:1]
    single = covariance_of_cells(covariances)
    sigma = sigma_of_covariances(covariances)
    is_correlated = np.abs(single) > MIN_CORRELATION * sigma[:, None] * sigma
    np.fill_diagonal(is_correlated, val=False)
    return covariances if is_correlated.any() else covariances * np.eye(len(single))


@dataclass(frozen=True, eq=False)
class _Colours:
    """Noise of K channels, one or three, with the size read by the network, in steps of 8 bits of full scale."""

    samples: Samples
    order: Int64s  # of the channels, shape (K,)
    size: Size
    sigma: float  # RMS of the channels; 0: no noise
    components: Float64s  # covariances by scale as read, shape (SCALES, 3, 3)
    places: Float64s  # log2 of the relative deviations of neighbourhoods, shape (P,)
    full_scale: float
    are_levels: bool

    @property
    def quantiles(self) -> tuple[float, float, float]:
        """Quantiles of the size, of full scale 1, see `Reading`."""
        step = self.full_scale / float(STEPS)
        low, median, high = (self.size.quantile(share) * step for share in (0.05, 0.5, 0.95))
        return low, median, high

    def of_sigma(self, sigma: float) -> _Colours:
        """Return the noise with a known RMS."""
        return dataclasses.replace(self, sigma=sigma * float(STEPS) / self.full_scale)

    @cached_property
    def residual(self) -> Residual:
        """The residual of a pilot that assumes even noise."""
        return Residual.of(self.samples, np.full(1, self.sigma**2, np.float32))

    def covariances(self, structure: Structure) -> tuple[Float64s, float]:
        """Return the covariances of stabilised channels by scale, and the ratio of the noise to `sigma`.

        Components have the covariance of the pilot's residual. It lacks most of the noise that neighbours share.
        Such noise has the covariances that the network reads, as far as even cells have that much energy.
        """
        if not self.sigma:
            return np.zeros((SCALES, len(self.order), len(self.order))), 1.0
        step, size, factor = self.full_scale / float(STEPS), self.sigma, 1.0
        residual = self.residual
        if not structure.is_even:
            residual = Residual.of(self.samples, np.float32(size**2) * structure.variances(residual))
        if structure.curve is not None:
            stabiliser = structure.curve.stabiliser(self.full_scale)
            residual, size = residual.stabilised(stabiliser, step), size * stabiliser.scale
        finest = residual.even_covariance(structure.places)
        is_shared = self._is_shared(residual)
        found = self.components if is_shared else np.repeat(finest[None], SCALES, axis=0)
        total = float(np.trace(covariance_of_cells(found))) if finest.any() else 0.0
        found = found * (COLOURS * size**2 / total) if total else 0 * found
        if total and is_shared:
            is_whole = self.samples.cut_off() < MAX_CLIPPED_SHARE
            combined = _combined(
                found, *even_covariances(residual.samples.cells(), is_whole, structure.places)
            )
            factor = float(np.sqrt(np.trace(covariance_of_cells(combined)) / COLOURS) / size)
            found = combined
        mixing = COMPONENTS.astype(np.float64)[:, self.order] * step
        return np.asarray(np.einsum("kc,lkm,md->lcd", mixing, found, mixing), np.float64), factor

    def _is_shared(self, residual: Residual) -> bool:
        """Whether neighbours share noise, by the network or, if it is uncertain, by the residual."""
        difference = difference_of_scales(self.components)
        if difference > _CERTAIN_DIFFERENCE_OF_SCALES:
            return True
        shares = residual.correlation_of_neighbours > _MAX_CORRELATION_OF_NEIGHBOURS
        return shares and difference > MIN_DIFFERENCE_OF_SCALES


def _combined(components: Float64s, measured: Float64s, counts: Float64s) -> Float64s:
    """Return the weighted mean of the covariance of components as read, and as measured in even cells.

    Plain colours show the noise more exactly than the network reads it. The weight of even cells grows with their
    number of details, and decreases if their energy exceeds the reading, since the excess is texture.
    """
    shares = shares_of_noise(*(np.einsum("lkk->lk", own) for own in (components, measured)))
    shares *= (counts / (counts + _DETAILS_OF_READING))[:, None]
    found = np.zeros_like(components)
    for share, own in ((shares, measured), (1 - shares, components)):
        found += own * np.sqrt(share[:, :, None] * share[:, None])
    return found


def _read_size(planes: Float32s, where: Neighbourhoods, weights: Weights) -> _Colours:
    """Read the noise of three channels, or of one channel, which is repeated three times."""
    samples = where.cut(np.broadcast_to(planes, (COLOURS, *planes.shape[1:])))
    samples, scale, are_levels = _in_full_scale(samples)
    found, candidates = read_network(samples, weights)
    row, first = evidence(
        found["context"], np.sort(found["total"]), candidates[:, 0], removal_curve(samples)[None],
        np.array([where.count]),
    )  # fmt: skip
    size = size_weights(where.kind).size(row[0], float(first[0]))
    order = np.argsort(samples.order)[: len(planes)]
    places = _medians(found["places"])
    if len(where.tiles) < _MIN_SAMPLES:
        size = dataclasses.replace(size, none=1.0)
    sigma = size.quantile(0.5) if size.none <= MAX_NO_NOISE_PROBABILITY else 0.0
    return _Colours(samples, order, size, sigma, _components(found), places, scale, are_levels)


def read_network(samples: Samples, weights: Weights) -> tuple[dict[str, Array], Array]:
    """Return the network's reading of samples, its context, and candidates of the total, shape (1, 1, M)."""
    cells, start, kind = samples.cells(), np.zeros(1, np.int64), samples.where.kind
    even, squares = features.describe_even_cells(cells)[None], features.describe(samples.described(), cells)
    candidates = candidates_of(even, quiet_of(squares, kind), start, kind)
    squares, even = weights.standardised("squares", squares), weights.standardised("even", even)
    found = readings(read(Layers(weights.layers), squares, start, even), candidates)
    return found, candidates["total"]


def _components(found: dict[str, Array]) -> Float64s:
    """Return the covariances of components by scale, as read by the network."""
    medians = _medians(found["deviations"].reshape(SCALES, COLOURS, len(QUANTILES)))
    deviations = np.maximum(2.0**medians - OFFSET, 1e-3)
    correlations = np.tanh(found["correlations"].reshape(SCALES, COLOURS).astype(np.float64))
    mixed = np.stack([np.eye(COLOURS)] * SCALES)
    for number, (one, other) in enumerate(((0, 1), (0, 2), (1, 2))):
        mixed[:, one, other] = mixed[:, other, one] = correlations[:, number]
    values, vectors = np.linalg.eigh(mixed * deviations[:, :, None] * deviations[:, None])
    roots = vectors * np.sqrt(np.maximum(values, 0))[:, None]
    covariances: Float64s = np.einsum("lkm,ljm->lkj", roots, roots)
    return covariances


def _medians(quantiles: Array) -> Float64s:
    return np.sort(quantiles, axis=-1)[..., QUANTILES.index(0.5)].astype(np.float64)


def _in_full_scale(samples: Samples) -> tuple[Samples, float, bool]:
    """Scale colours to [0, 1]; return them, the full scale, and whether they are levels, which start in [0, 1]."""
    values = samples.colours / STEPS
    low, high = np.quantile(values, (1 - _FULL_SCALE_QUANTILE, _FULL_SCALE_QUANTILE))
    shift = 0.0 if 0 <= low <= 1 else float(low)
    scale = max(1.0, float(high) - shift) if values.max(initial=0) > 1 + shift else 1.0
    if shift == 0 and scale == 1:
        return samples, scale, True
    values = (values - np.float32(shift)) * (STEPS / np.float32(scale))
    # Values beyond full scale are rarely noise. Without clipping, single samples would hide the noise of all others.
    return dataclasses.replace(samples, colours=values.clip(0, STEPS)), scale, shift == 0
