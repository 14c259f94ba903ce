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
from typing import Protocol

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Indices, Int64s
from beltrami_cli.flow.manifolds.manifold import Outliers
from beltrami_cli.flow.noise.stabiliser import COLOURS
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


class Surroundings(Protocol):
    """The samples of a surface, by their indices in a stack, and their neighbours."""

    @property
    def samples(self) -> Indices:
        """Indices of all samples in a stack, ascending, shape (S,)."""

    def around(self, samples: Indices, reach: int) -> Int64s:
        """Return the samples within `reach` (one or two) steps of each sample, shape (B, W), padded by -1."""

    def standing_out(self, planes: Float32s, least: Float32s) -> Indices:
        """Return the samples that differ from most neighbours by more than `least`, shape (N,), in a channel."""


@dataclass(frozen=True)
class _Compared:
    """Samples with their colours, and the median and deviation of the colours around them, shape (N, C)."""

    samples: Int64s
    colours: Float32s
    medians: Float32s
    deviations: Float32s

    def __getitem__(self, rows: Array) -> _Compared:
        return _Compared(
            self.samples[rows], *(each[:, rows] for each in (self.colours, self.medians, self.deviations))
        )

    def of_channels(self, channels: slice) -> _Compared:
        return _Compared(
            self.samples, self.colours[channels], self.medians[channels], self.deviations[channels]
        )

    def contrasts(self, size: float, value: Float32s | None = None) -> Float32s:
        """Return the signed differences of colours, or of a value, to the medians by the threshold, shape (C,).

        `size` is the range of all colours.
        """
        away = (self.colours if value is None else value) - self.medians
        away /= np.float32(_MIN_DEVIATIONS) * self.deviations + np.float32(_MIN_SHARE_OF_RANGE * size)
        return np.asarray(np.take_along_axis(away, np.abs(away).argmax(axis=0)[None], axis=0)[0], np.float32)


@dataclass(frozen=True)
class _Surface:
    """Colours, shape (N, ...), and the neighbours of their samples."""

    planes: Float32s
    surroundings: Surroundings

    @property
    def count(self) -> int:
        return len(self.surroundings.samples)

    def at(self, samples: Indices) -> Float32s:
        return self.planes.reshape(len(self.planes), -1)[:, samples]

    def around(self, samples: Indices, reach: int) -> Float32s:
        """Return the colours of the samples around each sample, shape (N, B, W), padded by NaN."""
        table = self.surroundings.around(samples, reach)
        return np.where(table >= 0, self.at(table), np.float32(np.nan))

    def compared(self, samples: Indices) -> _Compared:
        """Compare samples with those within two steps. With fewer than four neighbours, the contrast is 0."""
        parts = [(samples[:0], *np.zeros((3, len(self.planes), 0), np.float32))]
        for block in large_arrays.blocks(len(samples), large_arrays.SCATTERED):
            values, centres = self.around(samples[block], 2), self.at(samples[block])
            medians, count = _medians(values)
            deviations, _ = _medians(np.abs(values - medians[..., None]))
            # Factor from the median absolute deviation to the standard deviation of a normal variable.
            parts.append(
                (samples[block], centres, np.where(count < 4, centres, medians), 1.4826 * deviations)
            )
        return _Compared(*(np.concatenate(each, axis=-1) for each in zip(*parts, strict=True)))


def fill_outliers(
    planes: Float32s, where: Surroundings, parameters: KernelParameters, *, is_light: bool
) -> tuple[Float32s, Outliers | None]:
    """Find the outliers of colours, shape (N, ...), and fill them; without outliers the same array is returned."""
    outliers = _find_outliers(planes, where, parameters, is_light=is_light)
    if outliers is None:
        return planes, None
    filled = _Surface(large_arrays.copy_of(planes), where)
    _fill_in_place(filled, np.asarray(where.samples)[outliers.samples], outliers.channels.T)
    return filled.planes, outliers


def _find_outliers(
    planes: Float32s, where: Surroundings, parameters: KernelParameters, *, is_light: bool
) -> Outliers | None:
    surface, takes_all = _Surface(planes, where), parameters.outliers == "replace"
    if surface.count < _MIN_CLUMPS or not parameters.looks_for_outliers:
        return None
    some = np.linspace(0, surface.count - 1, min(surface.count, 256 * _MIN_CLUMPS)).astype(int)
    sampled = surface.compared(where.samples[some])
    ranges = _ranges(sampled.colours)
    # Noise alone seldom makes a sample differ that much from most neighbours.
    least = _MIN_SHARE_OF_RANGE * ranges + _MIN_DEVIATIONS / 2 * np.median(sampled.deviations, axis=1)
    standing_out = where.standing_out(planes, np.where(ranges > 0, least, np.inf).astype(np.float32))
    if len(standing_out) < (1 if takes_all else _MIN_CLUMPS):
        return None
    rows = surface.compared(standing_out)

    def outliers_of(channels: slice) -> Int64s:
        parts = _Surface(planes[channels], where), sampled.of_channels(channels)
        search = _Search(*parts, float(ranges[channels][0]), takes_all=takes_all, is_light=is_light)
        return search.outliers_in(rows.of_channels(channels))

    # Search all colour channels together first, then each channel.
    groups = [slice(channel, channel + 1) for channel in range(len(planes))]
    if len(planes) >= COLOURS and len(of_colours := outliers_of(slice(COLOURS))):
        found = [(slice(COLOURS), of_colours), *((group, outliers_of(group)) for group in groups[COLOURS:])]
    else:
        found = [(group, outliers_of(group)) for group in groups]
    return _outliers_by_channel(surface, found)


def _outliers_by_channel(surface: _Surface, found: Sequence[tuple[slice, Int64s]]) -> Outliers | None:
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

    surface: _Surface
    sampled: _Compared
    range: float  # of the colours
    takes_all: bool  # isolated samples that stand out, however they are distributed
    is_light: bool

    def outliers_in(self, rows: _Compared) -> Int64s:
        """Return the outliers among rows that stand out."""
        if not self.range > 0:
            return rows.samples[:0]
        contrasts, outliers = rows.contrasts(self.range), [rows.samples[:0]]
        for sign in (-1, 1):
            # Bright light needs twice the contrast, since its noise has a longer tail.
            is_bright_light = self.is_light and sign > 0
            contrast = sign * contrasts / np.float32(2 if is_bright_light else 1)
            outlying, contrast = rows[contrast > 1], contrast[contrast > 1]
            limits = np.abs(outlying.colours - outlying.medians).max(axis=0) / 2
            small, strongest = self._small_clumps(outlying.samples, limits, contrast)
            # With few light paths, nearly all light is in single samples, which are not outliers.
            is_rare = _MAJORITY * len(small) <= np.count_nonzero(small) < _MAX_FIREFLIES * self.surface.count
            everywhere = np.ones(len(self.sampled.samples), bool)
            if self.takes_all or (
                is_bright_light and is_rare and self._is_random(outlying, contrast, strongest, everywhere)
            ):
                outliers.append(outlying.samples[small])
            elif len(strongest) >= _MIN_CLUMPS:
                outliers.append(self._with_common_value(outlying, sign * contrast, small, strongest))
        return np.unique(np.concatenate(outliers))

    def _with_common_value(
        self, rows: _Compared, contrast: Float32s, small: Bools, strongest: Int64s
    ) -> Int64s:
        """Return the outliers that have the most frequent value, if they are spread at random."""
        colours, tolerance = rows.colours[:, strongest], _SAME_VALUE * self.range
        value = np.median(colours, axis=1)
        for _ in range(2):  # the second time without other values
            is_near = np.abs(colours - value[:, None]).max(axis=0) <= tolerance
            value = np.median(colours[:, is_near], axis=1) if is_near.any() else value
        near = np.abs(rows.colours - value[:, None]).max(axis=0)
        chosen = strongest[near[strongest] <= tolerance]
        if (
            len(chosen) < max(_MIN_CLUMPS, _MAJORITY * len(strongest))
            or small[near <= tolerance].mean() < _MAJORITY
        ):
            return rows.samples[:0]
        # On a plain ground they may be a pattern.
        away = np.abs(rows.colours - rows.medians)[:, chosen].max(axis=0)
        is_plain = rows.medians[:, chosen].std(axis=1).max() < _SAME_VALUE * np.median(away)
        is_visible = np.sign(contrast[0]) * self.sampled.contrasts(self.range, value[:, None]) > 1
        if is_plain or not self._is_random(rows, np.abs(contrast), chosen, np.asarray(is_visible)):
            return rows.samples[:0]
        # Noise added after the outliers spreads their value.
        return self._samples_of_value(value, float(np.quantile(near[chosen], 0.95)))

    def _samples_of_value(self, value: Float32s, spread: float) -> Int64s:
        """Return isolated samples of a value, with a lower threshold of contrast."""
        surface, parts = self.surface, [np.zeros(0, np.int64)]
        for block in large_arrays.blocks(surface.count, large_arrays.CACHED):
            samples = np.asarray(surface.surroundings.samples[block], np.int64)
            rows = surface.compared(
                samples[np.abs(surface.at(samples) - value[:, None]).max(axis=0) <= spread]
            )
            parts.append(rows.samples[np.abs(rows.contrasts(self.range)) > _WEAK_LIMIT])
        samples = np.concatenate(parts)
        small, _ = self._small_clumps(
            samples, np.full(len(samples), spread), np.zeros(len(samples), np.float32)
        )
        return samples[small]

    def _small_clumps(self, samples: Int64s, limits: Float32s, contrast: Float32s) -> tuple[Bools, Int64s]:
        """Find isolated clumps of samples that are no larger than clumps that form by chance.

        A clump is isolated if no sample around it has a similar colour, within `limits`. Return which samples are in
        small isolated clumps, and the sample of the highest contrast in each of these clumps.
        """
        if not len(samples):
            return np.zeros(0, bool), samples
        around = self.surface.surroundings.around(samples, 1)
        index = np.searchsorted(samples, around).clip(0, len(samples) - 1)
        stands_out = (around >= 0) & (samples[index] == around)
        away = np.abs(self.surface.at(around) - self.surface.at(samples)[..., None]).max(axis=0)
        has_similar = ((away <= limits[:, None]) & (around >= 0) & ~stands_out).any(axis=1)
        clump = _connected(np.where(stands_out, index, np.arange(len(samples))[:, None]))
        is_isolated = np.bincount(clump, has_similar)[clump] == 0
        small = self._are_chance_clumps(np.bincount(clump)[clump], is_isolated)
        order = np.lexsort((-contrast, clump))
        strongest = order[np.diff(clump[order], prepend=-1) > 0]
        return small, strongest[small[strongest]]

    def _are_chance_clumps(self, sizes: Int64s, is_isolated: Bools) -> Bools:
        """Mark the samples of isolated clumps that are no larger than clumps that form by chance."""
        small = np.zeros(len(sizes), bool)
        for _ in range(5):  # the share converges
            # Four samples, since images may have been enlarged by two. On a lattice with eight neighbours the mean
            # size of random clumps is 1 / (1 - 8 share) for small shares, and the largest clumps grow faster.
            share = np.count_nonzero(small) / self.surface.count
            small = is_isolated & (sizes <= 4 / max(1 - 8 * share, 0.1) ** 2)
        return small

    def _is_random(self, rows: _Compared, contrast: Float32s, chosen: Int64s, is_visible: Bools) -> bool:
        """Whether chosen rows are spread at random over the samples on which they would be visible, `is_visible`."""
        # If most contrasts are near the threshold, these are the tails of texture or noise.
        if len(chosen) < _MIN_CLUMPS or np.mean(contrast[chosen] < 2) > _MAJORITY or not is_visible.any():
            return False
        samples = np.sort(rows.samples[chosen])
        return (
            self._have_chance_neighbours(samples, is_visible)
            and self._are_evenly_spread(samples, is_visible)
            and _are_alike(self.sampled.medians[:, is_visible], rows.medians[:, chosen])
        )

    def _have_chance_neighbours(self, samples: Int64s, is_visible: Bools) -> bool:
        """Whether about as many of the samples are within two steps of each other as by chance."""
        around = self.surface.surroundings.around(samples, 2)
        pairs = np.count_nonzero(np.isin(around, samples))
        expected = np.count_nonzero(around >= 0) * len(samples) / (self.surface.count * is_visible.mean())
        error = 3 * np.sqrt(2 * expected) + 2  # each pair counts twice
        return bool(expected / 4 - error <= pairs <= 2 * expected + error)

    def _are_evenly_spread(self, samples: Int64s, is_visible: Bools) -> bool:
        """Whether runs of successive samples contain about equal shares, by a chi-squared test."""
        where, runs = self.surface.surroundings, 2 * _MIN_CLUMPS
        counts = np.bincount(
            np.searchsorted(where.samples, samples) * runs // self.surface.count, minlength=runs
        )
        visible = np.bincount(np.flatnonzero(is_visible) * runs // len(is_visible), minlength=runs)
        expected = visible * (len(samples) / np.count_nonzero(is_visible))
        excess = float((np.square(counts - expected) / np.maximum(expected, 1)).sum()) - runs
        return bool(excess <= 3 * np.sqrt(2 * runs) + 0.1 * len(samples))


def _connected(neighbours: Int64s) -> Int64s:
    """Return the least index in the clump of each sample, given the indices of its neighbours, shape (n, W)."""
    # SciPy has this, but importing it takes longer.
    label, before = np.arange(len(neighbours)), np.zeros(0, np.int64)
    while not np.array_equal(label, before):
        before, label = label, np.minimum(label, label[neighbours].min(axis=1))
        label = label[label]
    return label


def _are_alike(all_colours: Float32s, some: Float32s) -> bool:
    """Whether two sets of colours, shape (N, n), have the same distribution, by a Kolmogorov-Smirnov test."""
    levels = [each.mean(axis=0) for each in (all_colours, some)]
    places = np.concatenate(levels)
    ranks = [np.searchsorted(np.sort(each), places, "right") / len(each) for each in levels]
    return bool(np.abs(ranks[0] - ranks[1]).max() <= 0.1 + 1.2 / np.sqrt(len(levels[1])))


def _medians(values: Float32s) -> tuple[Float32s, Int64s]:
    """Return the medians along the last axis and the number of finite values; NaN is ignored."""
    ordered = np.sort(values, axis=-1)
    # Three times as fast as `sum` along the short axis.
    count = (np.isfinite(ordered).astype(np.float32) @ np.ones(ordered.shape[-1], np.float32)).astype(
        np.int64
    )
    middle = np.maximum(count - 1, 0)[..., None] // 2
    return np.take_along_axis(ordered, middle, axis=-1)[..., 0], count


def _fill_in_place(surface: _Surface, samples: Int64s, wrong: Bools) -> None:
    """Fill wrong samples with the median of the others within one step, or two if there are too few."""
    flat, filled = surface.planes.reshape(len(surface.planes), -1), surface.at(samples)
    for channel, is_wrong in zip(flat, wrong, strict=True):
        channel[samples[is_wrong]] = np.nan
    for block in large_arrays.blocks(len(samples), large_arrays.SCATTERED):
        for reach, fewest in ((2, 1), (1, 3)):
            medians, count = _medians(surface.around(samples[block], reach))
            np.copyto(filled[:, block], medians, where=wrong[:, block] & (count >= fewest))
    for channel, is_wrong, values in zip(flat, wrong, filled, strict=True):
        channel[samples[is_wrong]] = values[is_wrong]
