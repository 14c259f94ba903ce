"""The noise level of a signal that is not only noise: told from the groups of samples where least else happens.

Edges and texture only add to the spread of a signal, so noise is looked for where they are weakest. There is little
detail where coarse means are even; and how uneven these are says nothing of the noise in the finest detail, for the two
are different parts of the signal. So the groups of neighbouring samples that are chosen by the one show the noise, and
no less than that, in the other [1]_.

References
----------
.. [1] X. Liu, M. Tanaka, M. Okutomi, "Single-image noise level estimation for blind denoising", IEEE Trans. Image
   Processing 22(12), 2013, doi:10.1109/TIP.2013.2283400: weak texture, found by turns with the noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.clipping import sigma_of_clipped, variance_of_clipped

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Groups with at most such a share of their samples at a limit lose little of their noise there, and how much is known.
# So many of them are enough to look at no others: of all, and at least.
_NEARLY_WHOLE = 0.2
_ENOUGH_SHARE, _ENOUGH_GROUPS = 0.02, 20

# A group without any spread holds no noise. Where so many do, there is none; fewer are plain areas that were painted
# after the noise came in, masked, or overexposed.
_PLAIN = 0.5

# Groups of a clipped colour of which the censored normal distribution can tell the noise: shares of samples at a limit.
_TELLING = (0.05, 0.6)

# What has a larger spread, of full scale 1, and stands at a limit is line art and no noise.
_LOUDEST = 1 / 3

# What is left of the noise's variance at least, where it is divided by; less, and next to nothing can be told.
_LEAST_LEFT = 1e-3

# Less variance than any stored colour can show.
_LEAST_VARIANCE = 1e-20

# A low quantile of the energies rather than their mean: of the even groups, some still hold an edge or a speck.
_QUANTILE = 0.3

# The noise tells which groups are even, and these tell the noise. The first guess, and what is believed at most, is a
# still lower quantile of all: where hardly a group is even, some still hold little else than noise by chance.
_FIRST_QUANTILE = 0.02
_TURNS = 3


@dataclass(frozen=True)
class Kind:
    """What is true of groups of white noise of variance 1, and how many are needed.

    Attributes
    ----------
    freedom : float
        Degrees of freedom of a group's energy: that of M independent residuals has M.
    unevenness, spread : float
        Mean of the groups' unevenness, and its standard deviation as a share of that.
    share, least : float, int
        Groups that are taken for even at least: of all, and in number.
    """

    freedom: float
    unevenness: float
    spread: float
    share: float
    least: int


@dataclass(frozen=True)
class Groups:
    """M groups of neighbouring samples with N channels: arrays of float64, shape (N, M).

    Attributes
    ----------
    energy : ndarray
        Mean square, in each group, of residuals that have the variance of the noise where there is nothing else.
    unevenness : ndarray
        Variance, in each group, of local means of colours.
    low, high : ndarray
        Share of each group's samples that stand at 0, and at 1.
    mean : ndarray
        Mean colour.
    """

    energy: NDArray[np.float64]
    unevenness: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    mean: NDArray[np.float64]

    @cached_property
    def left(self) -> NDArray[np.float64]:
        """What is left of the variance of noise that was cut off at the limits."""
        return np.maximum(variance_of_clipped(self.low) * variance_of_clipped(self.high), _LEAST_LEFT)


def weakest_levels(groups: Groups, kind: Kind) -> NDArray[np.float64]:
    """Estimate the standard deviation of noise per channel.

    Parameters
    ----------
    groups : Groups
        Of neighbouring samples.
    kind : Kind
        What they are of white noise.

    Returns
    -------
    ndarray of float64, shape (N,)
        In the unit of the residuals; 0 where there are no groups.

    Notes
    -----
    A low quantile of the energies of even groups is compared with that of the chi-square distribution. Groups with many
    samples at a limit are left out, for there noise was cut off. Where nearly all are such, the noise of each is that
    of a normal variable censored at the limit with the group's mean and share, see `clipping`; texture makes that
    larger than the residuals do, so the lesser of both is believed.
    """
    told = {}
    for channel in range(len(groups.energy)):
        if np.count_nonzero(groups.energy[channel]) > _PLAIN * groups.energy.shape[1]:
            usable, energies = _telling(groups, channel)
            if usable.any():
                told[channel] = usable, energies
    most = {channel: _least_level(*told[channel], kind.freedom, _FIRST_QUANTILE) for channel in told}
    variance = most.copy()
    for _ in range(_TURNS):
        detail, certain = _detail(groups, {channel: told[channel][0] for channel in told}, variance, kind)
        for channel, (usable, energies) in told.items():
            even = usable.copy()
            even[usable] = _even(detail[usable], certain[usable], kind)
            level = _least_level(even, energies, kind.freedom, _QUANTILE)
            variance[channel] = min(level, most[channel])
    sigma = np.zeros(len(groups.energy))
    sigma[list(variance)] = np.sqrt(list(variance.values()))
    return sigma


def _telling(groups: Groups, channel: int) -> tuple[NDArray[np.bool_], list[NDArray[np.float64]]]:
    """Choose the groups that tell of a channel's noise; return them, and what all groups say of its variance."""
    low, high, mean = groups.low[channel], groups.high[channel], groups.mean[channel]
    energy = groups.energy[channel] / groups.left[channel]
    whole = (low + high <= _NEARLY_WHOLE) & (energy > 0)
    if np.count_nonzero(whole) >= max(_ENOUGH_GROUPS, _ENOUGH_SHARE * len(energy)):
        return whole, [energy]
    censored = np.zeros(len(energy))
    for share, other, gap in ((low, high, mean), (high, low, 1 - mean)):
        # With samples at both limits there is an edge.
        cut = (share > _TELLING[0]) & (share < _TELLING[1]) & (other < _TELLING[0]) & (energy > 0)
        censored[cut] = sigma_of_clipped(gap[cut], share[cut]) ** 2
    telling = (censored > 0) & (censored < _LOUDEST**2)
    if np.count_nonzero(telling) >= _ENOUGH_GROUPS or not whole.any():
        return telling, [censored, energy]
    return whole, [energy]


def _detail(
    groups: Groups, usable: dict[int, NDArray[np.bool_]], variance: dict[int, float], kind: Kind
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compare the unevenness of groups with that of noise alone, as a mean over the channels that tell of a group.

    Channels share their texture, and not their noise.

    Returns
    -------
    detail, certain : ndarray of float64, shape (M,)
        That ratio, and of how many channels it is the mean.
    """
    total, certain = np.zeros(groups.energy.shape[1]), np.zeros(groups.energy.shape[1])
    left = groups.left
    for channel, known in usable.items():
        noise = kind.unevenness * max(variance[channel], _LEAST_VARIANCE)
        total[known] += groups.unevenness[channel, known] / (left[channel, known] * noise)
        certain += known
    return total / np.maximum(certain, 1), certain


def _even(detail: NDArray[np.float64], certain: NDArray[np.float64], kind: Kind) -> NDArray[np.bool_]:
    """Choose the groups as even as noise alone leaves them, but not too few."""
    excess = detail / (1 + kind.spread / np.sqrt(certain))
    wanted = max(kind.least, int(kind.share * len(detail)), int(np.count_nonzero(excess <= 1)))
    if wanted >= len(excess):
        return np.ones(len(excess), bool)
    most = np.partition(excess, wanted - 1)[wanted - 1]
    even: NDArray[np.bool_] = excess < most
    even[np.flatnonzero(excess == most)[: wanted - np.count_nonzero(even)]] = True  # of equal ones the first
    return even


def _least_level(
    groups: NDArray[np.bool_], energies: list[NDArray[np.float64]], freedom: float, share: float
) -> float:
    """Return the least variance that some groups' energies tell by their quantile."""
    # Of few groups none may be free; the median stays closer to the noise than the least.
    share = max(share, min(0.5, 2 / np.count_nonzero(groups)))
    return min(quantile(energy[groups], share) for energy in energies) / chi_square_quantile(freedom, share)


def quantile(values: NDArray[np.float64], share: float) -> float:
    """Return what NumPy's function does, which imports masked arrays, at a tenth of what a small mesh costs in all."""
    place = share * (len(values) - 1)
    below = int(place)
    above = min(below + 1, len(values) - 1)
    ordered = np.partition(values, [below, above])
    return float(ordered[below] + (place - below) * (ordered[above] - ordered[below]))


def chi_square_quantile(freedom: float, share: float) -> float:
    """Return a quantile of the chi-square distribution, divided by its degrees of freedom.

    Exact to a per cent, for ten degrees of freedom and more [1]_. SciPy has it exactly, and takes longer to be imported
    than a small mesh takes to be smoothed.

    References
    ----------
    .. [1] E. Wilson, M. Hilferty, "The distribution of chi-square", Proc. Nat. Acad. Sci. 17 (1931), 684-688,
       doi:10.1073/pnas.17.12.684
    """
    spread = 2 / (9 * freedom)
    return float((1 - spread + NormalDist().inv_cdf(share) * spread**0.5) ** 3)
