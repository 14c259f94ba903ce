"""Wrong samples: fireflies, salt and pepper, dead texels.

A wrong sample lies far outside of what its neighbours on the surface make likely, alone or in a small clump. So do
stars, rivets, and the dots of dither and of the letter i. What tells both apart is how they are spread: wrong samples
lie anywhere, whatever colour is there, and have one value, or are light far brighter than what is around. What is drawn
repeats itself, is part of larger shapes, has many values, or a plain ground of its own.

Outliers are filled with the median of the neighbours that are none, before anything reads the colours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int32s, Int64s
from beltrami_cli.flow.noise.model import COLOURS
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import Indices

# On 650 pictures without wrong samples none is found with any of the values in brackets. "Missed" and "false" are
# shares of the impulses, black and white or red, in four pictures with and without noise of 10 of 255.
#
# Deviations of the neighbours, plus a share of the range of all colours, beyond which a sample stands out. Missed with
# 3, 4 and 5 deviations: 1.7, 9.5, 16 %.
_FAR = 3.0, 0.1

# The same, as a share of that, for samples of a value that outliers have. Missed and false with 1/5, 1/3 and 1/2 at 4
# deviations: 8.1 and 0.05, 9.5 and 0.01, 13 and 0 %.
_WEAK = 1 / 3

# Share of the range within which values are one; so is a ground, relative to what is on it [0.03, 0.12].
_ALIKE = 0.06

# Clumps from which on their spread can be judged [10, 30].
_FEWEST = 16

# Share of the clumps that must have one value, of samples of it in small clumps, and of clumps that stand out little.
_MOST = 2 / 3

# Share of light that may be fireflies. With a gamma distribution of shape 0.05, 9 % of samples hold 80 % of the light.
_RARE = 0.02


class Surroundings(Protocol):
    """The samples of a surface, by their places in a stack, and their neighbours."""

    @property
    def samples(self) -> Indices:
        """The places of all samples, ascending, shape (S,)."""

    def around(self, samples: Indices, reach: int) -> Int64s:
        """Return the samples within one or two steps of each of some, shape (B, W); -1: none."""

    def standing_out(self, planes: Float32s, least: Float32s) -> Indices:
        """Return the samples that differ from most neighbours by more than `least`, shape (N,), in a channel."""


@dataclass(frozen=True)
class Outliers:
    """The K samples that were filled, ascending, and their colours before."""

    samples: Int64s  # counted among all samples of the surface
    channels: Bools  # which are wrong, shape (K, N)
    colours: Float32s  # shape (K, N)
    share: float  # of all samples

    def numbered(self, numbers: Int32s) -> Outliers:
        """Return the same with other numbers of all samples."""
        order = np.argsort(numbers[self.samples])
        samples = numbers[self.samples][order].astype(np.int64)
        return Outliers(samples, self.channels[order], self.colours[order], self.share)


@dataclass(frozen=True)
class _Rows:
    """Samples, and the median and the deviation of the colours around each, shape (C, N)."""

    samples: Int64s
    colours: Float32s
    medians: Float32s
    deviations: Float32s

    @classmethod
    def of(cls, surface: _Surface, samples: Indices, channels: slice = slice(None)) -> _Rows:
        from beltrami_cli._native import medians_around

        own = np.asarray(samples, np.int64)
        around, planes = surface.where.around(own, 2), surface.planes[channels]
        medians, deviations = medians_around(planes, own, around, surface.threads)
        return cls(own, surface.at(own, channels), medians, np.float32(1.4826) * deviations)  # normal

    def only(self, rows: Array) -> _Rows:
        return _Rows(self.samples[rows], self.colours[rows], self.medians[rows], self.deviations[rows])

    def of_channels(self, channels: slice) -> _Rows:
        parts = (each[:, channels] for each in (self.colours, self.medians, self.deviations))
        return _Rows(self.samples, *parts)

    def contrasts(self, ranges: Float64s, colours: Float32s | None = None) -> Float32s:
        """Return the signed distances of colours, or of others, from the medians, shape (C,), of which 1 is far."""
        away = (self.colours if colours is None else colours) - self.medians
        away /= np.float32(_FAR[0]) * self.deviations + (_FAR[1] * ranges).astype(np.float32)
        strongest = np.abs(away).argmax(axis=1)[:, None]
        return np.asarray(np.take_along_axis(away, strongest, axis=1)[:, 0], np.float32)


@dataclass(frozen=True)
class _Surface:
    """Colours, shape (N, ...), and where they are."""

    planes: Float32s
    where: Surroundings
    threads: int

    def at(self, samples: Int64s, channels: slice = slice(None)) -> Float32s:
        """Return colours, shape (..., N)."""
        return np.moveaxis(self.planes.reshape(len(self.planes), -1)[channels, samples], 0, -1)


def replace_outliers(
    planes: Float32s, where: Surroundings, parameters: KernelParameters, *, is_light: bool
) -> Outliers | None:
    """Find the outliers of colours, shape (N, ...), and fill them, in place; None if there are none."""
    surface, count = _Surface(planes, where, parameters.thread_count), len(where.samples)
    if count < _FEWEST or not parameters.looks_for_outliers:
        return None
    sampled = _Rows.of(
        surface, where.samples[np.linspace(0, count - 1, min(count, large_arrays.SCATTERED)).astype(int)]
    )
    ranges = _ranges(sampled.colours)
    # Of noise only few samples are as far from most neighbours; where there is less, it takes no less.
    least = _FAR[1] * ranges + _FAR[0] / 2 * np.median(sampled.deviations, axis=0)
    samples = where.standing_out(planes, np.where(ranges > 0, least, np.inf).astype(np.float32))
    if len(samples) < (1 if parameters.outliers == "replace" else _FEWEST):
        return None
    rows = _Rows.of(surface, samples)
    found = list[tuple[slice, Int64s]]()
    for channels in _groups(ranges):
        # Colours are wrong together, or each of them by itself.
        if not any(own.start <= channels.start < own.stop for own, _ in found):
            search = _Search(
                surface, rows.of_channels(channels), sampled.of_channels(channels), channels, ranges[channels]
            )
            wrong = search.run(insists=parameters.outliers == "replace", is_light=is_light)
            found += [(channels, wrong)] if len(wrong) else []
    if not found:
        return None
    samples = np.unique(np.concatenate([own for _, own in found]))
    is_wrong = np.zeros((len(samples), len(planes)), bool)
    for channels, own in found:
        is_wrong[np.searchsorted(samples, own), channels] = True
    before = surface.at(samples)
    _fill(surface, samples, is_wrong)
    return Outliers(np.searchsorted(where.samples, samples), is_wrong, before, len(samples) / count)


def _ranges(colours: Float32s) -> Float64s:
    """Return the range of each channel, the same of all colours; that of plain colours is a share of their size."""
    low, high = np.quantile(colours, (0.01, 0.99), axis=0)
    ranges = np.maximum(high - low, _FAR[1] * np.maximum(np.abs(low), np.abs(high)))
    if len(ranges) >= COLOURS:
        ranges[:COLOURS] = ranges[:COLOURS].max()
    return np.asarray(ranges, np.float64)


def _groups(ranges: Float64s) -> list[slice]:
    """Return the channels that are looked at together, three colours, and then each by itself."""
    together = [slice(0, COLOURS)] if len(ranges) >= COLOURS and ranges[0] > 0 else []
    return [*together, *(slice(k, k + 1) for k, size in enumerate(ranges) if size > 0)]


@dataclass(frozen=True)
class _Clumps:
    """Samples that stand out to one side, in clumps: of each its clump, the size of that, and whether it is apart."""

    label: Int64s
    size: Int64s
    is_apart: Bools  # no sample around it is like it

    def small(self, share: float) -> Bools:
        """Return which may be of wrong samples alone, of which there is a share."""
        # Four, as enlarging by two leaves; but on a lattice of eight neighbours the mean size of random clumps is
        # 1 / (1 - 8 share), at first, and the largest ones grow faster.
        return self.is_apart & (self.size <= 4 / max(1 - 8 * share, 0.1) ** 2)

    def strongest(self, contrasts: Float32s, chosen: Bools) -> Int64s:
        """Return which chosen sample of each clump has the most contrast."""
        order = np.lexsort((-contrasts, self.label))
        first = order[np.diff(self.label[order], prepend=-1) > 0]
        return np.asarray(first[chosen[first]], np.int64)

    def outliers(self, count: int) -> Bools:
        """Return which are in clumps that wrong samples make at their share of a number of samples."""
        found = self.small(0.0)
        for _ in range(4):
            found = self.small(np.count_nonzero(found) / count)
        return found


@dataclass(frozen=True)
class _Search:
    """The search for outliers in some channels."""

    surface: _Surface
    rows: _Rows  # of samples that stand out
    sampled: _Rows  # of all samples
    channels: slice
    ranges: Float64s

    @property
    def count(self) -> int:
        return len(self.surface.where.samples)

    def run(self, *, insists: bool, is_light: bool) -> Int64s:
        """Return the samples that are wrong; if it `insists`, all that are apart, however they are spread."""
        contrasts, found = self.rows.contrasts(self.ranges), [np.zeros(0, np.int64)]
        for sign in (-1, 1):
            is_firefly = is_light and sign > 0
            # The noise of light has a longer tail.
            contrast = sign * contrasts / np.float32(2 if is_firefly else 1)
            far = np.flatnonzero(contrast > 1)
            if len(far) >= (1 if insists else _FEWEST):
                rows, contrast = self.rows.only(far), contrast[far]
                away = np.abs(rows.colours - rows.medians).max(axis=1)
                clumps = self._clumps(rows.samples, away / 2)
                small = clumps.outliers(self.count)
                if insists or (is_firefly and self._are_fireflies(rows, contrast, clumps, small)):
                    found.append(rows.samples[small])
                else:
                    found.append(self._of_one_value(rows, contrast, clumps, small, sign))
        return np.unique(np.concatenate(found))

    def _are_fireflies(self, rows: _Rows, contrast: Float32s, clumps: _Clumps, small: Bools) -> bool:
        """Whether light that is far brighter than what is around is spread at random."""
        chosen, everywhere = clumps.strongest(contrast, small), np.ones(len(self.sampled.samples), bool)
        # Of few paths all light is in single samples.
        is_rare = np.count_nonzero(small) < _RARE * self.count and np.mean(small) >= _MOST
        return bool(is_rare) and self._is_random(rows.only(chosen), contrast[chosen], everywhere)

    def _of_one_value(
        self, rows: _Rows, contrast: Float32s, clumps: _Clumps, small: Bools, sign: int
    ) -> Int64s:
        """Return the outliers of the value that most have, if these are spread at random."""
        nothing, tolerance = np.zeros(0, np.int64), float(_ALIKE * self.ranges.max())
        strongest = clumps.strongest(contrast, small)
        if len(strongest) < _FEWEST:
            return nothing
        value = _value_of(rows.colours[strongest], tolerance)
        alike = _is_near(rows.colours, value, tolerance)
        chosen = strongest[alike[strongest]]
        if len(chosen) < max(_FEWEST, _MOST * len(strongest)):
            return nothing
        own = rows.only(chosen)
        # A plain ground of its own may have a pattern.
        ground, away = own.medians.std(axis=0).max(), np.abs(own.colours - own.medians).max(axis=1)
        if np.mean(small[alike]) < _MOST or ground < _ALIKE * np.median(away):
            return nothing
        hit = np.asarray(sign * self.sampled.contrasts(self.ranges, value) > 1)
        if not self._is_random(own, contrast[chosen], hit):
            return nothing
        # Noise that was added to outliers spreads their value.
        spread = float(np.quantile(np.abs(own.colours - value).max(axis=1), 0.95))
        return self._all_of(value, spread)

    def _all_of(self, value: Float32s, spread: float) -> Int64s:
        """Return the samples of a value that stand out at least a little, where they are apart."""
        parts = [np.zeros(0, np.int64)]
        for block in large_arrays.blocks(self.count, large_arrays.CACHED):
            samples = np.asarray(self.surface.where.samples[block], np.int64)
            parts.append(samples[_is_near(self.surface.at(samples, self.channels), value, spread)])
        rows = _Rows.of(self.surface, np.concatenate(parts), self.channels)
        samples = rows.samples[np.abs(rows.contrasts(self.ranges)) > _WEAK]
        clumps = self._clumps(samples, np.full(len(samples), spread))
        return samples[clumps.outliers(self.count)]

    def _clumps(self, samples: Int64s, limits: Float32s) -> _Clumps:
        """Join neighbours among samples; others are alike if their colours are within a limit of each sample."""
        around, own = self.surface.where.around(samples, 1), np.arange(len(samples))
        rank = np.minimum(np.searchsorted(samples, around), max(0, len(samples) - 1))
        joined = (around >= 0) & (samples[rank] == around) if len(samples) else around >= 0
        rank = np.where(joined, rank, own[:, None])
        away = self.surface.at(around, self.channels) - self.surface.at(samples, self.channels)[:, None]
        alike = (np.abs(away).max(axis=2) <= limits[:, None]) & (around >= 0) & ~joined
        label, before = own, np.zeros(0, np.int64)
        while not np.array_equal(label, before):
            before, label = label, np.minimum(label, label[rank].min(axis=1, initial=len(samples)))
            label = label[label]
        size = np.bincount(label, minlength=len(samples))
        touched = np.bincount(label, alike.any(axis=1), minlength=len(samples)) > 0
        return _Clumps(label, size[label], ~touched[label])

    def _is_random(self, rows: _Rows, contrasts: Float32s, hit: Bools) -> bool:
        """Whether clumps are spread at random over the samples on which they would show, `hit`.

        `rows`: the strongest of each clump.
        """
        count, where = len(rows.samples), self.surface.where
        # What is hardly far in most places is the end of texture or of noise.
        if count < _FEWEST or np.mean(contrasts < 2) > _MOST or not hit.any():
            return False
        samples = np.sort(rows.samples)
        around = where.around(samples, 2)
        pairs = np.count_nonzero(np.isin(around, samples))
        expected = np.count_nonzero(around >= 0) * count / (self.count * hit.mean())
        error = 3 * np.sqrt(2 * expected) + 2
        parts = 2 * _FEWEST  # runs of samples
        own = np.bincount(np.searchsorted(where.samples, samples) * parts // self.count, minlength=parts)
        usual = np.bincount(np.flatnonzero(hit) * parts // len(hit), minlength=parts) * (count / hit.sum())
        excess = float((np.square(own - usual) / np.maximum(usual, 1)).sum()) - parts
        apart = _distance(self.sampled.medians[hit].mean(axis=1), rows.medians.mean(axis=1))
        return bool(
            expected / 4 - error <= pairs <= 2 * expected + error
            and excess <= 3 * np.sqrt(2 * parts) + 0.1 * count
            and apart <= 0.1 + 1.2 / np.sqrt(count)
        )


def _value_of(colours: Float32s, tolerance: float) -> Float32s:
    """Return the colour that most have, within a tolerance."""
    value: Float32s = np.median(colours, axis=0)
    for _ in range(2):
        alike = _is_near(colours, value, tolerance)
        value = np.median(colours[alike], axis=0) if alike.any() else value
    return value


def _is_near(colours: Float32s, value: Float32s, distance: float) -> Bools:
    return np.asarray(np.abs(colours - value).max(axis=1, initial=0) <= distance)


def _distance(some: Float32s, others: Float32s) -> float:
    """Return the distance of Kolmogorov and Smirnov of two distributions."""
    places = np.concatenate([some, others])
    shares = [np.searchsorted(np.sort(each), places, "right") / len(each) for each in (some, others)]
    return float(np.abs(shares[0] - shares[1]).max())


def _fill(surface: _Surface, samples: Int64s, wrong: Bools) -> None:
    """Fill wrong samples, in place, with the medians of the others within one step, or two where these are too few."""
    flat = surface.planes.reshape(len(surface.planes), -1)
    filled = surface.at(samples)
    for channel, own in zip(flat, wrong.T, strict=True):
        channel[samples[own]] = np.nan
    for block in large_arrays.blocks(len(samples), large_arrays.SCATTERED):
        for reach in (2, 1):
            around = surface.where.around(samples[block], reach)
            values = np.sort(np.where((around >= 0)[..., None], surface.at(around), np.nan), axis=1)
            count = np.count_nonzero(np.isfinite(values), axis=1)
            middle = np.take_along_axis(values, np.maximum(count - 1, 0)[:, None] // 2, axis=1)[:, 0]
            np.copyto(filled[block], middle, where=wrong[block] & (count >= (3 if reach == 1 else 1)))
    for channel, own, values in zip(flat, wrong.T, filled.T, strict=True):
        channel[samples[own]] = values[own]
