"""The noise of normals, and how much it lets them count as distance."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.embedding import choose_beta
from beltrami_cli.flow.noise.mesh import residuals

if TYPE_CHECKING:
    from numpy.typing import NDArray

# The length of a vector of two independent normal numbers has the median sqrt(2 ln 2).
_SIGMA_PER_MEDIAN_LENGTH = 1 / np.sqrt(2 * np.log(2))

# How many sample spacings the noise of normals counts: beta sigma. On noisy cubes, cylinders, spheres and a head, the
# flat optimum of what is left of the noise in smooth parts and at creases.
_NORMAL_BETA_SIGMA = 1.5

# The turn of the normal from a vertex to the next, as it is usual on the surface, counts so many sample spacings at
# most: on a capped cylinder and on a head, the value at which curved parts are still smoothed and creases still stay.
_TURN_COUNTS = 0.8


def estimate_normal_sigma(normals: NDArray[np.float32], edges: NDArray[np.int32]) -> float:
    """Estimate how far noise turns the normals of a surface, as `estimate_sigma` does for colours.

    The lengths of the residuals are looked at, not their components, so that turning the surface changes nothing.

    Parameters
    ----------
    normals : ndarray of float32, shape (S, 3)
        Unit vectors; noise turns them about two axes.
    edges : ndarray of int32, shape (E, 2)
        Distinct edges, without the walls of hard colour edges.

    Returns
    -------
    float
        Standard deviation about each axis, in radians; 0 where no sample has neighbours.
    """
    squares = sum(np.square(residual) for residual in residuals(normals, edges))
    if not np.size(squares):
        return 0.0
    return float(_SIGMA_PER_MEDIAN_LENGTH * np.sqrt(np.median(squares)))


def choose_normal_beta(normals: NDArray[np.float32], edges: NDArray[np.int32], sigma: float) -> float:
    """Choose the beta of normals so that neither their noise nor the usual curvature stops the kernel, but creases do.

    Parameters
    ----------
    normals : ndarray of float32, shape (S, 3)
        Unit vectors.
    edges : ndarray of int32, shape (E, 2)
        Distinct edges, without the walls of hard colour edges.
    sigma : float
        Their noise, as `estimate_normal_sigma` tells.

    Returns
    -------
    float
        Sample spacings per radian.
    """
    by_noise = choose_beta(np.array([sigma]), _NORMAL_BETA_SIGMA)
    if not len(edges):
        return by_noise
    median = float(np.median(np.linalg.norm(normals[edges[:, 0]] - normals[edges[:, 1]], axis=1)))
    # Of two noisy normals, the difference has twice the variance of one about each axis.
    turn = np.sqrt(max(0.0, median**2 - 2 * (sigma / _SIGMA_PER_MEDIAN_LENGTH) ** 2))
    return min(by_noise, _TURN_COUNTS / turn) if turn > 0 else by_noise
