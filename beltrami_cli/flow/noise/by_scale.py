"""Noise by scale: whether neighbours share it, as in resampled photographs and after JPEG, and how much of it.

Details of single samples, of means of some four neighbours, of some sixteen, and so on, are measured, see `by_level`.
Independent noise is as strong in all of them; noise that neighbours share is weaker in the finer ones, and is as strong
in all from a scale on, while textures keep growing. In photographs, textures are weakest in the differences of
channels: these show whether noise is shared, and bound what is taken for noise in their mean.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Float64s
from beltrami_cli.flow.noise.by_level import OPPONENTS, Neighbourhoods, fit_by_level, most_even, stabiliser_of
from beltrami_cli.flow.noise.stabilising import VarianceStabiliser

# Scales that are measured; in the last, and in coarser ones, noise is as strong.
SCALES = 4

# Noise is shared if it grows by these factors from single cells to the second and third scale ...
_GROWS, _GROWS_TWICE = 1.35, 1.6
# ... in all components by less than this from there on ...
_EVEN, _LEAST_SIGMA = 1.6, 1.25 / 255
# ... and then by less than this, unlike texture; for one channel alone, where there is more texture, by less than ...
_MOST_GROWTH, _MOST_ALONE = 2.7, 1.6
# ... and if it is larger than what clean photographs hold at these scales.
_LEAST_MIDDLE, _LEAST_COARSE = 3.75 / 255, 4 / 255

# Noise of the finest details, relative to that of the diagonal ones among them at most.
_MOST_OF_DIAGONAL = 3.0

# Growth of the mean of channels from single cells to the second scale, beyond which it is texture.
_PLAIN_GROWTH = 2.2

# Growth of the mean of channels from single cells to the second scale, beyond which even flat places are texture, where
# few colours are cut off. Differences of channels with less noise than the last were perhaps taken from them by JPEG.
_NOWHERE_FLAT, _FEW_CUT_OFF, _LEAST_DIFFERENCES = 1.2, 0.1, 1 / 255

# What is stronger than this in the mean of channels, and than this factor of what their differences hold, is texture.
_STRONG, _FAR_ABOVE = 40 / 255, 2.0

# Independent noise, relative to that of the finest details, at most: both are estimates.
_SLACK = 1.1

# Details that no filter makes of white noise: at the third scale this much larger than at the first, and strong.
_UNFILTERED, _RELIEF = 9.0, 30 / 255

# Differences of channels, relative to their mean, beyond which they are hues: noise has 0.2 to 1.2 in them.
_MOST_HUED = 2.0

# Growth to the last scale, below which noise has reached its full size.
_LEVEL, _ALIKE = 1.5, 2.0

# Growth to the last scale, beyond which there is texture.
_TEXTURE = 2.5

# Growth to the last scale, relative to that before, from which on texture begins there.
_BEGINS = 1.5

# JPEG keeps the finest noise of the mean of channels: that of coarse differences is no larger than this factor of it.
_COLOURLESS = 1.3

# JPEG leaves white noise in the mean of channels. It grows by less than the first of these from single cells to the
# second scale, as no texture does, and from there to the third it grows or falls by less than the second. Beneath
# texture of the third scale, it grows by less than the last from single cells on: on vertices more than on grids.
_MOST_FROM_FINEST, _EVEN_MEAN, _AS_FINE = 2.2, 1.6, 1.4

# It leaves less than the first of these shares of the finest in a difference of channels, or the second where noise is
# weak, as texture of paint is, and the third if its mean is even; with less than that, differences need not grow as
# much to the third scale. It leaves coarse noise: what is larger than the last factor of it in the mean of channels is
# texture, and an even mean is at most that.
_LEFT, _LEFT_OF_WEAK, _LITTLE, _WEAK, _MOST_ABOVE = 0.5, 0.2, 0.3, 7 / 255, 3.0

# Noise of the mean of channels and of their differences, relative to the smaller one of these at most.
_MOST_APART = 1.2

# A mosaic has twice as many greens, between which less is interpolated: of the finest noise, what green differs by from
# red and blue holds more, by this factor.
_OF_GREEN = 1.35

# The scale at which channels are compared, where noise has little of a mosaic's pattern; and their noise, relative to
# that of the mean of channels and their differences, at most.
SCALE_OF_CHANNELS, _MOST_OF_CHANNEL = 1, 2.0

# Where more than the first share of all neighbourhoods, fully from the second, hold nothing but noise in the mean of
# channels, with up to so many times its energy, noise is taken to be stronger by the last factor. In plain pictures
# what is left costs more than what is lost.
_PLAIN, _PLAIN_THROUGHOUT, _NOTHING_ELSE, _STRONGER = 0.4, 0.6, 2.0, 1.05

# Growth of noise in differences of channels from single cells to the second scale, beyond which JPEG has taken it.
_MOST_AT_SECOND = 2.5

# Noise of the last scale, relative to the one before at most: on small grids there are few tiles without texture. What
# low-pass filters make of white noise grows less from scale to scale, by 1.35 and 1.12 after demosaicing, by 2.1 and
# 1.4 where grain is 3 wide: by no more than this power of what it grew by before, both less 1.
_MOST_AT_LAST, _SLOWS = 1.5, 3

# Steps keep some noise as a few large details, which quiet tiles do not show: at least this share of the next scale.
_LEAST_OF_NEXT = 0.25
# JPEG with colour at half the resolution leaves this much less of the finest details in differences of channels than in
# their mean. What it took with them is not known.
_THINNED = 4.0


@dataclass(frozen=True)
class FoundNoise:
    """What was found besides independent noise that is the same at all levels."""

    stabiliser: VarianceStabiliser | None = None
    covariances: Float64s | None = None  # of stabilised colours, shape (L, N, N), see `haar_noise`
    doubt: float = 0.0  # mean square of what may be missing because of JPEG; infinite: nobody can tell
    sigma: Float64s | None = None  # of stabilised colours, by channel, once that is known
    most: float = np.inf  # independent noise of each of the first channels at most


def noise_of_scales(
    scales: Sequence[Neighbourhoods],
    mixing: Float64s,
    channels: int,
    alone: Callable[[], Float64s],
    *,
    by_level: bool,
) -> FoundNoise:
    """Find how noise depends on the level, if it may, and what neighbours share; `alone`: sigma if they share nothing.

    `mixing` is that of the first channels into components.
    """
    found = fit_by_level(scales, mixing)
    if found is None:
        return FoundNoise()
    at_most = np.array([np.broadcast_to(own.most, len(mixing)) for own in scales[: len(found.sigma)]])
    found = dataclasses.replace(found, sigma=np.minimum(found.sigma, at_most))
    stabiliser = stabiliser_of(found) if by_level else None
    doubt = _doubt(found.sigma)
    if not is_shared(found.sigma):
        scale = 1.0 if stabiliser is None else stabiliser.scale
        # Where much is cut off, little else than this bound says how much noise there was.
        finest = _SLACK * float(np.sqrt(np.mean(np.square(found.sigma[0]))))
        most = scale * min(_most_independent(found.sigma, scales[0].cut_off), finest)
        return FoundNoise(stabiliser, doubt=doubt, most=most)
    count, independent = len(mixing), alone()
    sigma = _bounded(found.sigma, float(np.sqrt(np.mean(independent[:count] ** 2))))
    sigma *= _allowance(scales, sigma)
    if stabiliser is not None:
        sigma = sigma * stabiliser.scale
    covariances = np.zeros((SCALES, channels, channels))
    covariances[:, :count, :count] = np.einsum("ki,lk,kj->lij", mixing, sigma**2, mixing)
    if stabiliser is None:
        factors = _of_channels(scales, np.diag(covariances[SCALE_OF_CHANNELS])[:count])
        covariances[:, :count, :count] *= factors[:, None] * factors
    rest = np.arange(count, channels)  # other channels have noise of their own
    covariances[:, rest, rest] = independent[count:] ** 2
    return FoundNoise(stabiliser, covariances, doubt)


def _allowance(scales: Sequence[Neighbourhoods], sigma: Float64s) -> float:
    """Return by what factor noise is taken to be stronger, for the neighbourhoods that hold nothing else."""
    if len(scales) <= SCALE_OF_CHANNELS or sigma.shape[1] < len(OPPONENTS):
        return 1.0
    noise = sigma[SCALE_OF_CHANNELS, 1:].min() ** 2
    share = float(np.mean(scales[SCALE_OF_CHANNELS].energy[0] < _NOTHING_ELSE * noise))
    return float(np.interp(share, (_PLAIN, _PLAIN_THROUGHOUT), (1, _STRONGER)))


def _of_channels(scales: Sequence[Neighbourhoods], variances: Float64s) -> Float64s:
    """Return by what factor the noise of each channel differs from what its components say, which keep its size.

    Differences of channels say nothing of which of both is noisier.
    """
    own = scales[SCALE_OF_CHANNELS] if len(scales) > SCALE_OF_CHANNELS else None
    if own is None or own.by_channel is None:
        return np.ones(len(variances))
    measured = own.by_channel[:, most_even(own.unevenness)].mean(axis=1)
    measured *= variances.sum() / measured.sum()
    factors: Float64s = np.sqrt(measured / variances)
    return factors.clip(1 / _MOST_OF_CHANNEL, _MOST_OF_CHANNEL)


def _most_independent(sigma: Float64s, cut_off: float) -> float:
    """Return what differences of channels hold of noise, if their mean shows that even quiet places are texture."""
    if sigma.shape[1] != len(OPPONENTS) or len(sigma) < 3 or np.isnan(sigma[:3]).any():
        return float(np.inf)
    fine, middle, coarse = sigma[:3, 0]
    most = float(max(np.sqrt(np.mean(sigma[0, 1:] ** 2)), sigma[1, 1:].min()))
    # Where JPEG may have taken noise from the differences, and the finest of the mean, this has to grow further.
    is_texture = middle > _NOWHERE_FLAT * fine and (most > _LEAST_DIFFERENCES or coarse > _EVEN_MEAN * middle)
    is_texture &= cut_off < _FEW_CUT_OFF
    is_texture |= fine > max(_STRONG, _FAR_ABOVE * most)
    return max(most, _LEAST_DIFFERENCES) if is_texture else float(np.inf)


def _doubt(sigma: Float64s) -> float:
    """Return the mean square of what JPEG may have taken or left, by the standard deviations of noise by scale."""
    if sigma.shape[1] != len(OPPONENTS) or len(sigma) < 2 or np.isnan(sigma[:2]).any():
        return 0.0
    return float(sigma[1, 0] ** 2 / 3) if sigma[0, 0] > _THINNED * sigma[0, 1:].max() else 0.0


def is_shared(sigma: Float64s) -> bool:
    """Whether neighbours share noise, by its standard deviation at each scale, shape (L, K)."""
    if _level_of_mean(sigma) is not None:
        return True
    components = sigma[:, 1:] if sigma.shape[1] == 3 else sigma
    if len(sigma) < 3 or np.isnan(components[:3]).any():
        return False
    fine, middle, coarse = components[:3].min(axis=1)
    if max(middle / sigma[1, 0], coarse / sigma[2, 0]) > _MOST_HUED:
        return False
    if coarse > max(_UNFILTERED * fine, _RELIEF) and not _levels_off(sigma):
        return False
    coarsest = components[3].min() if len(sigma) > 3 and not np.isnan(components[3]).any() else None
    most = _MOST_GROWTH if sigma.shape[1] == 3 else _MOST_ALONE
    # Texture keeps growing in all components; noise that does not may be small.
    if coarsest is not None and np.all(sigma[2] < _EVEN * sigma[1]) and np.all(sigma[3] < _EVEN * sigma[2]):
        return bool(coarse > _GROWS_TWICE * fine and coarse > _LEAST_SIGMA)
    if coarsest is not None and coarsest > _TEXTURE * coarse:
        # Unless growth had slowed down before, as that of noise does.
        slows = sigma.shape[1] == 3 and np.all(components[2] * components[0] < components[1] ** 2)
        if not (slows and coarsest * middle > _BEGINS * coarse**2):
            return False
    grows = middle > _GROWS * fine and coarse < most * middle and max(middle, coarse / 2) > _LEAST_MIDDLE
    is_plain = sigma[1, 0] < _PLAIN_GROWTH * sigma[0, 0]
    plain = sigma[1, 0] if is_plain else sigma[0, 0]
    lost = coarse > _GROWS_TWICE * fine and coarse > _LEAST_COARSE
    lost &= coarsest is not None and coarsest < most * coarse and coarse < _COLOURLESS * plain
    # Or JPEG has taken the finest noise from the differences of channels, and that of their mean shows no texture.
    taken = sigma.shape[1] == 3 and middle > _MOST_AT_SECOND * fine and middle > _LEAST_MIDDLE
    taken &= bool(is_plain)
    return bool(grows or lost or taken or _levels_off(sigma))


def _level_of_mean(sigma: Float64s) -> float | None:
    """Return the level of white noise in the mean of channels, if differences of channels have less of it."""
    if sigma.shape[1] != len(OPPONENTS) or len(sigma) < 3 or np.isnan(sigma[:3]).any():
        return None
    fine, middle, coarse = sigma[:3, 0]
    if middle < _LEAST_MIDDLE or middle > _EVEN_MEAN * coarse:
        return None
    is_even, ends_even = middle < _AS_FINE * fine, coarse < _EVEN_MEAN * middle
    share = _LEFT if middle > _WEAK else _LITTLE if is_even and ends_even else _LEFT_OF_WEAK
    finest, differences = sigma[0, 1:], sigma[2, 1:]
    growth = np.where(finest < _LITTLE * fine, _GROWS, _GROWS_TWICE)
    taken = finest < share * fine
    taken &= (differences > growth * finest) | (finest < _LEAST_DIFFERENCES)
    if not taken.any():
        return None
    if middle < _MOST_FROM_FINEST * fine and ends_even:
        level = max(fine, middle, coarse)
    elif is_even:
        level = max(fine, middle)
    else:
        return None
    most = _MOST_ABOVE * np.nanmax(sigma[1:, 1:].min(axis=1))
    return float(min(level, most)) if most > _LEAST_MIDDLE and (is_even or level < most) else None


def _levels_off(sigma: Float64s) -> bool:
    """Whether differences of channels, and their mean as well, stop growing at the last scale, as coarse grain does."""
    if sigma.shape != (SCALES, len(OPPONENTS)) or np.isnan(sigma[:, 1:]).any():
        return False
    fine, _, coarse, coarsest = sigma[:, 1:].min(axis=1)
    if sigma[2, 0] > _ALIKE * coarse:
        return False
    return bool(coarse > 2 * _GROWS_TWICE * fine and coarse > _LEAST_COARSE and coarsest < _LEVEL * coarse)


def _bounded(sigma: Float64s, diagonal: float) -> Float64s:
    """Return the standard deviations of noise, shape (SCALES, K), without what is texture; `diagonal`: see `grid`."""
    known = np.full((SCALES, sigma.shape[1]), np.nan)
    known[: len(sigma)] = sigma
    for scale in range(1, SCALES):
        known[scale] = np.where(np.isnan(known[scale]), known[scale - 1], known[scale])
    of_mean = np.maximum.accumulate(known[:, 0])
    if not _levels_off(sigma):
        known[2] = np.minimum(known[2], _MOST_GROWTH * known[1])
    growth = np.minimum(1 + np.maximum(known[-2] / known[-3] - 1, 0) ** _SLOWS, _MOST_AT_LAST)
    known[-1] = np.minimum(known[-1], growth * known[-2])
    if sigma.shape[1] == 3:
        differences = known[:, 1:].min(axis=1)
        most = np.broadcast_to(_MOST_APART * differences[:, None], (SCALES, 2)).copy()
        most[0, -1] *= _OF_GREEN
        known[:, 1:] = np.minimum(known[:, 1:], most)
        # JPEG takes the finest noise from the differences, and not from the mean, which shows if it is no texture.
        bounds = differences.copy()
        if differences[1] > _MOST_AT_SECOND * differences[0]:
            bounds[0] = min(differences[:3].max(), _MOST_OF_DIAGONAL * diagonal / _MOST_APART)
            bounds[1] = max(differences[1], min(known[0, 0] / _MOST_APART, bounds[0]) * _GROWS)
            for scale in (0, 1):
                if known[scale + 1, 0] < _GROWS * known[scale, 0]:
                    bounds[scale:] = np.maximum(bounds[scale:], known[scale, 0] / _MOST_APART)
        known[:, 0] = np.minimum(known[:, 0], _MOST_APART * bounds)
        level = _level_of_mean(sigma)
        if level is not None:
            known = np.minimum(known, level)
            known[:, 0] = np.minimum(of_mean, level)
    for scale in reversed(range(SCALES - 1)):
        known[scale] = np.maximum(known[scale], _LEAST_OF_NEXT * known[scale + 1])
    return known
