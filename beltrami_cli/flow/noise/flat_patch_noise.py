"""The noise level of a signal that is not only noise, estimated from the patches of samples with the least texture.

Edges and texture only add to the spread of a signal, so noise is measured where they are weakest. There is little
detail where coarse means are even; and the unevenness of these is independent of the noise in the finest detail,
because the two are different parts of the signal. So patches that are chosen by the one show the noise, and no less
than that, in the other [1]_.

A low quantile of the energies of flat patches is compared with that of the chi-square distribution, exact to a per cent
for ten degrees of freedom and more [2]_; noise that was cut off has fewer of them, as its squares scatter more. Patches
with many samples at a limit are left out, because noise was cut off there. Where nearly all are such, the noise of each
is that of a normal variable censored at the limit with the patch's mean and share, see `clipping`; texture makes that
larger than it makes the residuals, so the smaller of both is used.

References
----------
.. [1] X. Liu, M. Tanaka, M. Okutomi, "Single-image noise level estimation for blind denoising", IEEE Trans. Image
   Processing 22(12), 2013, doi:10.1109/TIP.2013.2283400: weak texture, found in turn with the noise.
.. [2] E. Wilson, M. Hilferty, "The distribution of chi-square", Proc. Nat. Acad. Sci. 17 (1931), 684-688,
   doi:10.1073/pnas.17.12.684
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from statistics import NormalDist

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float64s
from beltrami_cli.flow.clipping import freedom_of_clipped, sigma_of_clipped, variance_of_clipped

# Patches with at most this share of their samples at a limit lose little of their noise there, and how much is known.
# If there are this many of them (as a share, and in number), no others are used.
_NEARLY_UNCLIPPED = 0.2
_ENOUGH_SHARE, _ENOUGH_PATCHES = 0.02, 20

# A patch without any spread holds no noise. If this share of the patches is plain, there is no noise; fewer are plain
# areas that were painted after the noise came in, masked, or overexposed. In the other patches noise leaves no equal
# neighbours: if so many samples have such, as beside text, there is none.
_PLAIN, MOST_EQUAL = 0.5, 0.4

# Shares of samples at a limit for which the censored normal distribution gives the noise of a clipped colour.
_CENSORED_SHARES = (0.05, 0.6)

# What has a larger spread, of full scale 1, and is at a limit is line art and no noise.
_MAX_CENSORED_SIGMA = 1 / 3

# Fewer samples than this do not tell noise from paint, as of an icon. What is as large as this share of the range that
# colours have is no noise, of which the range is larger.
FEWEST_SAMPLES, _MOST_OF_RANGE = 300, 0.4

# Bound on the remaining variance of clipped noise, which is divided by; below it the noise cannot be estimated.
_LEAST_REMAINING = 1e-3

# Less variance than any stored colour can show.
_LEAST_VARIANCE = 1e-20

# Degrees of freedom of a patch below which its energy says next to nothing, and the approximation of quantiles fails.
_LEAST_FREEDOM = 3

# A low quantile of the energies rather than their mean: some of the flat patches still hold an edge or a speck.
_QUANTILE = 0.3

# The noise shows which patches are flat, and these show the noise. The first guess, and upper bound, is a still lower
# quantile of all: where hardly a patch is flat, some still hold little else than noise by chance.
_FIRST_QUANTILE = 0.02
_ROUNDS = 3


@dataclass(frozen=True)
class WhiteNoise:
    """Statistics of patches of white noise of variance 1, and how many patches are needed."""

    freedom: float  # degrees of freedom of a patch's energy: M for M independent residuals
    unevenness: float  # mean over patches
    spread: float  # standard deviation of the unevenness, as a share of its mean
    share: float  # of the patches that are taken for flat at least ...
    minimum: int  # ... and their number


@dataclass(frozen=True)
class Patches:
    """M patches of neighbouring samples with N channels: arrays of float64, shape (N, M)."""

    energy: Float64s  # mean square of residuals that have the variance of the noise in flat areas
    unevenness: Float64s  # variance of local means of colours
    low: Float64s  # share of samples at 0
    high: Float64s  # share of samples at 1
    mean: Float64s  # mean colour
    equal: Float64s  # share of samples whose neighbours are all equal to them

    @cached_property
    def remaining(self) -> Float64s:
        """The share of the variance of noise that clipping at the limits has left."""
        return np.maximum(variance_of_clipped(self.low) * variance_of_clipped(self.high), _LEAST_REMAINING)


def flat_patch_sigma(patches: Patches, white: WhiteNoise) -> Float64s:
    """Estimate sigma of the noise per channel, shape (N,), in the unit of the residuals; 0 without patches."""
    if white.freedom < _LEAST_FREEDOM:
        return np.zeros(len(patches.energy))
    usable, estimates = {}, {}
    for channel in range(len(patches.energy)):
        varied = patches.energy[channel] > 0
        is_plain = np.count_nonzero(varied) <= _PLAIN * len(varied)
        if not is_plain and patches.equal[channel, varied].mean() < MOST_EQUAL:
            chosen, energies = _usable(patches, channel)
            if chosen.any():
                usable[channel], estimates[channel] = chosen, energies
    freedom = {
        k: white.freedom * float(freedom_of_clipped((patches.low + patches.high)[k, usable[k]]).mean())
        for k in usable
    }
    bound = {k: _variance(usable[k], estimates[k], freedom[k], _FIRST_QUANTILE) for k in usable}
    variance = bound.copy()
    for _ in range(_ROUNDS):
        texture, channels = _texture(patches, usable, variance, white)
        for channel, chosen in usable.items():
            flat = chosen.copy()
            flat[chosen] = _flattest(texture[chosen], channels[chosen], white)
            level = _variance(flat, estimates[channel], freedom[channel], _QUANTILE)
            variance[channel] = min(level, bound[channel])
    sigma = np.zeros(len(patches.energy))
    sigma[list(variance)] = np.sqrt(list(variance.values()))
    return sigma


def noise_or_paint(sigma: Float64s, ranges: Array) -> Float64s:
    """Return sigma, 0 for channels that it is too large for; `ranges`: the largest less the least colour of each."""
    return np.where(sigma < _MOST_OF_RANGE * ranges, sigma, 0.0)


def _usable(patches: Patches, channel: int) -> tuple[Bools, list[Float64s]]:
    """Choose the patches that show a channel's noise; return them, and estimates of its variance from every patch."""
    low, high, mean = patches.low[channel], patches.high[channel], patches.mean[channel]
    energy = patches.energy[channel] / patches.remaining[channel]
    unclipped = (low + high <= _NEARLY_UNCLIPPED) & (energy > 0)
    if np.count_nonzero(unclipped) >= max(_ENOUGH_PATCHES, _ENOUGH_SHARE * len(energy)):
        return unclipped, [energy]
    censored = np.zeros(len(energy))
    for share, other, gap in ((low, high, mean), (high, low, 1 - mean)):
        # With samples at both limits there is an edge.
        cut = (
            (share > _CENSORED_SHARES[0])
            & (share < _CENSORED_SHARES[1])
            & (other < _CENSORED_SHARES[0])
            & (energy > 0)
        )
        censored[cut] = sigma_of_clipped(gap[cut], share[cut]) ** 2
    in_range = (censored > 0) & (censored < _MAX_CENSORED_SIGMA**2)
    if np.count_nonzero(in_range) >= _ENOUGH_PATCHES or not unclipped.any():
        return in_range, [censored, energy]
    return unclipped, [energy]


def _texture(
    patches: Patches, usable: dict[int, Bools], variance: dict[int, float], white: WhiteNoise
) -> tuple[Float64s, Float64s]:
    """Return the unevenness of M patches relative to noise, a mean over channels, and the number of these."""
    # Channels share their texture, but not their noise.
    total, channels = np.zeros(patches.energy.shape[1]), np.zeros(patches.energy.shape[1])
    remaining = patches.remaining
    for channel, known in usable.items():
        noise = white.unevenness * max(variance[channel], _LEAST_VARIANCE)
        total[known] += patches.unevenness[channel, known] / (remaining[channel, known] * noise)
        channels += known
    return total / np.maximum(channels, 1), channels


def _flattest(texture: Float64s, channels: Float64s, white: WhiteNoise) -> Bools:
    """Choose the patches that are as even as noise alone leaves them, but not too few."""
    excess = texture / (1 + white.spread / np.sqrt(channels))
    wanted = max(white.minimum, int(white.share * len(texture)), int(np.count_nonzero(excess <= 1)))
    if wanted >= len(excess):
        return np.ones(len(excess), bool)
    limit = np.partition(excess, wanted - 1)[wanted - 1]
    flat: Bools = excess < limit
    flat[np.flatnonzero(excess == limit)[: wanted - np.count_nonzero(flat)]] = True  # of equal ones the first
    return flat


def _variance(chosen: Bools, energies: list[Float64s], freedom: float, share: float) -> float:
    """Estimate the variance from a quantile of the patches' energies, the smallest of several estimates."""
    # Of few patches none may be free of texture; the median is closer to the noise than the minimum.
    share = max(share, min(0.5, 2 / np.count_nonzero(chosen)))
    return min(quantile(energy[chosen], share) for energy in energies) / chi_square_quantile(freedom, share)


def quantile(values: Float64s, share: float) -> float:
    """Return what numpy.quantile does, whose import of masked arrays takes a tenth of the time of a small mesh."""
    place = share * (len(values) - 1)
    below = int(place)
    above = min(below + 1, len(values) - 1)
    ordered = np.partition(values, [below, above])
    return float(ordered[below] + (place - below) * (ordered[above] - ordered[below]))


def chi_square_quantile(freedom: float, share: float) -> float:
    """Return a quantile of the chi-square distribution, divided by its degrees of freedom [2]_."""
    # SciPy has it exactly, and takes longer to import than a small mesh takes to smooth.
    spread = 2 / (9 * freedom)
    return float((1 - spread + NormalDist().inv_cdf(share) * spread**0.5) ** 3)
