"""Search for the dependence of the noise on level and place, by residuals of pilots that know the size of the noise."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Float64s
from beltrami_cli.flow.noise.neighbourhoods import Neighbourhoods
from beltrami_cli.flow.noise.residual import Blocks, Residual, shares_of_noise
from beltrami_cli.flow.noise.structure import MIN_RATIO, MIN_RELATIVE_VARIANCE, LevelCurve, Structure

# Relative variance that is added to energies, since these are rounded.
_RELATIVE_ROUNDING = 0.01

# Ratio of deviance required of a structure with more freedom. Level and place are often correlated, as where a noisy
# part is brighter; then the one that explains less is omitted.
_MAX_DEVIANCE_RATIO = 2 / 3

# Minimum share of quieter, and of noisier, neighbourhoods for places to differ; smaller shares are explained by the
# residual.
_MIN_SHARE = 0.1


@dataclass(frozen=True, eq=False)
class _Fit:
    """A structure, and its deviance from the energies in the residual of a pilot that follows it."""

    structure: Structure
    deviance: float

    def explains_more_than(self, other: _Fit) -> bool:
        return self.deviance < _MAX_DEVIANCE_RATIO * other.deviance


def find_structure(
    residual: Residual, sigma: float, place_logs: Float64s, count: int, *, are_levels: bool
) -> Structure:
    """Find the dependence of the noise of the first `count` channels on level and place.

    The structure is chosen that best explains the energies left by its own pilot. Places that are read to be similar
    must explain them better by a margin, and so must level and place together.

    `residual` is that of a pilot that assumes uniform noise; `place_logs` are log2 of the deviations of neighbourhoods
    as read by the network; `sigma` is the RMS noise, in steps of 8 bits.
    """

    def fit(structure: Structure) -> _Fit:
        left = structure.residual(residual, sigma).blocks()
        again = None if structure.curve is None else LevelCurve.of(left, count)
        structure = structure if again is None else dataclasses.replace(structure, curve=again)
        return _Fit(structure, _deviance(left, structure))

    neighbourhoods, blocks = residual.channels.neighbourhoods, residual.blocks()
    uniform = Structure.uniform(neighbourhoods)
    best = _Fit(uniform, _deviance(blocks, uniform))
    curve = LevelCurve.of(blocks, count) if are_levels else None
    if curve is not None and not curve.differs:
        curve = None
    if curve is not None:
        best = min(best, fit(Structure(curve, uniform.place_variances)), key=lambda each: each.deviance)
    by_place = fit(Structure(None, _with_quiet_tiles(residual, 4.0**place_logs, sigma)))
    is_as_good = by_place.deviance <= best.deviance and _differ(place_logs, neighbourhoods)
    if is_as_good or by_place.explains_more_than(best):
        best = by_place
    if curve is not None:
        relative = _of_mean_1(4.0 ** (place_logs - _logs_of_level(blocks, curve)))
        by_both = fit(Structure(curve, relative))
        if by_both.explains_more_than(best):
            best = by_both
    return best.structure


def _differ(place_logs: Float64s, neighbourhoods: Neighbourhoods) -> bool:
    """Whether places have different noise: a tenth of them much less than another tenth."""
    medians = np.median(place_logs[neighbourhoods.around], axis=1)
    low, high = np.quantile(medians, (_MIN_SHARE, 1 - _MIN_SHARE))
    return bool(high - low > np.log2(MIN_RATIO))


def _logs_of_level(blocks: Blocks, curve: LevelCurve) -> Float64s:
    """Return log2 of the deviations of neighbourhoods expected from their levels, shape (P,)."""
    known = blocks.is_known
    logs = np.log2(curve.at(np.where(known, blocks.levels, 0))).mean(axis=0) / 2
    return np.asarray(np.where(known, logs, 0).sum(axis=1) / np.maximum(known.sum(axis=1), 1), np.float64)


def _with_quiet_tiles(residual: Residual, variances: Float64s, sigma: float) -> Float64s:
    """Reduce relative variances of neighbourhoods towards the variances of their quieter tiles."""
    variances, channels = _of_mean_1(variances), residual.channels
    shape = np.diag(residual.even_covariance(variances))
    if not shape.any():
        return variances
    energies = channels.neighbourhoods.quiet_energies(channels, shape * (sigma**2 / shape.mean()))
    if energies is None:
        return variances
    # Clipped squares show less noise than there is.
    is_known = np.isfinite(energies) & channels.is_unclipped
    energies = np.where(is_known, energies, variances)
    shares = shares_of_noise(variances, energies)
    return _of_mean_1(shares * energies + (1 - shares) * variances)


def _of_mean_1(variances: Float64s) -> Float64s:
    variances = np.maximum(variances, MIN_RELATIVE_VARIANCE * variances.mean())
    return np.asarray(variances / variances.mean(), np.float64)


def _deviance(blocks: Blocks, structure: Structure) -> float:
    """Return the mean gamma deviance of the energies of even blocks from a structure."""
    known = blocks.is_known
    by_level = structure.at_levels(np.where(known, blocks.levels, 0))
    energies = np.where(known, blocks.energies, 0).mean(axis=0) / np.maximum(by_level, 1e-9)
    even = np.zeros_like(known)
    even[known] = blocks.most_even(np.nonzero(known)[0])
    if not even.any():
        return 0.0
    # Without noise, blocks have no energy at all.
    expected = np.broadcast_to(structure.place_variances[:, None], even.shape)[even] + _RELATIVE_ROUNDING
    ratios = (energies[even] / max(1e-9, float(energies[even].mean())) + _RELATIVE_ROUNDING) / expected
    ratios /= ratios.mean()
    return float(np.mean(ratios - np.log(ratios) - 1))
