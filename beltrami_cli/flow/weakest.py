"""The noise level of a signal that is not only noise: told from the groups of samples where least else happens.

Edges and texture only add to the spread of a signal. So of many small groups of neighbouring samples, those with the
least spread show the noise alone; and how far the least of many noisy spreads lies below the noise is known.
"""

from __future__ import annotations

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

# In a picture as most are, some groups are busy with edges or texture, so a low quantile of all is a third higher a one
# of the others. In plain pictures the noise comes out a little too small by it, in rich ones too large.
_BUSY = 1 / 3

# A group without any spread holds no noise. Where so many do, there is none; fewer are plain areas that were painted
# after the noise came in, masked, or overexposed.
_PLAIN = 0.5

# Groups of a clipped colour of which the censored normal distribution can tell the noise: shares of samples at a limit.
_TELLING = (0.05, 0.6)

# What has a larger spread, of full scale 1, and stands at a limit is line art and no noise.
_LOUDEST = 1 / 3


def weakest_level(
    energy: NDArray[np.float64],
    freedom: float,
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    mean: NDArray[np.float64],
    free: float,
) -> float:
    """Estimate the standard deviation of noise from groups of samples of one channel.

    Parameters
    ----------
    energy : ndarray of float64, shape (M,)
        Mean square, in each group, of residuals that have the variance of the noise where there is nothing else.
    freedom : float
        Degrees of freedom of that mean: M independent residuals have M.
    low, high : ndarray of float64, shape (M,)
        Share of each group's samples that stand at 0, and at 1.
    mean : ndarray of float64, shape (M,)
        Mean colour of each group.
    free : float
        Share of the groups that are taken to be free of edges and texture.

    Returns
    -------
    float
        In the unit of the residuals; 0 without groups.

    Notes
    -----
    A low quantile of the energies is compared with that of the chi-square distribution. Groups with many samples at a
    limit are left out, for there noise was cut off. Where nearly all are such, the noise of each is that of a normal
    variable censored at the limit with the group's mean and share; see `clipping`.
    """
    if np.count_nonzero(energy) <= _PLAIN * len(energy):
        return 0.0
    near = low + high <= _NEARLY_WHOLE
    uncut = energy[near] / (variance_of_clipped(low[near]) * variance_of_clipped(high[near]))
    if len(uncut) >= max(_ENOUGH_GROUPS, _ENOUGH_SHARE * len(energy)):
        return _quantile_level(uncut, freedom, free)
    told = []
    for share, other, gap in ((low, high, mean), (high, low, 1 - mean)):
        # With samples at both limits there is an edge.
        telling = (share > _TELLING[0]) & (share < _TELLING[1]) & (other < _TELLING[0])
        sigma = sigma_of_clipped(gap[telling], share[telling])
        told.append(sigma[sigma < _LOUDEST] ** 2)
    censored = np.concatenate(told)
    # Such an estimate is as good as that of as many samples, and a group has fewer degrees of freedom than samples.
    enough = len(censored) >= _ENOUGH_GROUPS or not len(uncut)
    return _quantile_level(censored if enough else uncut, freedom, free)


def _quantile_level(energy: NDArray[np.float64], freedom: float, free: float) -> float:
    energy = energy[energy > 0]
    if not len(energy):
        return 0.0
    # Of few groups none may be free; the median stays closer to the noise than the least.
    share = max(free, min(0.5, 2 / len(energy)))
    idle = share * (1 + _BUSY * (1 - share))
    return float(np.sqrt(np.quantile(energy, share) / chi_square_quantile(freedom, idle)))


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
