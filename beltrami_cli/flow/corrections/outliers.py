"""Outliers: fireflies, salt and pepper, dead texels.

An outlier differs far more from its neighbours on the surface than noise does, alone or in a small clump. So do stars,
rivets, and the dots of dither and of the letter i. They are told apart by their distribution. Outliers are spread at
random over all colours, and have one value or, as fireflies, are far brighter than the light around. Drawn detail
repeats, belongs to larger shapes, has many values, or lies on a plain ground.

Outliers are filled with the median of the neighbours that are not outliers, before anything else reads the colours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Indices, Int64s
from beltrami_cli.flow.manifolds.manifold import Outliers
from beltrami_cli.flow.noise.stabiliser import COLOURS
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.surface import large_arrays

# By benchmarks/bench_outliers.py: at most 1 of 194 pictures of games and scikit-image is changed with any of the values
# in brackets. "Missed" and "false": shares of pixels set to black, white or red, with and without noise of 10 of 255.
#
# A sample stands out by so many deviations of its neighbours plus a share of the range of all colours. Missed with
# 2.5, 3, 4 and 5 deviations: 2.3, 2.8, 7.2 and 11 %; with shares of 0.07 and 0.15: 2.5 and 5.9 %.
_OUTLIER_LIMIT = 3.0, 0.1

# The same, as a share of that, for samples of a value that outliers have. Missed and false with 1/5, 1/3 and 1/2 at 4
# deviations: 8.1 and 0.05, 9.5 and 0.01, 13 and 0 %.
_WEAK_LIMIT = 1 / 3

# Share of the range within which values are one; so is a ground, relative to what is on it [0.03, 0.12].
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
class _Rows:
    """Samples with their colours, and the local median and deviation of the colours, shape (N, C)."""

    samples: Int64s
    colours: Float32s
    medians: Float32s
    deviations: Float32s

    def __getitem__(self, rows: Array) -> _Rows:
        return _Rows(
            self.samples[rows], *(each[:, rows] for each in (self.colours, self.medians, self.deviations))
        )

    def of_channels(self, channels: slice) -> _Rows:
        return _Rows(self.samples, self.colours[channels], self.medians[channels], self.deviations[channels])

    def contrasts(self, size: float, value: Float32s | None = None) -> Float32s:
        """Return the signed differences of colours, or of a value, to the medians by the threshold, shape (C,)."""
        away = (self.colours if value is None else value) - self.medians
        away /= np.float32(_OUTLIER_LIMIT[0]) * self.deviations + np.float32(_OUTLIER_LIMIT[1] * size)
        return np.asarray(np.take_along_axis(away, np.abs(away).argmax(axis=0)[None], axis=0)[0], np.float32)


@dataclass(frozen=True)
class _Surface:
    """Colours, shape (N, ...), and the neighbours of their samples."""

    planes: Float32s
    where: Surroundings

    @property
    def count(self) -> int:
        return len(self.where.samples)

    def at(self, samples: Indices) -> Float32s:
        return self.planes.reshape(len(self.planes), -1)[:, samples]

    def around(self, samples: Indices, reach: int) -> Float32s:
        """Return the colours of the samples around each sample, shape (N, B, W), padded by NaN."""
        table = self.where.around(samples, reach)
        return np.where(table >= 0, self.at(table), np.float32(np.nan))

    def compared(self, samples: Indices) -> _Rows:
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
        return _Rows(*(np.concatenate(each, axis=-1) for each in zip(*parts, strict=True)))


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
    surface, insists = _Surface(planes, where), parameters.outliers == "replace"
    if surface.count < _MIN_CLUMPS or not parameters.looks_for_outliers:
        return None
    some = np.linspace(0, surface.count - 1, min(surface.count, 256 * _MIN_CLUMPS)).astype(int)
    sampled = surface.compared(where.samples[some])
    sizes = _ranges(sampled.colours)
    # Noise alone seldom makes a sample differ that much from most neighbours.
    least = _OUTLIER_LIMIT[1] * sizes + _OUTLIER_LIMIT[0] / 2 * np.median(sampled.deviations, axis=1)
    standing_out = where.standing_out(planes, np.where(sizes > 0, least, np.inf).astype(np.float32))
    if len(standing_out) < (1 if insists else _MIN_CLUMPS):
        return None
    rows, found = surface.compared(standing_out), dict[tuple[int, int], Int64s]()
    # Outliers are searched for in all colour channels together, then in each channel.
    for first, last in [(0, COLOURS)] * (len(planes) >= COLOURS) + [(k, k + 1) for k in range(len(planes))]:
        if sizes[first] > 0 and not any(begin <= first < end for begin, end in found):
            own = slice(first, last)
            search = _Search(_Surface(planes[own], where), sampled.of_channels(own), float(sizes[first]))
            wrong = search.outliers_in(rows.of_channels(own), insists=insists, is_light=is_light)
            found |= {(first, last): wrong} if len(wrong) else {}
    if not found:
        return None
    samples = np.unique(np.concatenate([*found.values()]))
    channels = np.zeros((len(samples), len(planes)), bool)
    for (first, last), own_samples in found.items():
        channels[np.searchsorted(samples, own_samples), first:last] = True
    share = len(samples) / surface.count
    return Outliers(np.searchsorted(where.samples, samples), channels, surface.at(samples).T, share)


def _ranges(colours: Float32s) -> Float64s:
    """Return the range of each channel, common to colours; constant channels get a share of their magnitude."""
    low, high = np.quantile(colours, (0.01, 0.99), axis=1)
    ranges = np.maximum(high - low, _OUTLIER_LIMIT[1] * np.maximum(np.abs(low), np.abs(high)))
    if len(ranges) >= COLOURS:
        ranges[:COLOURS] = ranges[:COLOURS].max()
    return np.asarray(ranges, np.float64)


@dataclass(frozen=True)
class _Search:
    """Search for outliers; `sampled` rows represent all samples, and `size` is the range of their colours."""

    surface: _Surface
    sampled: _Rows
    size: float

    def outliers_in(self, rows: _Rows, *, insists: bool, is_light: bool) -> Int64s:
        """Return the outliers among rows that stand out; if it `insists`, all isolated ones, however distributed."""
        contrasts, found = rows.contrasts(self.size), [rows.samples[:0]]
        for sign in (-1, 1):
            # Bright light needs twice the contrast, since its noise has a longer tail.
            is_bright = is_light and sign > 0
            contrast = sign * contrasts / np.float32(2 if is_bright else 1)
            outlying, contrast = rows[contrast > 1], contrast[contrast > 1]
            small, strongest = self._clumps(
                outlying.samples, np.abs(outlying.colours - outlying.medians).max(axis=0) / 2, contrast
            )
            # With few light paths, nearly all light is in single samples, which are not outliers.
            is_rare = _MAJORITY * len(small) <= np.count_nonzero(small) < _MAX_FIREFLIES * self.surface.count
            everywhere = np.ones(len(self.sampled.samples), bool)
            is_firefly = is_bright and is_rare and self._is_random(outlying, contrast, strongest, everywhere)
            if insists or is_firefly:
                found.append(outlying.samples[small])
            elif len(strongest) >= _MIN_CLUMPS:
                found.append(self._with_common_value(outlying, sign * contrast, small, strongest))
        return np.unique(np.concatenate(found))

    def _with_common_value(self, rows: _Rows, contrast: Float32s, small: Bools, strongest: Int64s) -> Int64s:
        """Return the outliers that have the most frequent value, if they are spread at random."""
        colours, tolerance = rows.colours[:, strongest], _SAME_VALUE * self.size
        value = np.median(colours, axis=1)
        for _ in range(2):  # the second time without other values
            alike = np.abs(colours - value[:, None]).max(axis=0) <= tolerance
            value = np.median(colours[:, alike], axis=1) if alike.any() else value
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
        hit = np.sign(contrast[0]) * self.sampled.contrasts(self.size, value[:, None]) > 1
        if is_plain or not self._is_random(rows, np.abs(contrast), chosen, np.asarray(hit)):
            return rows.samples[:0]
        # Noise added after the outliers spreads their value.
        return self._samples_of_value(value, float(np.quantile(near[chosen], 0.95)))

    def _samples_of_value(self, value: Float32s, spread: float) -> Int64s:
        """Return isolated samples of a value, with a lower threshold of contrast."""
        surface, found = self.surface, [np.zeros(0, np.int64)]
        for block in large_arrays.blocks(surface.count, large_arrays.CACHED):
            samples = np.asarray(surface.where.samples[block], np.int64)
            rows = surface.compared(
                samples[np.abs(surface.at(samples) - value[:, None]).max(axis=0) <= spread]
            )
            found.append(rows.samples[np.abs(rows.contrasts(self.size)) > _WEAK_LIMIT])
        samples = np.concatenate(found)
        small, _ = self._clumps(samples, np.full(len(samples), spread), np.zeros(len(samples), np.float32))
        return samples[small]

    def _clumps(self, samples: Int64s, limits: Float32s, contrast: Float32s) -> tuple[Bools, Int64s]:
        """Find isolated clumps of samples that are no larger than clumps that form by chance.

        A clump is isolated if no sample around it has a similar colour, within `limits`. Return which samples are in
        small isolated clumps, and the sample of the highest contrast in each of these clumps.
        """
        surface, rows = self.surface, np.arange(len(samples))
        around = surface.where.around(samples, 1)
        rank = np.searchsorted(samples, around).clip(0, max(0, len(samples) - 1))
        joined = (around >= 0) & (samples[rank] == around) if len(samples) else around >= 0
        rank = np.where(joined, rank, rows[:, None])
        away = np.abs(surface.at(around) - surface.at(samples)[..., None]).max(axis=0)
        alike = ((away <= limits[:, None]) & (around >= 0) & ~joined).any(axis=1)
        label, before = rows, np.zeros(0, np.int64)
        while not np.array_equal(label, before):
            before, label = label, np.minimum(label, label[rank].min(axis=1, initial=len(samples)))
            label = label[label]
        size = np.bincount(label, minlength=len(samples))[label]
        is_apart = np.bincount(label, alike, minlength=len(samples))[label] == 0
        small = np.zeros(len(samples), bool)
        for _ in range(5):
            # Four samples, since pictures may have been enlarged by two. On a lattice with eight neighbours the mean
            # size of random clumps is 1 / (1 - 8 share) for small shares, and the largest clumps grow faster.
            share = np.count_nonzero(small) / surface.count
            small = is_apart & (size <= 4 / max(1 - 8 * share, 0.1) ** 2)
        order = np.lexsort((-contrast, label))
        first = order[np.diff(label[order], prepend=-1) > 0]
        return small, first[small[first]]

    def _is_random(self, rows: _Rows, contrast: Float32s, chosen: Int64s, hit: Bools) -> bool:
        """Whether chosen rows are spread at random over the samples on which they would be visible, `hit`."""
        count, where, everything = len(chosen), self.surface.where, self.surface.count
        # If most contrasts are near the threshold, these are the tails of texture or noise.
        if count < _MIN_CLUMPS or np.mean(contrast[chosen] < 2) > _MAJORITY or not hit.any():
            return False
        samples, usual = np.sort(rows.samples[chosen]), count / np.count_nonzero(hit)
        around = where.around(samples, 2)
        pairs = np.count_nonzero(np.isin(around, samples))
        expected = np.count_nonzero(around >= 0) * count / (everything * hit.mean())
        error = 3 * np.sqrt(2 * expected) + 2
        parts = 2 * _MIN_CLUMPS  # number of runs of successive samples
        own = np.bincount(np.searchsorted(where.samples, samples) * parts // everything, minlength=parts)
        chance = np.bincount(np.flatnonzero(hit) * parts // len(hit), minlength=parts) * usual
        excess = float((np.square(own - chance) / np.maximum(chance, 1)).sum()) - parts
        # Kolmogorov-Smirnov distance between the colours around them and the colours around all samples.
        levels = [each.mean(axis=0) for each in (self.sampled.medians[:, hit], rows.medians[:, chosen])]
        places = np.concatenate(levels)
        ranks = [np.searchsorted(np.sort(each), places, "right") / len(each) for each in levels]
        return bool(
            expected / 4 - error <= pairs <= 2 * expected + error
            and excess <= 3 * np.sqrt(2 * parts) + 0.1 * count
            and np.abs(ranks[0] - ranks[1]).max() <= 0.1 + 1.2 / np.sqrt(count)
        )


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
