"""The noise of colours as the trained network reads it: its covariance by scale, by level and by place.

`estimate_noise` is a pure function: the same colours give the same `NoiseModel`, to the last bit. It reads at most
`MAX_SQUARES` squares, so that its cost does not grow with the picture.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

import features
from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int64s
from beltrami_cli.flow.noise.haar_noise import covariance_of_cells, root_of, sigma_of_covariances
from beltrami_cli.flow.noise.stabilising import VarianceStabiliser
from features import COMPONENTS, LEVEL_BINS, SCALES, SIDE, STEPS
from network import (
    OFFSET,
    QUANTILES,
    Layers,
    Weights,
    read,
    weights_of_grids,
)

# Channels that are read together; all others are read one by one.
COLOURS = 3

# Noise below this deviation, in steps of 8 bits, is invisible: it is less than that of rounding.
INVISIBLE = 0.29

# Ratio of deviations between levels, and between places, above which they differ.
MIN_RATIO_OF_LEVELS = 1.3
MIN_RATIO_OF_PLACES = 1.6

# Share of the samples that a level must have to count, and of the squares that must be quieter, and noisier.
_MIN_SHARE_OF_LEVEL = 0.02
_MIN_SHARE_OF_PLACES = 0.1

# Standard deviations of a normal variable between the quantiles that are read.
_BETWEEN_QUANTILES = 2 * 1.645

# Where values exceed full scale, as in light, this quantile of theirs becomes full scale. Where less than this share of
# them is at least 0, they are no levels, and are shifted.
_BRIGHT = 0.99


@dataclass(frozen=True)
class Grid:
    """Neighbourhoods of cells on a grid: squares of the cells that are filled, shape (R, C)."""

    filled: Bools


@dataclass(frozen=True)
class Given:
    """What is known of the colours beforehand."""

    full_scale: float = 1.0
    sigma: float | None = None  # of the noise, to which its model is scaled


@dataclass(frozen=True)
class ByLevel:
    """The deviation of the noise of each channel by the level of the colours, relative to its root mean square."""

    levels: Float64s  # ascending, shape (G,)
    relative: Float64s  # shape (N, G)
    samples: Float64s  # how many samples of each channel have the level, relative, shape (N, G)


@dataclass(frozen=True)
class ByPlace:
    """The variance of the noise in squares of cells, relative to its mean."""

    centres: Float64s  # row and column, shape (P, 2)
    variances: Float64s  # shape (P,)

    def over_cells(self, shape: tuple[int, int]) -> Float32s:
        """Return the relative variance at each cell: that of the nearest square."""
        from scipy.spatial import cKDTree  # which takes long to be imported

        rows, columns = (np.arange(0, size, SIDE) for size in shape)
        places = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2) + SIDE / 2
        nearest = cKDTree(self.centres).query(places)[1].reshape(len(rows), len(columns))
        coarse = self.variances[nearest].astype(np.float32)
        return np.repeat(np.repeat(coarse, SIDE, axis=0), SIDE, axis=1)[: shape[0], : shape[1]]


@dataclass(frozen=True)
class NoiseModel:
    """The noise of N channels; deviations are of full scale 1, or the scale of the colours."""

    covariances: Float64s  # of the Haar details, by scale, shape (SCALES, N, N); see `haar_noise`
    interval: tuple[float, float]  # 90 % interval of the root mean square of the noise of the colours
    uncertainty: Float64s  # standard deviation of log2 of the deviations, by scale, shape (SCALES,)
    by_level: ByLevel | None = None  # None: the same at all levels
    by_place: ByPlace | None = None  # None: the same everywhere

    @property
    def sigma(self) -> Float64s:
        """The deviation of each channel."""
        return sigma_of_covariances(self.covariances)

    @property
    def covariance(self) -> Float64s:
        """The covariance of the channels of single samples, shape (N, N)."""
        return covariance_of_cells(self.covariances)

    @property
    def overall(self) -> float:
        """The root mean square of the noise of the colours."""
        return float(
            np.sqrt(np.mean(np.square(self.sigma[:COLOURS] if len(self.sigma) >= COLOURS else self.sigma)))
        )

    @property
    def is_none(self) -> bool:
        """Whether there is no noise."""
        return not self.covariances.any()

    def scaled_to(self, sigma: float) -> NoiseModel:
        """Return a model of the same structure whose colours have a root mean square noise of `sigma`.

        Where no noise was found, it is independent, and the same in all channels.
        """
        if self.is_none:
            same = np.broadcast_to(sigma**2 * np.eye(len(self.sigma)), self.covariances.shape).copy()
            return dataclasses.replace(self, covariances=same, interval=(sigma, sigma))
        factor = sigma / self.overall
        return dataclasses.replace(self, covariances=factor**2 * self.covariances, interval=(sigma, sigma))

    def stabiliser(self) -> VarianceStabiliser | None:
        """Return what makes the noise the same at all levels; None if it is."""
        if self.by_level is None:
            return None
        samples = self.by_level.samples.sum(axis=0)
        weights = np.maximum(self.by_level.samples, 1e-9)
        relative = np.sqrt(np.average(np.square(self.by_level.relative), axis=0, weights=weights))
        return VarianceStabiliser(self.by_level.levels, relative, samples)

    def root(self, scale: int) -> Float32s:
        """Return the symmetric root of the covariance at a scale, to draw noise by."""
        return root_of(self.covariances[scale])


def estimate_noise(
    planes: Float32s, neighbourhoods: Grid, given: Given | None = None, weights: Weights | None = None
) -> NoiseModel:
    """Estimate the noise of channels on a grid, shape (N, R, C); by the weights in the package, if none are given."""
    given, weights = given or Given(), weights or weights_of_grids()
    filled, count = neighbourhoods.filled, len(planes)
    corners = features.choose_corners(filled)
    covariances = np.zeros((SCALES, count, count))
    if not len(corners):
        return NoiseModel(covariances, (0.0, 0.0), np.zeros(SCALES))
    together = [list(range(COLOURS))] if count >= COLOURS else []
    alone = [[channel] for channel in range(len(together) * COLOURS, count)]
    readings = [_read_channels(planes[own], filled, corners, given, weights) for own in (*together, *alone)]
    for own, reading in zip((*together, *alone), readings, strict=True):
        covariances[:, np.array(own)[:, None], own] = reading.covariances
    colours = readings[: 1 if together else None]
    low, high = (float(np.sqrt(np.mean([own.interval[end] ** 2 for own in colours]))) for end in (0, 1))
    uncertainty = np.max([own.uncertainty for own in colours], axis=0)
    model = NoiseModel(covariances, (low, high), uncertainty)
    if not model.is_none:
        by_level = _by_level(readings) if all(own.are_levels for own in readings) else None
        model = dataclasses.replace(
            model, by_level=by_level, by_place=_by_place(readings[0], corners, by_level)
        )
    return model if given.sigma is None else model.scaled_to(given.sigma)


@dataclass(frozen=True)
class _Reading:
    """What the network says of one or three channels."""

    covariances: Float64s
    interval: tuple[float, float]
    uncertainty: Float64s
    levels: (
        Float64s  # quantiles of log2 of the relative deviation by channel and bin, shape (K, LEVEL_BINS, 3)
    )
    samples: Float64s  # blocks in each bin, shape (K, LEVEL_BINS)
    places: Float64s  # quantiles of log2 of the relative deviation by square, shape (P, 3)
    square_levels: Float64s  # mean level of the squares, by channel, shape (P, K)
    scale: float
    are_levels: bool


def _read_channels(
    planes: Float32s, filled: Bools, corners: Int64s, given: Given, weights: Weights
) -> _Reading:
    """Read the noise of three channels, or of one as three that are the same."""
    count = len(planes)
    squares = features.cut_squares(np.broadcast_to(planes, (COLOURS, *planes.shape[1:])), filled, corners)
    squares, scale, are_levels = _in_full_scale(squares, given.full_scale)
    details = squares.details()
    described = features.describe(squares, details)
    blocks = features.blocks_of(squares, details)
    found = _read(weights, described, features.describe_even_cells(details), blocks)
    back = np.argsort(squares.order)
    total = np.sort(found["total"][0])
    covariances = _covariances(found, back) * _strength_of(total) ** 2
    if count == 1:
        covariances, back = covariances[:, :1, :1], back[:1]
    spread = found["deviations"].reshape(SCALES, COLOURS, len(QUANTILES))
    filled_cells = np.maximum(squares.is_filled.sum(axis=(1, 2)), 1)[:, None]
    levels = squares.colours.sum(axis=(2, 3), where=squares.is_filled[:, None]) / filled_cells / STEPS
    bins = [np.bincount(features.level_bins(own), minlength=LEVEL_BINS) for own in blocks.levels]
    return _Reading(
        covariances * (scale / STEPS) ** 2,
        (deviation_of(total[0]) * scale / float(STEPS), deviation_of(total[-1]) * scale / float(STEPS)),
        np.ptp(spread, axis=2).min(axis=1) / _BETWEEN_QUANTILES,
        np.sort(found["levels"].reshape(COLOURS, LEVEL_BINS, -1), axis=2)[back].astype(np.float64),
        np.array(bins, np.float64)[back],
        np.sort(found["places"], axis=1).astype(np.float64),
        levels[:, back].astype(np.float64),
        scale,
        are_levels,
    )


def _read(
    weights: Weights, described: Float32s, even: Float32s, blocks: features.Blocks
) -> dict[str, Float32s]:
    return read(
        Layers(weights.layers),
        weights.standardised("squares", described),
        np.zeros(1, np.int64),
        weights.standardised("even", even[None]),
        weights.standardised("levels", features.describe_levels(blocks)),
    )


def _in_full_scale(squares: features.Squares, full_scale: float) -> tuple[features.Squares, float, bool]:
    """Return colours from 0 to 1, what full scale was, and whether they are levels, which are not below 0."""
    filled = np.broadcast_to(squares.is_filled[:, None], squares.colours.shape)
    low, high = np.quantile(squares.colours[filled] / STEPS, (1 - _BRIGHT, _BRIGHT))
    shift, scale = min(0.0, float(low)), full_scale
    if squares.colours.max(where=filled, initial=0) > (full_scale + shift) * STEPS:
        scale = max(full_scale, float(high) - shift)
    if shift == 0 and scale == 1:
        return squares, scale, True
    colours = np.where(filled, (squares.colours - np.float32(shift) * STEPS) / np.float32(scale), 0)
    return dataclasses.replace(squares, colours=colours.astype(np.float32)), scale, shift == 0


def deviation_of(logarithm: Array | float) -> float:
    """Return the deviation, in steps of 8 bits, by what the network reads of it."""
    return max(0.0, float(2**logarithm) - OFFSET)


def _strength_of(quantiles: Float32s) -> float:
    """Return the deviation to reckon with: the median; or a smaller quantile where noise may be invisible."""
    least, smaller, median, _ = (deviation_of(own) for own in quantiles)
    reading = smaller if least < INVISIBLE else median
    return 0.0 if reading < INVISIBLE else reading


def _covariances(found: dict[str, Float32s], back: Int64s) -> Float64s:
    """Return the covariances of channels by scale, of a root mean square noise of 1."""
    medians = found["deviations"].reshape(SCALES, COLOURS, len(QUANTILES))[..., QUANTILES.index(0.5)]
    deviations = np.maximum(2.0 ** medians.astype(np.float64) - OFFSET, 1e-3)
    correlations = np.tanh(found["correlations"].reshape(SCALES, COLOURS).astype(np.float64))
    mixed = np.stack([np.eye(COLOURS)] * SCALES)
    for number, (one, other) in enumerate(((0, 1), (0, 2), (1, 2))):
        mixed[:, one, other] = mixed[:, other, one] = correlations[:, number]
    values, vectors = np.linalg.eigh(mixed * deviations[:, :, None] * deviations[:, None])
    mixing = COMPONENTS.astype(np.float64)
    roots = np.einsum("kc,lkm->lcm", mixing, vectors) * np.sqrt(np.maximum(values, 0))[:, None]
    channels = np.einsum("lcm,ldm->lcd", roots, roots)[:, back[:, None], back]
    return np.asarray(channels / max(1e-12, np.trace(covariance_of_cells(channels)) / COLOURS), np.float64)


def _by_level(readings: Sequence[_Reading]) -> ByLevel | None:
    """Return how noise depends on the level, if it does so by more than noise that does not is read."""
    middle = QUANTILES.index(0.5)
    logs = np.concatenate([own.levels[..., middle] for own in readings])
    samples = np.concatenate([own.samples for own in readings])
    counted = samples >= _MIN_SHARE_OF_LEVEL * samples.sum(axis=1, keepdims=True)
    middles = np.arange(LEVEL_BINS) + 0.5
    logs = np.stack(
        [np.interp(middles, middles[used], own[used]) for own, used in zip(logs, counted, strict=True)]
    )
    # Channels have much in common here, and their mean is less uncertain.
    if np.ptp(np.average(logs, axis=0, weights=samples + 1e-9)) < np.log2(MIN_RATIO_OF_LEVELS):
        return None
    relative = 2.0**logs
    relative /= np.sqrt(np.average(relative**2, axis=1, weights=samples, keepdims=True))
    levels = readings[0].scale * middles / LEVEL_BINS
    return ByLevel(levels, relative, samples / samples.sum(axis=1, keepdims=True))


def _by_place(reading: _Reading, corners: Int64s, by_level: ByLevel | None) -> ByPlace | None:
    """Return how noise differs from square to square, if it does so by more than noise that does not is read."""
    logs = reading.places[:, QUANTILES.index(0.5)]
    if by_level is not None:  # what the level explains is no difference of places
        explained = [
            np.interp(levels * reading.scale, by_level.levels, np.log2(relative))
            for relative, levels in zip(by_level.relative, reading.square_levels.T, strict=False)
        ]
        logs = logs - np.mean(explained, axis=0)
    low, high = np.quantile(logs, (_MIN_SHARE_OF_PLACES, 1 - _MIN_SHARE_OF_PLACES))
    if high - low < np.log2(MIN_RATIO_OF_PLACES):
        return None
    variances = 4.0**logs
    return ByPlace(corners + SIDE / 2, variances / variances.mean())
