"""Colours at the vertices of a level set: interpolated on a grid, or taken from points near the surface."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.surface.volume import GridColours, Lattice, NearColours

_NEIGHBOURS = 4  # points that a vertex takes its colour from: about what surrounds it on a surface
_REACH = 4.0  # in voxels, or in distances between points where these are larger
_PROBED = 10_000  # points whose distances to their neighbours tell that of all within a per cent
_WEIGHTLESS = 1e-6  # less than any voxel that lends has by chance


def places(lattice: Lattice, at: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return where points in units of a lattice, shape (V, 3), stand in space."""
    found: NDArray[np.float64] = lattice.origin + at @ lattice.axes
    return found


def interpolate_colours(
    colours: GridColours, positions: NDArray[np.float64], known: NDArray[np.bool_] | None = None
) -> NDArray[np.float64]:
    """Interpolate colours on a grid between the eight voxels around each place, trilinearly.

    Parameters
    ----------
    colours : GridColours
        The grid. Voxels that have no colour, or lie outside, lend none: the weights of the others are raised to 1.
    positions : ndarray of float64, shape (V, 3)
        Where colours are wanted, in space.
    known : ndarray of bool, shape (X, Y, Z), optional
        False for further voxels that lend nothing.

    Returns
    -------
    ndarray of float64, shape (V, C)
        In the numbers as stored, NaN where no voxel around has a colour.
    """
    samples = colours.samples
    sides = np.array(samples.shape[:3])
    at = np.linalg.solve(colours.lattice.axes.T, (positions - colours.lattice.origin).T).T
    # A place on the grid that rounding puts beside it must not lend from a voxel further on.
    at = np.where(np.abs(at - np.rint(at)) < _WEIGHTLESS, np.rint(at), at)
    corner = np.floor(at)
    beyond = at - corner
    total = np.zeros((len(at), samples.shape[3]))
    weights = np.zeros(len(at))
    for step in product((0, 1), repeat=3):
        voxel = corner + step
        weight = np.where(step, beyond, 1 - beyond).prod(axis=1)
        inside = ((voxel >= 0) & (voxel < sides)).all(axis=1) & (weight > _WEIGHTLESS)
        index = tuple(voxel[inside].astype(np.intp).T)
        lent = samples[index].astype(np.float64)
        lends = has_colour(lent) if known is None else has_colour(lent) & known[index]
        rows = np.flatnonzero(inside)[lends]
        total[rows] += weight[rows, None] * lent[lends]
        weights[rows] += weight[rows]
    return _mean(total, weights)


def nearest_colours(
    colours: NearColours, positions: NDArray[np.float64], voxel: float, threads: int
) -> NDArray[np.float64]:
    """Take colours from the nearest points, by inverse squared distance.

    Parameters
    ----------
    colours : NearColours
        The points. Those without a colour lend none.
    positions : ndarray of float64, shape (V, 3)
        Where colours are wanted, in the space of the points.
    voxel : float
        Longest side of a voxel.
    threads : int
        To look for them with; the result does not depend on it.

    Returns
    -------
    ndarray of float64, shape (V, C)
        In the numbers as stored, NaN where no point is within 4 voxels, or within 4 distances from a point to its
        fourth neighbour where these are larger.

    Notes
    -----
    The weights are those of D. Shepard, "A two-dimensional interpolation function for irregularly-spaced data",
    Proc. ACM National Conference 1968, doi:10.1145/800186.810616.
    """
    from scipy.spatial import cKDTree

    samples = colours.samples.astype(np.float64)
    lends = has_colour(samples)
    if not lends.any():
        return np.full((len(positions), samples.shape[1]), np.nan)
    points, samples = colours.points[lends], samples[lends]
    tree, count = cKDTree(points), min(_NEIGHBOURS, len(points))
    probes = points[:: max(1, len(points) // _PROBED)]
    between = tree.query(probes, [min(count + 1, len(points))], workers=threads)[0]
    reach = _REACH * max(voxel, float(np.median(between)))
    distances, nearest = tree.query(positions, list(range(1, count + 1)), workers=threads)
    nearest = np.minimum(nearest, len(points) - 1)  # beyond all numbers there is none, and its weight is 0
    with np.errstate(over="ignore"):
        # The least distance keeps the weight of a point at the very place finite, and far above that of all others.
        weights = np.where(distances <= reach, 1 / (distances**2 + (1e-6 * voxel) ** 2), 0.0)
        total = (weights[..., None] * samples[nearest]).sum(axis=1)
    return _mean(total, weights.sum(axis=1))


def has_colour(samples: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell which rows, of shape (V, C), are finite and not wholly transparent."""
    coloured: NDArray[np.bool_] = np.asarray(np.isfinite(samples).all(axis=1), bool)
    if samples.shape[1] in (2, 4):
        coloured &= np.greater(samples[:, -1], 0)
    return coloured


def _mean(total: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    with np.errstate(invalid="ignore"):
        return np.where(weights[:, None] > 0, total / weights[:, None], np.nan)
