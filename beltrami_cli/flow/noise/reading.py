"""The noise of colours as the trained network reads it: its covariance by scale, by level and by place.

Three colours are read together, and all other channels one by one. At most `MAX_SQUARES` squares are read, so that the
cost does not grow with the picture.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s, Int64s
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.noise import features
from beltrami_cli.flow.noise.features import COMPONENTS, LEVEL_BINS, SCALES, STEPS, even_covariances
from beltrami_cli.flow.noise.grid_squares import quiet_energies
from beltrami_cli.flow.noise.model import COLOURS, NoiseModel, VarianceStabiliser, covariance_of_cells
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
from beltrami_cli.flow.parameters import GivenNoise

# Noise below this deviation, in steps of 8 bits, is invisible: it is less than that of rounding.
INVISIBLE = 0.29

# Ratio of deviations between levels or places, above which they differ. Readings of a camera's noise by level are
# drawn towards 1. Between places: of twelve pictures with white noise, medians reach 1.08, and 1.12 with noise that is
# equal in all channels; of two exposures that are blended they are 1.25 to 2.4.
MIN_RATIO = 1.25

# Difference of the covariances of the finest two scales, of the smaller one, above which neighbours share noise: that
# of readings of white noise is 0.29 at most, and that of filtered noise 1 or more, but for mosaics.
MIN_DIFFERENCE_OF_SCALES = 0.35

# Correlation of channels above which they share noise: that of readings of independent noise is up to 0.1, and 0.2
# where they are uncertain.
MIN_CORRELATION = 0.2

# Share of the samples that a level must have to count, and of the neighbourhoods that must be quieter, and noisier.
_MIN_SHARE_OF_LEVEL = 0.05
_MIN_SHARE_OF_PLACES = 0.1

# Variance of the quietest places, of the mean, so that it can be divided by.
_LEAST_OF_PLACE = 1e-3

# Power of the share of the energy of even cells that may be noise, by which it is trusted to be noise. With 1, texture
# is taken for white noise, which costs 0.2 dB of PSNR.
_TRUST = 3

# Details whose mean square is as uncertain as the variance that the network reads, by 28 %, or 0.2 of log2 of a
# deviation.
_DETAILS_OF_READING = 26

# Share of the samples of a neighbourhood at a limit, from which on its noise shows to be weaker than it is.
_MAX_SHARE_CUT_OFF = 0.01

# Levels of 8 bits that noise takes, by its deviation, at least: it takes four, and three where half of it is cut off.
_LEVELS_OF_NOISE = 2

# Where values exceed full scale, as in light, this quantile of theirs becomes full scale. Where less than this share of
# them is at least 0, or at most full scale, they are no levels, and are shifted.
_BRIGHT = 0.99


def estimate_noise(
    channels: Float32s,
    where: Neighbourhoods,
    given: GivenNoise | None,
    *,
    varies: bool,
    least: float = 0.0,
    measured: tuple[Float32s, Float64s] | None = None,
    known: NoiseModel | None = None,
) -> NoiseModel:
    """Estimate the noise of channels, as far as it is not given, and stabilise them, in place.

    If it `varies`, its dependence on level and place is estimated, too; the standard deviation that is assumed is at
    least `least`. `measured` is noise given for each sample: relative variances, and sigma by channel. `known` is the
    noise of the surface that the samples are a part of.
    """
    if known is None and measured is None and given is not None and given.is_by_level:
        stabiliser = VarianceStabiliser.of_camera(given.shot, given.read)
        stabiliser.stabilise(channels)
        # The noise of stabilised colours is the same at all levels.
        found = read_noise(channels, where, varies=False, is_there=True).scaled_to(stabiliser.scale)
        return dataclasses.replace(found, stabiliser=stabiliser)
    if known is not None:
        found = known
    elif measured is not None:
        found = _measured(read_noise(channels, where, varies=False), *measured)
    else:
        found = read_noise(channels, where, varies=varies, is_there=given is not None)
        if given is not None:
            found = found.scaled_to(_sigma_of(given))
        elif found.overall < least:
            found = found.scaled_to(least)
    if found.stabiliser is not None:
        found.stabiliser.stabilise(channels)
    return found


def _measured(found: NoiseModel, relative: Float32s, sigma: Float64s) -> NoiseModel:
    """Return noise with the given standard deviations of colours, and other channels as they were found."""
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
    is_there: bool = False,
    weights: Weights | None = None,
) -> NoiseModel:
    """Read the noise of channels on a grid, shape (N, R, C), or of vertices, shape (N, S).

    If it `varies`, it is read as it depends on level and place. Unless it `is_there` for certain, it may be read as
    none. Without weights, those in the package are used.
    """
    weights, count = weights or weights_of(where.kind), len(planes)
    if not where.count:
        return NoiseModel.independent(np.zeros(count))
    together = [list(range(COLOURS))] if count >= COLOURS else []
    alone = [[channel] for channel in range(len(together) * COLOURS, count)]
    readings = [
        _read_channels(planes[own[0] : own[-1] + 1], where, weights, is_there=is_there)
        for own in (*together, *alone)
    ]
    colours = readings[: 1 if together else None]
    stabiliser, by_place = None, None
    if varies and any(own.components.any() for own in colours):
        stabiliser = _by_level(colours) if all(own.are_levels for own in colours) else None
        by_place = _by_place(colours[0], stabiliser)
        if stabiliser is not None and by_place is not None and not _explains(stabiliser, colours[0]):
            stabiliser, by_place = None, _by_place(colours[0], None)
    covariances = np.zeros((SCALES, count, count))
    for own, reading in zip((*together, *alone), readings, strict=True):
        transformed = stabiliser if reading in colours else None
        covariances[:, np.array(own)[:, None], own] = reading.covariances(transformed, by_place)
    relative = None if by_place is None else where.over_samples(by_place)
    model = NoiseModel(_simplified(covariances), stabiliser, relative)
    low, high = np.sqrt(np.mean(np.square([own.interval for own in colours]), axis=0))
    interval = min(float(low), model.overall), max(float(high), model.overall)
    return dataclasses.replace(model, interval=interval)


def _simplified(covariances: Float64s) -> Float64s:
    """Return covariances of one scale where no other differs, and of independent channels where they nearly are."""
    # What filters made of white noise shows in the finest two scales, where there is the least texture.
    fine, coarse = covariances[:2]
    least = min(np.linalg.norm(fine), np.linalg.norm(coarse))
    if np.linalg.norm(coarse - fine) <= MIN_DIFFERENCE_OF_SCALES * least:
        covariances = covariances[:1]
    single = covariance_of_cells(covariances)
    sigma = np.sqrt(np.diag(single))
    is_correlated = np.abs(single) > MIN_CORRELATION * sigma[:, None] * sigma
    np.fill_diagonal(is_correlated, val=False)
    return covariances if is_correlated.any() else covariances * np.eye(len(single))


@dataclass(frozen=True, eq=False)
class _Reading:
    """What the network reads of K channels, one or three."""

    samples: Samples
    components: Float64s  # covariances by scale, shape (SCALES, 3, 3), in steps of 8 bits
    order: Int64s  # of the channels, shape (K,)
    interval: tuple[float, float]
    levels: Float64s  # log2 of the relative deviation by channel and bin, shape (K, LEVEL_BINS)
    blocks: Float64s  # in each bin, shape (K, LEVEL_BINS)
    places: Float64s  # log2 of the relative deviation by neighbourhood, shape (P,)
    full_scale: float
    are_levels: bool

    def covariances(self, stabiliser: VarianceStabiliser | None, by_place: Float64s | None) -> Float64s:
        """Return the covariances of stabilised channels by scale, with what even cells show of them."""
        step, components, samples = self.full_scale / float(STEPS), self.components, self.samples
        if stabiliser is not None:
            components = components * stabiliser.scale**2
            colours = samples.colours * np.float32(step)
            stabiliser.stabilise(colours)
            samples = dataclasses.replace(samples, colours=colours / np.float32(step))
        is_whole = self.samples.cut_off() < _MAX_SHARE_CUT_OFF
        if components.any():
            variances = np.ones(len(is_whole)) if by_place is None else by_place
            components = _combined(components, *even_covariances(samples.cells(), is_whole, variances))
        mixing = COMPONENTS.astype(np.float64)[:, self.order] * step
        return np.asarray(np.einsum("kc,lkm,md->lcd", mixing, components, mixing), np.float64)


def _combined(components: Float64s, measured: Float64s, counts: Float64s) -> Float64s:
    """Return what the network reads of the covariance of components, and what even cells have, weighted.

    Plain colours show the noise more exactly than it is read. The more details even cells have, the more certain it is.
    The more their energy exceeds what the network reads, the more texture is in it.
    """
    shares = _shares_of_noise(*(np.einsum("lkk->lk", own) for own in (components, measured)))
    shares *= (counts / (counts + _DETAILS_OF_READING))[:, None]
    found = np.zeros_like(components)
    for share, own in ((shares, measured), (1 - shares, components)):
        found += own * np.sqrt(share[:, :, None] * share[:, None])
    return found


def _shares_of_noise(variances: Float64s, energies: Float64s) -> Float64s:
    """Return how far energies are trusted to be noise that the network reads as variances."""
    most = np.maximum(np.maximum(variances, energies), np.finfo(np.float64).tiny)
    return np.asarray((variances / most) ** _TRUST, np.float64)


def _read_channels(planes: Float32s, where: Neighbourhoods, weights: Weights, *, is_there: bool) -> _Reading:
    """Read the noise of three channels, or of one as three that are the same."""
    samples = where.cut(np.broadcast_to(planes, (COLOURS, *planes.shape[1:])))
    samples, scale, are_levels = _in_full_scale(samples)
    cells, blocks, start = samples.cells(), samples.blocks(), np.zeros(1, np.int64)
    even, described = features.describe_even_cells(cells)[None], features.describe(samples.described(), cells)
    levels = features.describe_levels(blocks)
    outputs = read(
        Layers(weights.layers),
        weights.standardised("squares", described),
        start,
        weights.standardised("even", even),
        weights.standardised("levels", levels),
    )
    quiet = quiet_of(described, where.kind)
    found = readings(outputs, candidates_of(even, quiet, start, levels, where.kind))
    order, step = np.argsort(samples.order)[: len(planes)], scale / float(STEPS)
    low, _, median, high = (deviation_of(own) for own in np.sort(found["total"][0]))
    least = median if is_there else low  # noise that is not given may be invisible
    if not is_there and _count_levels(samples.colours) < _LEVELS_OF_NOISE * median:
        least = 0.0
    bins = [np.bincount(features.level_bins(own), minlength=LEVEL_BINS) for own in blocks.levels]
    return _Reading(
        samples,
        _components(found) * (median if least >= INVISIBLE else 0.0) ** 2,
        order,
        (low * step, high * step),
        _medians(found["levels"].reshape(COLOURS, LEVEL_BINS, -1))[order],
        np.array(bins, np.float64)[order],
        _medians(found["places"]),
        scale,
        are_levels,
    )


def _count_levels(colours: Float32s) -> float:
    """Return how many levels the channels have at most; infinite for grey, which may be shares of a few rays."""
    if (colours == colours[0]).all():
        return np.inf
    return max(int(np.count_nonzero(np.bincount(np.rint(own).astype(np.uint8)))) for own in colours)


def _medians(quantiles: Array) -> Float64s:
    return np.sort(quantiles, axis=-1)[..., QUANTILES.index(0.5)].astype(np.float64)


def _in_full_scale(samples: Samples) -> tuple[Samples, float, bool]:
    """Return colours from 0 to 1, what full scale was, and whether they are levels, which begin between 0 and 1."""
    values = samples.colours / STEPS
    low, high = np.quantile(values, (1 - _BRIGHT, _BRIGHT))
    shift = 0.0 if 0 <= low <= 1 else float(low)
    scale = max(1.0, float(high) - shift) if values.max(initial=0) > 1 + shift else 1.0
    if shift == 0 and scale == 1:
        return samples, scale, True
    values = (values - np.float32(shift)) * (STEPS / np.float32(scale))
    # What lies beyond is seldom noise: single samples there must not hide that of all others.
    return dataclasses.replace(samples, colours=values.clip(0, STEPS)), scale, shift == 0


def deviation_of(logarithm: Array | float) -> float:
    """Return the deviation, in steps of 8 bits, by what the network reads of it."""
    return max(0.0, float(2**logarithm) - OFFSET)


def _components(found: dict[str, Array]) -> Float64s:
    """Return the covariances of components by scale, of channels with a root mean square noise of 1."""
    medians = _medians(found["deviations"].reshape(SCALES, COLOURS, len(QUANTILES)))
    deviations = np.maximum(2.0**medians - OFFSET, 1e-3)
    correlations = np.tanh(found["correlations"].reshape(SCALES, COLOURS).astype(np.float64))
    mixed = np.stack([np.eye(COLOURS)] * SCALES)
    for number, (one, other) in enumerate(((0, 1), (0, 2), (1, 2))):
        mixed[:, one, other] = mixed[:, other, one] = correlations[:, number]
    values, vectors = np.linalg.eigh(mixed * deviations[:, :, None] * deviations[:, None])
    roots = vectors * np.sqrt(np.maximum(values, 0))[:, None]
    covariances: Float64s = np.einsum("lkm,ljm->lkj", roots, roots)
    return covariances * COLOURS / max(1e-12, float(np.trace(covariance_of_cells(covariances))))


def _by_level(readings: Sequence[_Reading]) -> VarianceStabiliser | None:
    """Return what makes the noise the same at all levels, if it differs by more than is read of noise that does not."""
    logs, blocks = (
        np.concatenate(own)
        for own in zip(*((reading.levels, reading.blocks) for reading in readings), strict=True)
    )
    middles = np.arange(LEVEL_BINS) + 0.5
    counted = blocks >= _MIN_SHARE_OF_LEVEL * blocks.sum(axis=1, keepdims=True)
    logs = np.stack(
        [np.interp(middles, middles[own], log[own]) for log, own in zip(logs, counted, strict=True)]
    )
    # Channels have much in common here, and their mean is less uncertain.
    mean, seen = np.average(logs, axis=0, weights=blocks + 1e-9), blocks.sum(axis=0)
    if np.ptp(mean[seen >= _MIN_SHARE_OF_LEVEL * seen.sum()]) < np.log2(MIN_RATIO):
        return None
    variances = 4.0**logs
    blocks /= blocks.sum(axis=1, keepdims=True)
    variances /= (variances * blocks).sum(axis=1, keepdims=True)
    relative = np.sqrt(np.average(variances, axis=0, weights=blocks + 1e-9))
    scale = readings[0].full_scale
    return VarianceStabiliser(scale * middles / LEVEL_BINS, relative, blocks.sum(axis=0), scale)


def _explains(stabiliser: VarianceStabiliser, reading: _Reading) -> bool:
    """Whether the level explains most of the variance between neighbourhoods."""
    return bool(2 * np.var(reading.places - _logs_of_level(reading, stabiliser)) < np.var(reading.places))


def _logs_of_level(reading: _Reading, stabiliser: VarianceStabiliser) -> Float64s:
    """Return log2 of the deviations of neighbourhoods that their levels would have."""
    levels = reading.samples.levels[reading.order].T * (reading.full_scale / STEPS)
    return np.asarray(np.log2(stabiliser.sigma_at(levels, stabiliser.scale)).mean(axis=1), np.float64)


def _by_place(reading: _Reading, stabiliser: VarianceStabiliser | None) -> Float64s | None:
    """Return the relative variances of neighbourhoods, if they differ more than is read of noise that does not."""
    # What the level explains is no difference of places.
    of_level = np.zeros(len(reading.places)) if stabiliser is None else _logs_of_level(reading, stabiliser)
    logs, where = reading.places - of_level, reading.samples.where
    around = where.medians_around(logs)
    low, high = np.quantile(around, (_MIN_SHARE_OF_PLACES, 1 - _MIN_SHARE_OF_PLACES))
    if high - low <= np.log2(MIN_RATIO):
        return None
    variances = 4.0**logs
    if where.kind == "grid":
        variances *= np.trace(reading.components[0]) / COLOURS / variances.mean()
        # Channels that are the same have no differences, which would be the quietest component.
        in_mean, *in_differences = np.diag(reading.components[0])
        channels = 1 if max(in_differences) < _LEAST_OF_PLACE * in_mean else len(reading.order)
        energies = quiet_energies(reading.samples, channels) / 4.0**of_level
        # Where noise was cut off, squares show less than there is.
        is_known = np.isfinite(energies) & (reading.samples.cut_off() < _MAX_SHARE_CUT_OFF)
        shares = np.where(is_known, _shares_of_noise(variances, energies), 0)
        variances = np.where(is_known, shares * energies, 0) + (1 - shares) * variances
    variances = np.maximum(variances, _LEAST_OF_PLACE * variances.mean())
    return np.asarray(variances / variances.mean(), np.float64)
