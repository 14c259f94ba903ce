"""Structure of noise of known size: covariance of channels, dependence on level and place.

A pilot, an edge-preserving mean of few neighbours, removes noise of that size. Its residual shows the noise where the
pilot is even: at levels and places that are not mixed by noise, and without the texture that the pilot keeps.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import partial

import numpy as np

from beltrami_cli._native import interpolate
from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int64s
from beltrami_cli.flow.noise.features import STEPS, symmetric
from beltrami_cli.flow.noise.grid_squares import quiet_energies
from beltrami_cli.flow.noise.model import VarianceStabiliser
from beltrami_cli.flow.noise.neighbourhoods import Neighbourhoods, Samples

# Ratio of the noise that the pilot assumes to the noise. From 1.5 on it removes nine tenths of white noise.
_ASSUMED_NOISE = 1.5

# Number of bins of the pilot's level, and their centres.
_LEVEL_BINS = 16
_MIDDLES = (np.arange(_LEVEL_BINS) + 0.5) / _LEVEL_BINS

# Share of the most even blocks of a level or neighbourhood, and of the most even cells.
_EVEN_SHARE = 0.5

# Minimum number of blocks of a level, and number of blocks that the mean counts as: the variance of a block of 15
# details is known to a third.
_MIN_BLOCKS, _PRIOR_BLOCKS = 8, 2

# Maximum share of clipped samples in a block whose noise is measured.
_MAX_CLIPPED_IN_BLOCK = 0.05

# Minimum relative variance of a level or place, as a divisor.
_MIN_RELATIVE_VARIANCE = 1e-3

# Relative variance that is added to energies, since these are rounded.
_RELATIVE_ROUNDING = 0.01

# Ratio of deviations above which levels or places differ. Between places, it reaches 1.12 on twelve pictures with white
# noise, and is 1.25 to 2.4 for blends of two exposures.
MIN_RATIO = 1.25

# Ratio of deviance required of a structure with more freedom. Level and place are often correlated, as where a noisy
# part is brighter; then the one that explains less is omitted.
_MAX_DEVIANCE_RATIO = 2 / 3

# Minimum share of quieter, and of noisier, neighbourhoods for places to differ; smaller shares are explained by the
# residual.
_MIN_SHARE = 0.1

# Ratio of variances of the noisiest and the quietest adjacent neighbourhood above which noise ends there. With the
# square of `MIN_RATIO`, ramps in pictures of 180 texels lose 0.4 dB by benchmarks/bench_regret.py.
_MIN_RATIO_AT_BORDER = 25

# Relative variance below which a neighbourhood is quiet, and its residual mostly texture.
_MAX_QUIET_VARIANCE = 0.25

# Exponent of the share of energy in quiet tiles or even cells that is trusted as noise. With 1, texture is taken for
# white noise, which costs 0.2 dB of PSNR.
_TRUST_EXPONENT = 3

# Share of clipped samples from which on the noise of a neighbourhood is underestimated.
MAX_CLIPPED_SHARE = 0.01


@dataclass(frozen=True, eq=False)
class Blocks:
    """Up to m blocks of about sixteen samples in each of P neighbourhoods; unknown values are infinite."""

    levels: Float32s  # of the pilot by channel, in steps of 8 bits, shape (3, P, m)
    energies: Float32s  # mean squares of the residual's details by channel, shape (3, P, m)
    unevenness: Float32s  # of the pilot, shape (P, m)

    @property
    def is_known(self) -> Bools:
        """Mask of existing blocks, shape (P, m)."""
        return np.isfinite(self.unevenness)


@dataclass(frozen=True, eq=False)
class Residual:
    """The residual of a pilot on some samples."""

    samples: Samples
    pilot: Samples
    removed: Samples

    @classmethod
    def of(cls, samples: Samples, variances: Float32s) -> Residual:
        """Compute the pilot that removes noise of some variances, in squared steps of 8 bits."""
        colours = samples.where.pilot(samples.colours, np.float32(_ASSUMED_NOISE**2) * variances)
        return cls(
            samples,
            dataclasses.replace(samples, colours=colours),
            dataclasses.replace(samples, colours=samples.colours - colours),
        )

    @property
    def correlation_of_neighbours(self) -> float:
        """Correlation of the residual between neighbouring samples; near 0 for white noise."""
        removed = self.removed.colours
        variance = float(np.mean(np.square(removed, dtype=np.float64)))
        return self.samples.where.product_of_neighbours(removed) / max(1e-9, variance)

    def stabilised(self, stabiliser: VarianceStabiliser, step: float) -> Residual:
        """Return the residual of stabilised colours; `step`: a step of 8 bits, of the stabiliser's full scale."""
        parts = []
        for part in (self.samples, self.pilot):
            colours = part.colours * np.float32(step)
            stabiliser.stabilise_in_place(colours)
            parts.append(dataclasses.replace(part, colours=colours / np.float32(step)))
        removed = dataclasses.replace(parts[0], colours=parts[0].colours - parts[1].colours)
        return Residual(parts[0], parts[1], removed)

    def blocks(self) -> Blocks:
        fine, coarse, *above = self.samples.where.scales[:4]
        freedom = coarse.freedom + coarse.sums(fine.freedom)
        energies = coarse.sums(fine.sums(_squares_in_blocks(self.removed))) / np.maximum(freedom, 1)
        within = coarse.sums(fine.sums(_squares_in_blocks(self.pilot).sum(axis=0))) / np.maximum(freedom, 1)
        around = _energies(self.pilot, 2) + above[1].spread(_energies(self.pilot, 3))
        uneven = within + above[0].spread(around) / 2
        cut_off = coarse.means(fine.means(self.samples.is_cut_off.max(axis=0).astype(np.float64)))
        used = coarse.is_whole & (freedom > 2) & (cut_off <= _MAX_CLIPPED_IN_BLOCK)
        return Blocks(
            coarse.padded(self.pilot.means[2], np.inf),
            coarse.padded(energies, np.inf),
            coarse.padded(np.where(used, uneven, np.inf), np.inf),
        )


def _squares_in_blocks(samples: Samples) -> Array:
    """Return the squared differences of samples from the means of their blocks, shape (3, n).

    Their sums equal those of the squared details of the finest two scales in each block.
    """
    fine, coarse = samples.where.scales[:2]
    return np.asarray(np.square(samples.means[0] - fine.spread(coarse.spread(samples.means[2]))))


def _energies(samples: Samples, number: int) -> Array:
    """Return the mean squared detail in each cell of a scale, summed over the channels."""
    scale = samples.where.scales[number]
    squares = np.square(scale.details(*samples.means[number : number + 2])).sum(axis=0)
    return np.asarray(scale.sums_of_details(squares) / np.maximum(scale.freedom, 1))


def even_covariance(residual: Residual, variances: Float64s) -> Float64s:
    """Return the covariance of components of single samples in even cells, shape (3, 3), in squared steps.

    It is divided by the relative variance of each neighbourhood, shape (P,). Quiet neighbourhoods are ignored.
    """
    finest = residual.samples.where.scales[0]
    unevenness = residual.pilot.unevenness(0) + residual.pilot.products[0][:3].sum(axis=0)
    uneven = finest.padded(np.where(finest.is_whole & (finest.freedom > 0), unevenness, np.inf), np.inf)
    known = np.isfinite(uneven) & (variances > _MAX_QUIET_VARIANCE)[:, None]
    energies = finest.padded(residual.samples.products[0][:3].sum(axis=0))
    if not known.any() or np.median(energies[known]) == 0:  # most cells are constant: no noise
        return np.zeros((3, 3))
    relative = uneven / variances[:, None]
    even = known & (relative <= np.quantile(relative[known], _EVEN_SHARE))
    weights = finest.padded(finest.freedom) * even
    products = finest.padded(residual.removed.products[0]) / variances[:, None].astype(np.float32)
    return symmetric(np.einsum("kpn,pn->k", products, weights, dtype=np.float64) / max(1.0, weights.sum()))


@dataclass(frozen=True, eq=False)
class LevelCurve:
    """Relative variances of the noise at ascending levels, shape (B,), and the number of blocks at each."""

    levels: Float64s  # of full scale 1
    variances: Float64s
    counts: Float64s

    @classmethod
    def of(cls, blocks: Blocks, channels: int) -> LevelCurve | None:
        """Measure even blocks of a number of channels; None if fewer than two levels have enough blocks."""
        sums, counts, known = np.zeros(_LEVEL_BINS), np.zeros(_LEVEL_BINS), blocks.is_known
        for levels, energies in zip(blocks.levels[:channels], blocks.energies[:channels], strict=True):
            bins = np.clip(levels[known] / STEPS * _LEVEL_BINS, 0, _LEVEL_BINS - 1).astype(np.intp)
            chosen = _most_even(bins, blocks.unevenness[known])
            of_channel = np.mean(energies[known][chosen]) if chosen.any() else 0.0
            if of_channel > 0:
                sums += np.bincount(bins[chosen], energies[known][chosen] / of_channel, _LEVEL_BINS)
                counts += np.bincount(bins[chosen], minlength=_LEVEL_BINS)
        enough = counts >= _MIN_BLOCKS
        if np.count_nonzero(enough) < 2:
            return None
        variances = np.maximum((sums + _PRIOR_BLOCKS) / (counts + _PRIOR_BLOCKS), _MIN_RELATIVE_VARIANCE)
        return cls(_MIDDLES[enough], variances[enough], counts[enough])

    @property
    def differs(self) -> bool:
        return bool(np.ptp(np.log2(self.variances)) > 2 * np.log2(MIN_RATIO))

    def at(self, levels: Float32s) -> Float32s:
        """Interpolate the relative variance at levels in steps of 8 bits."""
        found = levels.ravel() / STEPS
        # `levels` are a subset of the middles, so that the curve is the same through all of them, which are evenly
        # spaced.
        interpolate(found, _MIDDLES, np.interp(_MIDDLES, self.levels, self.variances))
        return np.asarray(found.reshape(levels.shape), np.float32)

    def stabiliser(self, full_scale: float) -> VarianceStabiliser:
        return VarianceStabiliser(full_scale * self.levels, np.sqrt(self.variances), self.counts, full_scale)


def _most_even(groups: Int64s, unevenness: Float32s) -> Bools:
    """Return which items are among the most even ones of their group."""
    order, counts = np.lexsort((unevenness, groups)), np.bincount(groups)
    ranks = np.empty(len(order), np.int64)
    ranks[order] = np.arange(len(order)) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.asarray(ranks < np.ceil(_EVEN_SHARE * counts)[groups])


@dataclass(frozen=True, eq=False)
class Structure:
    """Dependence of the noise variance on level and place, on one of them, or on neither."""

    curve: LevelCurve | None
    places: Float64s  # relative variance of each neighbourhood, of mean 1, shape (P,)

    @classmethod
    def even(cls, where: Neighbourhoods) -> Structure:
        """Return the structure of noise that is the same everywhere."""
        return cls(None, np.ones(where.count))

    @property
    def is_even(self) -> bool:
        return self.curve is None and not self.is_by_place

    @property
    def is_by_place(self) -> bool:
        return bool((self.places != 1).any())

    def variances(self, residual: Residual) -> Float32s:
        """Return the relative variance of each sample, averaged over channels, of mean 1."""
        where = residual.samples.where
        found = self.places[where.tiles].astype(np.float32)
        if self.curve is not None:
            found *= self.curve.at(residual.pilot.colours).mean(axis=0)
        return np.asarray(found / max(1e-9, float(found.mean())), np.float32)

    def over_samples(self, residual: Residual) -> Float32s:
        """Return the variance by place at each sample relative to its mean, a stack of one channel."""
        return residual.samples.where.over_samples(self.places, self._in_parts(residual))

    def _in_parts(self, residual: Residual) -> Float64s:
        """Return the relative variances of the parts of neighbourhoods at which noise ends; NaN for other parts.

        If the energy of a part is between those of the adjacent neighbourhoods, its variance is interpolated. Texture
        counts as quiet, and the quiet neighbourhood with the most energy represents all quiet ones.
        """
        where, squares = residual.samples.where, np.square(residual.removed.colours).mean(axis=0)
        if self.curve is not None:
            squares /= self.curve.at(residual.pilot.colours).mean(axis=0)
        parts: Array = np.stack([squares, np.ones_like(squares)])
        for scale in where.scales[:-1]:
            parts = scale.means(parts)
        last = where.scales[-1]
        energies, inner = (own[0] / np.maximum(own[1], 1e-9) for own in (last.means(parts), parts))
        places, energies = self.places[where.around], energies[where.around]
        least, most = places.min(axis=1), places.max(axis=1)
        loud = np.take_along_axis(energies, places.argmax(axis=1)[:, None], axis=1)[:, 0]
        quiet = np.where(places <= np.sqrt(least * most)[:, None], energies, 0).max(axis=1)
        shares = (inner - last.spread(quiet)) / np.maximum(last.spread(loud - quiet), 1e-9)
        found = last.spread(least) + shares.clip(0, 1) * last.spread(most - least)
        is_even = last.spread(most <= _MIN_RATIO_AT_BORDER * least) | (parts[1] == 0)
        return np.asarray(np.where(is_even, np.nan, found), np.float64)


@dataclass(frozen=True, eq=False)
class _Trial:
    """A structure, and its deviance from the energies in the residual of a pilot that follows it."""

    structure: Structure
    deviance: float

    @classmethod
    def of(cls, structure: Structure, before: Residual, sigma: float, channels: int) -> _Trial:
        """Compute a pilot that follows a structure measured on another pilot's residual."""
        blocks = Residual.of(before.samples, np.float32(sigma**2) * structure.variances(before)).blocks()
        if structure.curve is not None:
            curve = LevelCurve.of(blocks, channels)
            structure = structure if curve is None else dataclasses.replace(structure, curve=curve)
        return cls(structure, _deviance(blocks, structure))


def structure_of(
    residual: Residual, sigma: float, places: Float64s, channels: int, *, are_levels: bool
) -> Structure:
    """Find the dependence of the noise of some channels on level and place.

    The structure is chosen that best explains the energies left by its own pilot; one with more freedom must explain
    them better by a margin. `residual` is that of a pilot that assumes even noise; `places` are log2 of the deviations
    of neighbourhoods as read by the network; `sigma` is the RMS noise, in steps of 8 bits.
    """
    where = residual.samples.where
    even, blocks = Structure.even(where), residual.blocks()
    curve = LevelCurve.of(blocks, channels) if are_levels else None
    trial = partial(_Trial.of, before=residual, sigma=sigma, channels=channels)
    best = _Trial(even, _deviance(blocks, even))
    if curve is not None and curve.differs:
        best = min(best, trial(Structure(curve, even.places)), key=lambda own: own.deviance)
    by_place = trial(Structure(None, _with_quiet_tiles(residual, 4.0**places, sigma)))
    low, high = np.quantile(np.median(places[where.around], axis=1), (_MIN_SHARE, 1 - _MIN_SHARE))
    is_wide = high - low > np.log2(MIN_RATIO)
    is_better = by_place.deviance <= best.deviance
    is_much_better = by_place.deviance < _MAX_DEVIANCE_RATIO * best.deviance
    if is_better if is_wide else is_much_better:
        best = by_place
    if curve is not None and curve.differs:
        relative = _of_mean_1(4.0 ** (places - _logs_of_level(blocks, curve)))
        both = trial(Structure(curve, relative))
        if both.deviance < _MAX_DEVIANCE_RATIO * best.deviance:
            best = both
    return best.structure


def _logs_of_level(blocks: Blocks, curve: LevelCurve) -> Float64s:
    """Return log2 of the deviations of neighbourhoods expected from their levels, shape (P,)."""
    known = blocks.is_known
    logs = np.log2(curve.at(np.where(known, blocks.levels, 0))).mean(axis=0) / 2
    return np.asarray(np.where(known, logs, 0).sum(axis=1) / np.maximum(known.sum(axis=1), 1), np.float64)


def _with_quiet_tiles(residual: Residual, variances: Float64s, sigma: float) -> Float64s:
    """Reduce relative variances of neighbourhoods towards those of quieter tiles of a grid."""
    energies, variances = None, _of_mean_1(variances)
    if residual.samples.where.kind == "grid":
        shape = np.diag(even_covariance(residual, variances))
        energies = (
            quiet_energies(residual.samples, shape * (sigma**2 / shape.mean())) if shape.any() else None
        )
    if energies is not None:
        # Clipped squares show less noise than there is.
        is_known = np.isfinite(energies) & (residual.samples.cut_off() < MAX_CLIPPED_SHARE)
        energies = np.where(is_known, energies, variances)
        shares = shares_of_noise(variances, energies)
        variances = _of_mean_1(shares * energies + (1 - shares) * variances)
    return variances


def shares_of_noise(variances: Float64s, energies: Float64s) -> Float64s:
    """Return the share of energies that is trusted to be noise, given the variances read."""
    most = np.maximum(np.maximum(variances, energies), np.finfo(np.float64).tiny)
    return np.asarray((variances / most) ** _TRUST_EXPONENT, np.float64)


def _of_mean_1(variances: Float64s) -> Float64s:
    variances = np.maximum(variances, _MIN_RELATIVE_VARIANCE * variances.mean())
    return np.asarray(variances / variances.mean(), np.float64)


def _ratios(blocks: Blocks, curve: LevelCurve | None) -> tuple[Float64s, Bools]:
    """Return the ratios of blocks' energies to those of their levels, shape (P, m), and a mask of even blocks."""
    known = blocks.is_known
    levels = np.where(known, blocks.levels, 0)
    expected = 1.0 if curve is None else curve.at(levels).mean(axis=0)
    ratios = np.where(known, blocks.energies, 0).mean(axis=0) / np.maximum(expected, 1e-9)
    even = np.zeros_like(known)
    groups = np.broadcast_to(np.arange(len(known))[:, None], known.shape)[known]
    if len(groups):
        even[known] = _most_even(groups, blocks.unevenness[known])
    return ratios, even


def _deviance(blocks: Blocks, structure: Structure) -> float:
    """Return the mean gamma deviance of the energies of even blocks from a structure."""
    ratios, even = _ratios(blocks, structure.curve)
    if not even.any():
        return 0.0
    # Without noise, blocks have no energy at all.
    expected = np.broadcast_to(structure.places[:, None], even.shape)[even] + _RELATIVE_ROUNDING
    own = (ratios[even] / max(1e-9, float(ratios[even].mean())) + _RELATIVE_ROUNDING) / expected
    own /= own.mean()
    return float(np.mean(own - np.log(own) - 1))
