"""Outliers: fireflies, salt and pepper, dead texels.

An outlier differs far more from its neighbours on the surface than noise does, alone or in a small clump. So do stars,
rivets, and the dots of dither and of the letter i. Their distribution distinguishes them. Outliers are spread at
random over all colours, and have one value or, as fireflies, are far brighter than the light around. Drawn detail
repeats, belongs to larger shapes, has many values, or lies on a plain ground.

Outliers are filled with the median of the neighbours that are not outliers, before anything else reads the colours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int64s
from beltrami_cli.flow.corrections.clumps import small_clumps
from beltrami_cli.flow.corrections.comparison import ColouredSamples, Compared, Surroundings, medians_of
from beltrami_cli.flow.corrections.spread import are_spread_at_random
from beltrami_cli.flow.manifolds.stabilised_colours import Outliers
from beltrami_cli.flow.noise_amount import COLOURS
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.surface import large_arrays

# By benchmarks/bench_outliers.py: at most 1 of 194 images of games and scikit-image is changed with any of the values
# in brackets. "Missed" and "false": shares of pixels set to black, white or red, with and without noise of 10 of 255.
#
# A sample stands out by so many deviations of its neighbours plus a share of the range of all colours. Missed with
# 2.5, 3, 4 and 5 deviations: 2.3, 2.8, 7.2 and 11 %; with shares of 0.07 and 0.15: 2.5 and 5.9 %.
_MIN_DEVIATIONS, _MIN_SHARE_OF_RANGE = 3.0, 0.1

# The same, as a share of that, for samples of a value that outliers have. Missed and false with 1/5, 1/3 and 1/2 at 4
# deviations: 8.1 and 0.05, 9.5 and 0.01, 13 and 0 %.
_WEAK_LIMIT = 1 / 3

# Share of the range within which values count as one; and share of the contrast within which a ground is plain
# [0.03, 0.12].
_SAME_VALUE = 0.06

# Clumps from which on their spread can be judged [10, 30].
_MIN_CLUMPS = 16

# Share of the clumps that must have one value, of samples of it in small clumps, and of clumps that stand out little.
_MAJORITY = 2 / 3

# Share of light that may be fireflies. With a gamma distribution of shape 0.05, 9 % of samples hold 80 % of the light.
_MAX_FIREFLIES = 0.02


@dataclass(frozen=True)
class _Candidates:
    """Samples that stand out by their contrasts: all of them brighter than the samples around, or all darker."""

    compared: Compared
    contrasts: Float32s  # magnitudes in units of the threshold, above 1
    sign: int  # 1: brighter, -1: darker
    clumps: Int64s  # the small isolated clump that each sample belongs to; -1: none

    def __getitem__(self, rows: Array) -> _Candidates:
        return _Candidates(self.compared[rows], self.contrasts[rows], self.sign, self.clumps[rows])

    def __len__(self) -> int:
        return len(self.contrasts)

    @property
    def isolated(self) -> _Candidates:
        """The samples in small isolated clumps."""
        return self[self.clumps >= 0]

    @property
    def strongest(self) -> _Candidates:
        """The sample of the highest contrast in each small isolated clump."""
        order = np.lexsort((-self.contrasts, self.clumps))
        return self[order[np.diff(self.clumps[order], prepend=-1) > 0]]

    def is_near(self, value: Float32s, tolerance: float) -> Bools:
        return np.asarray(_distances(self.compared.colours, value) <= tolerance)


def fill_outliers(
    planes: Float32s, surroundings: Surroundings, parameters: KernelParameters, *, is_light: bool
) -> tuple[Float32s, Outliers | None]:
    """Find the outliers of colours, shape (N, ...), and fill them; without outliers the same array is returned."""
    outliers = _find_outliers(planes, surroundings, parameters, is_light=is_light)
    if outliers is None:
        return planes, None
    filled = ColouredSamples(large_arrays.copy_of(planes), surroundings)
    _fill_in_place(filled, np.asarray(surroundings.samples)[outliers.samples], outliers.channels.T)
    return filled.planes, outliers


def _find_outliers(
    planes: Float32s, surroundings: Surroundings, parameters: KernelParameters, *, is_light: bool
) -> Outliers | None:
    surface, takes_all = ColouredSamples(planes, surroundings), parameters.outliers == "replace"
    if surface.count < _MIN_CLUMPS or not parameters.looks_for_outliers:
        return None
    some = np.linspace(0, surface.count - 1, min(surface.count, 256 * _MIN_CLUMPS)).astype(int)
    sampled = surface.compared(surroundings.samples[some])
    ranges = _ranges(sampled.colours)
    # Noise alone seldom makes a sample differ that much from most neighbours.
    least = _MIN_SHARE_OF_RANGE * ranges + _MIN_DEVIATIONS / 2 * np.median(sampled.deviations, axis=1)
    standing_out = surroundings.standing_out(planes, np.where(ranges > 0, least, np.inf).astype(np.float32))
    if len(standing_out) < (1 if takes_all else _MIN_CLUMPS):
        return None
    rows = surface.compared(standing_out)

    def outliers_of(channels: slice) -> Int64s:
        search = _Search(
            surface.of_channels(channels), sampled.of_channels(channels), float(ranges[channels][0]),
            takes_all=takes_all, is_light=is_light,
        )  # fmt: skip
        return search.outliers_in(rows.of_channels(channels))

    # Search all colour channels together first, then each channel.
    groups = [slice(channel, channel + 1) for channel in range(len(planes))]
    if len(planes) >= COLOURS and len(of_colours := outliers_of(slice(COLOURS))):
        found = [(slice(COLOURS), of_colours), *((group, outliers_of(group)) for group in groups[COLOURS:])]
    else:
        found = [(group, outliers_of(group)) for group in groups]
    return _outliers_by_channel(surface, found)


def _outliers_by_channel(surface: ColouredSamples, found: Sequence[tuple[slice, Int64s]]) -> Outliers | None:
    """Combine the samples that are outliers of some channels; None if there are none."""
    samples = np.unique(np.concatenate([wrong for _, wrong in found]))
    if not len(samples):
        return None
    channels = np.zeros((len(samples), len(surface.planes)), bool)
    for group, wrong in found:
        channels[np.searchsorted(samples, wrong), group] = True
    rows = np.searchsorted(surface.surroundings.samples, samples)
    return Outliers(rows, channels, surface.at(samples).T, len(samples) / surface.count)


def _ranges(colours: Float32s) -> Float64s:
    """Return the range of each channel, common to colours; constant channels get a share of their magnitude."""
    low, high = np.quantile(colours, (0.01, 0.99), axis=1)
    ranges = np.maximum(high - low, _MIN_SHARE_OF_RANGE * np.maximum(np.abs(low), np.abs(high)))
    if len(ranges) >= COLOURS:
        ranges[:COLOURS] = ranges[:COLOURS].max()
    return np.asarray(ranges, np.float64)


@dataclass(frozen=True)
class _Search:
    """Search for outliers in colours; the `sampled` rows represent all samples."""

    surface: ColouredSamples
    sampled: Compared
    colour_range: float
    takes_all: bool  # isolated samples that stand out, however they are distributed
    is_light: bool

    def outliers_in(self, rows: Compared) -> Int64s:
        """Return the outliers among rows that stand out."""
        if not self.colour_range > 0:
            return rows.samples[:0]
        contrasts = _contrasts(rows.colours, rows, self.colour_range)
        dark, bright = (self._outliers_among(self._candidates(rows, contrasts, sign)) for sign in (-1, 1))
        return np.union1d(dark, bright)

    def _candidates(self, rows: Compared, contrasts: Float32s, sign: int) -> _Candidates:
        # Bright light needs twice the contrast, since its noise has a longer tail.
        contrasts = sign * contrasts / np.float32(2 if self.is_light and sign > 0 else 1)
        rows, contrasts = rows[contrasts > 1], contrasts[contrasts > 1]
        clumps = small_clumps(self.surface, rows.samples, _distances(rows.colours, rows.medians) / 2)
        return _Candidates(rows, contrasts, sign, clumps)

    def _outliers_among(self, candidates: _Candidates) -> Int64s:
        if self.takes_all or self._are_fireflies(candidates):
            return candidates.isolated.compared.samples
        return self._with_common_value(candidates)

    def _are_fireflies(self, candidates: _Candidates) -> bool:
        if not (self.is_light and candidates.sign > 0):
            return False
        # With few light paths, nearly all light is in single samples, which are not outliers.
        count = len(candidates.isolated)
        is_rare = _MAJORITY * len(candidates) <= count < _MAX_FIREFLIES * self.surface.count
        return is_rare and self._are_random(candidates.strongest, np.ones(len(self.sampled.samples), bool))

    def _with_common_value(self, candidates: _Candidates) -> Int64s:
        """Return the outliers that have the most frequent value, if they are spread at random."""
        strongest, none = candidates.strongest, np.zeros(0, np.int64)
        tolerance = _SAME_VALUE * self.colour_range
        if len(strongest) < _MIN_CLUMPS:
            return none
        value = _frequent_value(strongest.compared.colours, tolerance)
        chosen = strongest[strongest.is_near(value, tolerance)]
        if len(chosen) < max(_MIN_CLUMPS, _MAJORITY * len(strongest)):
            return none
        of_value = candidates[candidates.is_near(value, tolerance)]
        if len(of_value.isolated) < _MAJORITY * len(of_value) or _is_on_plain_ground(chosen.compared):
            return none
        is_visible = candidates.sign * _contrasts(value, self.sampled, self.colour_range) > 1
        if not self._are_random(chosen, np.asarray(is_visible)):
            return none
        # Noise added after the outliers spreads their value.
        spread = np.quantile(_distances(chosen.compared.colours, value), 0.95)
        return self._samples_of_value(value, float(spread))

    def _samples_of_value(self, value: Float32s, spread: float) -> Int64s:
        """Return isolated samples of a value, with a lower threshold of contrast."""
        surface, parts = self.surface, [np.zeros(0, np.int64)]
        for block in large_arrays.blocks(surface.count, large_arrays.CACHED):
            samples = np.asarray(surface.surroundings.samples[block], np.int64)
            rows = surface.compared(samples[_distances(surface.at(samples), value) <= spread])
            contrasts = _contrasts(rows.colours, rows, self.colour_range)
            parts.append(rows.samples[np.abs(contrasts) > _WEAK_LIMIT])
        samples = np.concatenate(parts)
        return samples[small_clumps(surface, samples, np.full(len(samples), spread)) >= 0]

    def _are_random(self, chosen: _Candidates, is_visible: Bools) -> bool:
        """Whether candidates are spread at random over the samples on which they would be visible, `is_visible`."""
        # If most contrasts are near the threshold, these are the tails of texture or noise.
        if len(chosen) < _MIN_CLUMPS or np.mean(chosen.contrasts < 2) > _MAJORITY or not is_visible.any():
            return False
        return are_spread_at_random(self.surface, chosen.compared, self.sampled, is_visible)


def _contrasts(colours: Float32s, compared: Compared, colour_range: float) -> Float32s:
    """Return the largest signed difference of colours to medians, shape (C,), in units of the threshold.

    A single colour, shape (N,), is compared with all medians.
    """
    away = colours.reshape(len(colours), -1) - compared.medians
    away /= np.float32(_MIN_DEVIATIONS) * compared.deviations + np.float32(_MIN_SHARE_OF_RANGE * colour_range)
    return np.asarray(np.take_along_axis(away, np.abs(away).argmax(axis=0)[None], axis=0)[0], np.float32)


def _distances(colours: Float32s, others: Float32s) -> Float32s:
    """Return the largest difference over channels, shape (C,), of colours to others, or to a single one."""
    return np.asarray(np.abs(colours - others.reshape(len(colours), -1)).max(axis=0))


def _frequent_value(colours: Float32s, tolerance: float) -> Float32s:
    value = np.median(colours, axis=1)
    for _ in range(2):  # the second time without other values
        is_near = _distances(colours, value) <= tolerance
        value = np.median(colours[:, is_near], axis=1) if is_near.any() else value
    return np.asarray(value, np.float32)


def _is_on_plain_ground(rows: Compared) -> bool:
    """Whether the colours around samples are almost equal. There, samples of one value may be a pattern."""
    contrast = np.median(_distances(rows.colours, rows.medians))
    return bool(rows.medians.std(axis=1).max() < _SAME_VALUE * contrast)


def _fill_in_place(surface: ColouredSamples, samples: Int64s, wrong: Bools) -> None:
    """Fill wrong samples with the median of the others within one step, or two if there are too few."""
    flat, filled = surface.planes.reshape(len(surface.planes), -1), surface.at(samples)
    for channel, is_wrong in zip(flat, wrong, strict=True):
        channel[samples[is_wrong]] = np.nan
    for block in large_arrays.blocks(len(samples), large_arrays.SCATTERED):
        for reach, fewest in ((2, 1), (1, 3)):
            medians, count = medians_of(surface.colours_around(samples[block], reach))
            np.copyto(filled[:, block], medians, where=wrong[:, block] & (count >= fewest))
    for channel, is_wrong, values in zip(flat, wrong, filled, strict=True):
        channel[samples[is_wrong]] = values[is_wrong]
