"""Level sets sampled on a lattice, and the colours at their vertices: from a grid, or from points near the surface.

References
----------
.. [1] D. Shepard, "A two-dimensional interpolation function for irregularly-spaced data", Proc. ACM National Conference
   1968, doi:10.1145/800186.810616: the weights of the nearest points.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from beltrami_cli.arrays import Array, Bools, Float64s
    from beltrami_cli.surface.records import Encoding


@dataclass(frozen=True)
class Lattice:
    """Where the samples of a grid stand in space: sample (i, j, k) at ``origin + (i, j, k) @ axes``."""

    # Shape (3, 3): row a is the step in space from a sample to the next one along index a; invertible.
    axes: Float64s
    origin: Float64s  # (3,): place of sample (0, 0, 0), which is the centre of its voxel


@dataclass(frozen=True)
class GridColours:
    """Colours on a lattice of their own, which may be that of the level set."""

    lattice: Lattice  # where they stand
    # Shape (X, Y, Z, C): numbers as stored, of any integer or floating type; C is 1 or 3, and one more if
    # there is opacity. Voxels with a number that is not finite, or of opacity 0, have no colour.
    samples: Array


@dataclass(frozen=True)
class NearColours:
    """Colours at points near the surface."""

    points: Float64s  # (P, 3): finite places, in the space of the level set
    samples: Array  # (P, C): numbers as stored, as in `GridColours`
    encoding: Encoding = "srgb"  # what the numbers mean
    # Type in the file where `samples` are already of full scale 1; empty: that of `samples`.
    stored: str = ""


@dataclass(frozen=True)
class Volume:
    """A level set sampled on a lattice."""

    lattice: Lattice  # where the samples stand
    # Shape (X, Y, Z): of any integer, floating or boolean type. What is not finite is unknown.
    values: Array
    # Shape (X, Y, Z): false where the value is unknown whatever it is; None: nowhere.
    known: Bools | None = None
    level: float | None = None  # value on the surface, where the file says so
    colours: GridColours | NearColours | None = None  # what paints the surface, where the file says so


_NEIGHBOURS = 4  # points that a vertex takes its colour from: about what surrounds it on a surface
_REACH = 4.0  # in voxels, or in distances between points where these are larger
_PROBED = 10_000  # points whose distances to their neighbours are those of all within a per cent
_WEIGHTLESS = 1e-6  # less than the weight of any voxel that contributes


def places(lattice: Lattice, at: Float64s) -> Float64s:
    """Return the positions in space of points in units of a lattice, shape (V, 3)."""
    found: Float64s = lattice.origin + at @ lattice.axes
    return found


def interpolate_colours(colours: GridColours, positions: Float64s, known: Bools | None = None) -> Float64s:
    """Interpolate colours, as stored, between the eight voxels around each place, trilinearly."""
    # Voxels that have no colour, are not known, or lie outside do not contribute: the weights of the others are
    # normalised. NaN where no voxel around has a colour.
    samples = colours.samples
    sides = np.array(samples.shape[:3])
    at = np.linalg.solve(colours.lattice.axes.T, (positions - colours.lattice.origin).T).T
    # A place on the grid that rounding puts beside it must not take colour from a voxel further on.
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
        taken = samples[index].astype(np.float64)
        valid = has_colour(taken) if known is None else has_colour(taken) & known[index]
        rows = np.flatnonzero(inside)[valid]
        total[rows] += weight[rows, None] * taken[valid]
        weights[rows] += weight[rows]
    return _mean(total, weights)


def nearest_colours(colours: NearColours, positions: Float64s, voxel: float, threads: int) -> Float64s:
    """Take colours, as stored, from the nearest points, by inverse squared distance [1]."""
    # NaN where no point is within 4 voxels, or within 4 distances from a point to its fourth neighbour
    # where these are larger.
    from scipy.spatial import cKDTree

    samples = colours.samples.astype(np.float64)
    valid = has_colour(samples)
    if not valid.any():
        return np.full((len(positions), samples.shape[1]), np.nan)
    points, samples = colours.points[valid], samples[valid]
    tree, count = cKDTree(points), min(_NEIGHBOURS, len(points))
    probes = points[:: max(1, len(points) // _PROBED)]
    between = tree.query(probes, [min(count + 1, len(points))], workers=threads)[0]
    reach = _REACH * max(voxel, float(np.median(between)))
    distances, nearest = tree.query(positions, list(range(1, count + 1)), workers=threads)
    nearest = np.minimum(nearest, len(points) - 1)  # beyond all numbers there is none, and its weight is 0
    with np.errstate(over="ignore"):
        # The least distance keeps the weight of a point at the very place finite, and far above that of all
        # others.
        weights = np.where(distances <= reach, 1 / (distances**2 + (1e-6 * voxel) ** 2), 0.0)
        total = (weights[..., None] * samples[nearest]).sum(axis=1)
    return _mean(total, weights.sum(axis=1))


def has_colour(samples: Float64s) -> Bools:
    """Return which rows, of shape (V, C), are finite and not wholly transparent."""
    coloured: Bools = np.asarray(np.isfinite(samples).all(axis=1), bool)
    if samples.shape[1] in (2, 4):
        coloured &= np.greater(samples[:, -1], 0)
    return coloured


def _mean(total: Float64s, weights: Float64s) -> Float64s:
    with np.errstate(invalid="ignore"):
        return np.where(weights[:, None] > 0, total / weights[:, None], np.nan)
