"""Dependence of the noise on level and place."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from beltrami_cli._native import interpolate
from beltrami_cli.arrays import Array, Float32s, Float64s
from beltrami_cli.flow.noise.components import STEPS
from beltrami_cli.flow.noise.neighbourhoods import Neighbourhoods
from beltrami_cli.flow.noise.residual import Blocks, Residual
from beltrami_cli.flow.noise.stabiliser import VarianceStabiliser

# Number of bins of the pilot's level, and their centres.
_LEVEL_BINS = 16
_MIDDLES = (np.arange(_LEVEL_BINS) + 0.5) / _LEVEL_BINS

# Minimum number of blocks of a level, and number of blocks that the mean counts as: the variance of a block of 15
# details is known to a third.
_MIN_BLOCKS, _PRIOR_BLOCKS = 8, 2

# Minimum relative variance of a level or place, as a divisor.
MIN_RELATIVE_VARIANCE = 1e-3

# Ratio of deviations above which levels or places differ. Between places, it reaches 1.12 on twelve images with white
# noise, and is 1.25 to 2.4 for blends of two exposures.
MIN_RATIO = 1.25

# Ratio of variances of the noisiest and the quietest adjacent neighbourhood above which noise ends there. With the
# square of `MIN_RATIO`, ramps in images of 180 texels lose 0.4 dB by benchmarks/bench_regret.py.
_MIN_RATIO_AT_BORDER = 25


@dataclass(frozen=True, eq=False)
class LevelCurve:
    """Relative variances of the noise at ascending levels, shape (B,), and the number of blocks at each."""

    levels: Float64s  # of full scale 1
    variances: Float64s
    counts: Float64s

    @classmethod
    def of(cls, blocks: Blocks, count: int) -> LevelCurve | None:
        """Measure even blocks of the first `count` channels; None if fewer than two levels have enough blocks."""
        sums, counts, known = np.zeros(_LEVEL_BINS), np.zeros(_LEVEL_BINS), blocks.is_known
        for levels, energies in zip(blocks.levels[:count], blocks.energies[:count], strict=True):
            bins = np.clip(levels[known] / STEPS * _LEVEL_BINS, 0, _LEVEL_BINS - 1).astype(np.intp)
            chosen = blocks.most_even(bins)
            of_channel = np.mean(energies[known][chosen]) if chosen.any() else 0.0
            if of_channel > 0:
                sums += np.bincount(bins[chosen], energies[known][chosen] / of_channel, _LEVEL_BINS)
                counts += np.bincount(bins[chosen], minlength=_LEVEL_BINS)
        enough = counts >= _MIN_BLOCKS
        if np.count_nonzero(enough) < 2:
            return None
        variances = np.maximum((sums + _PRIOR_BLOCKS) / (counts + _PRIOR_BLOCKS), MIN_RELATIVE_VARIANCE)
        return cls(_MIDDLES[enough], variances[enough], counts[enough])

    @property
    def differs(self) -> bool:
        return bool(np.ptp(np.log2(self.variances)) > 2 * np.log2(MIN_RATIO))

    def at(self, levels: Float32s) -> Float32s:
        """Interpolate the relative variance at levels in steps of 8 bits."""
        values = levels.ravel() / STEPS
        # `levels` are a subset of the middles, so that the curve is the same through all of them, which are evenly
        # spaced.
        interpolate(values, _MIDDLES, np.interp(_MIDDLES, self.levels, self.variances))
        return np.asarray(values.reshape(levels.shape), np.float32)

    def stabiliser(self, full_scale: float) -> VarianceStabiliser:
        return VarianceStabiliser(full_scale * self.levels, np.sqrt(self.variances), self.counts, full_scale)


@dataclass(frozen=True, eq=False)
class Structure:
    """Dependence of the noise variance on level and place, on one of them, or on neither."""

    curve: LevelCurve | None
    place_variances: Float64s  # relative variance of each neighbourhood, of mean 1, shape (P,)

    @classmethod
    def uniform(cls, neighbourhoods: Neighbourhoods) -> Structure:
        return cls(None, np.ones(neighbourhoods.count))

    @property
    def is_by_place(self) -> bool:
        return bool((self.place_variances != 1).any())

    def without_levels(self) -> Structure:
        return dataclasses.replace(self, curve=None)

    def stabiliser(self, full_scale: float) -> VarianceStabiliser | None:
        """Return the stabiliser of the variance by level, if it depends on the level."""
        return None if self.curve is None else self.curve.stabiliser(full_scale)

    def at_levels(self, levels: Float32s) -> Float32s:
        """Return the relative variance at levels in steps of 8 bits, averaged over channels, the first axis."""
        if self.curve is None:
            return np.ones(levels.shape[1:], np.float32)
        return np.asarray(self.curve.at(levels).mean(axis=0))

    def residual(self, of_uniform: Residual, sigma: float) -> Residual:
        """Return the residual of a pilot that follows the structure, given that of one that assumes uniform noise."""
        if self.curve is None and not self.is_by_place:
            return of_uniform
        channels = of_uniform.channels
        relative = self.place_variances[channels.neighbourhoods.of_samples].astype(np.float32)
        relative *= self.at_levels(of_uniform.pilot.colours)
        relative = np.asarray(relative / max(1e-9, float(relative.mean())), np.float32)
        return Residual.of(channels, np.float32(sigma**2) * relative)

    def over_samples(self, residual: Residual) -> Float32s | None:
        """Return the variance by place at each sample relative to its mean, a stack of one channel, if it differs."""
        if not self.is_by_place:
            return None
        return residual.channels.neighbourhoods.over_samples(self.place_variances, self._in_parts(residual))

    def _in_parts(self, residual: Residual) -> Float64s:
        """Return the relative variances of the parts of neighbourhoods at which noise ends; NaN for other parts.

        If the energy of a part is between the energies of adjacent neighbourhoods, its variance is interpolated.
        Texture counts as quiet, and the quiet neighbourhood with the most energy represents all quiet ones.
        """
        spread, around = residual.channels.scales[-1].spread, residual.channels.neighbourhoods.around
        energies, of_parts = self._energies(residual)
        variances, energies = self.place_variances[around], energies[around]
        least, most = variances.min(axis=1), variances.max(axis=1)
        loud = np.take_along_axis(energies, variances.argmax(axis=1)[:, None], axis=1)[:, 0]
        quiet = np.where(variances <= np.sqrt(least * most)[:, None], energies, 0).max(axis=1)
        shares = (of_parts - spread(quiet)) / np.maximum(spread(loud - quiet), 1e-9)
        ends = spread(most > _MIN_RATIO_AT_BORDER * least)
        interpolated = spread(least) + shares.clip(0, 1) * spread(most - least)
        return np.asarray(np.where(ends, interpolated, np.nan), np.float64)

    def _energies(self, residual: Residual) -> tuple[Array, Array]:
        """Return the energies of neighbourhoods and of their parts, by level; NaN for parts without samples."""
        squares = np.square(residual.removed.colours).mean(axis=0)
        squares /= self.at_levels(residual.pilot.colours)
        # Means count missing samples as 0. Those of ones are the shares of the samples that exist.
        parts: Array = np.stack([squares, np.ones_like(squares)])
        *finer, last = residual.channels.scales
        for scale in finer:
            parts = scale.means(parts)
        energies, of_parts = (each[0] / np.maximum(each[1], 1e-9) for each in (last.means(parts), parts))
        return energies, np.where(parts[1] > 0, of_parts, np.nan)
