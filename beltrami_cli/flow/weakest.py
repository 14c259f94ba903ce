"""The noise level of a signal that is not only noise: told from the groups of samples where least else happens.

Edges and texture only add to the spread of a signal. So of many small groups of neighbouring samples, those with the
least spread show the noise alone; and how far the least of many noisy spreads lies below the noise is known.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.clipping import sigma_of_clipped

if TYPE_CHECKING:
    from numpy.typing import NDArray

# The share of the groups that are taken to be free of edges and texture. On painted, baked and photographed textures
# with noise of 2 to 40 of 255, estimates hardly differ between 0.05 and 0.3; a rich texture without noise asks for few.
_FREE = 0.1

# Groups away from the limits that are enough to look at no others: of all, and at least so many.
_ENOUGH_SHARE, _ENOUGH_GROUPS = 0.02, 20

# A group without any spread holds no noise; where fewer than this share of the groups do, they are plain areas that
# were painted after the noise came in, or masked.
_PLAIN = 0.5

# Groups of a clipped colour of which the censored normal distribution can tell the noise: shares of samples at a limit.
_TELLING = (0.05, 0.6)


def weakest_level(
    energy: NDArray[np.float64],
    freedom: float,
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    mean: NDArray[np.float64],
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

    Returns
    -------
    float
        In the unit of the residuals; 0 without groups.

    Notes
    -----
    A quantile of the energies is compared with the same quantile of the chi-square distribution. Groups with samples
    at a limit are left out, for there noise was cut off. Where nearly all are such, the noise of each is that of a
    normal variable censored at the limit with the group's mean and share; see `clipping`.
    """
    free = (low == 0) & (high == 0)
    if np.count_nonzero(free) >= max(_ENOUGH_GROUPS, _ENOUGH_SHARE * len(energy)):
        return _quantile_level(energy[free], freedom)
    told = []
    for share, gap in ((low, mean), (high, 1 - mean)):
        telling = (share > _TELLING[0]) & (share < _TELLING[1])
        told.append(sigma_of_clipped(gap[telling], share[telling]) ** 2)
    censored = np.concatenate(told)
    if len(censored) >= _ENOUGH_GROUPS:
        # Such an estimate is as good as that of as many samples, and a group has fewer degrees of freedom than samples.
        return _quantile_level(censored, freedom)
    return _quantile_level(energy, freedom)


def _quantile_level(energy: NDArray[np.float64], freedom: float) -> float:
    from scipy.special import chdtri

    if not len(energy):
        return 0.0
    spread = energy[energy > 0]
    if len(spread) > _PLAIN * len(energy):
        energy = spread
    # Of few groups none may be free; the median stays closer to the noise than the least.
    share = max(_FREE, min(0.5, 2 / len(energy)))
    return float(np.sqrt(np.quantile(energy, share) * freedom / chdtri(freedom, 1 - share)))
