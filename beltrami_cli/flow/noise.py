"""The noise level of colours on a surface, from neighbouring samples."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

# For a normal distribution the standard deviation is 1 / Phi^-1(3/4) times the median absolute deviation.
_SIGMA_PER_MEDIAN = 1.4826022

# The length of a vector of two independent normal numbers has the median sqrt(2 ln 2).
_SIGMA_PER_MEDIAN_LENGTH = 1 / np.sqrt(2 * np.log(2))

# One level of an 8-bit file, spread evenly, has the deviation 1 / (255 sqrt(12)). Below that no noise can be told.
_QUANTISATION = 1 / (255 * np.sqrt(12))

# The median of so many squares is within 0.3 % of that of all.
_ENOUGH_SQUARES = 200_000

# Colour distance at which the kernel should fall off, in units of the noise: beta sigma. A search over vertex
# colours and textures at sigma 10 to 40 of 255, with t = 2.4, two regularised and three plain iterations, has its flat
# optimum here.
_BETA_SIGMA = 2.0


# The same for normals: beta sigma. On noisy cubes, cylinders, spheres and a head, the flat optimum of what is left of
# the noise in smooth parts and at creases.
_NORMAL_BETA_SIGMA = 1.5

# The turn of the normal from a vertex to the next, as it is usual on the surface, counts so many sample spacings at
# most: on a capped cylinder and on a head, the value at which curved parts are still smoothed and creases still stay.
_TURN_COUNTS = 0.8


def estimate_sigma(colours: NDArray[np.float32], edges: NDArray[np.int32]) -> NDArray[np.float64]:
    """Estimate the standard deviation of independent noise, per channel.

    A sample with k neighbours differs from their mean by noise of variance sigma^2 (1 + 1/k), plus the
    curvature of the image, which is small almost everywhere; the median is not moved by the edges.

    Parameters
    ----------
    colours : ndarray of float32, shape (S, N)
        Colours of the samples.
    edges : ndarray of int32, shape (E, 2)
        Distinct edges, without the walls of hard colour edges.

    Returns
    -------
    ndarray of float64, shape (N,)
        In units of `colours`; 0 where no sample has neighbours.
    """
    return np.array(
        [
            _SIGMA_PER_MEDIAN * np.median(np.abs(residual)) if residual.size else 0.0
            for residual in _residuals(colours, edges)
        ]
    )


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
    squares = sum(np.square(residual) for residual in _residuals(normals, edges))
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
    by_noise = choose_beta(np.array([sigma])) * _NORMAL_BETA_SIGMA / _BETA_SIGMA
    if not len(edges):
        return by_noise
    median = float(np.median(np.linalg.norm(normals[edges[:, 0]] - normals[edges[:, 1]], axis=1)))
    # Of two noisy normals, the difference has twice the variance of one about each axis.
    turn = np.sqrt(max(0.0, median**2 - 2 * (sigma / _SIGMA_PER_MEDIAN_LENGTH) ** 2))
    return min(by_noise, _TURN_COUNTS / turn) if turn > 0 else by_noise


def _residuals(values: NDArray[np.float32], edges: NDArray[np.int32]) -> Iterator[NDArray[np.float64]]:
    """Go through the channels; find how samples differ from the mean of their neighbours, in units of their noise."""
    count = len(values)
    degree = np.bincount(edges.ravel(), minlength=count)
    inside = degree >= 3  # fewer neighbours: a border or a stray edge, whose mean leans to one side
    scale = np.sqrt(degree[inside] / (degree[inside] + 1.0))
    for column in values.T:
        channel = column.astype(np.float64)
        total = np.bincount(edges[:, 0], channel[edges[:, 1]], count)
        total += np.bincount(edges[:, 1], channel[edges[:, 0]], count)
        yield (channel[inside] - total[inside] / degree[inside]) * scale


def estimate_sigma_on_grid(planes: NDArray[np.float32], filled: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Estimate the standard deviation of independent noise on a grid, per channel.

    The diagonal Haar coefficients (a - b - c + d) / 2 of all 2 x 2 squares keep the noise and lose constants and
    slopes; their median absolute deviation is not moved by edges. D. Donoho, I. Johnstone, "Ideal spatial adaptation
    by wavelet shrinkage", Biometrika 81 (1994), doi:10.1093/biomet/81.3.425.

    Parameters
    ----------
    planes : ndarray of float32, shape (N, R, C)
        Colours.
    filled : ndarray of bool, shape (R, C)
        Which cells to look at.

    Returns
    -------
    ndarray of float64, shape (N,)
        In units of `planes`; 0 where no square is filled.
    """
    upper, lower = _spread_rows(filled)
    squares = filled[upper, :-1] & filled[lower, :-1] & filled[upper, 1:] & filled[lower, 1:]
    if not squares.any():
        return np.zeros(len(planes))
    sigma = []
    for plane in planes:
        above, below = plane[upper], plane[lower]
        detail = (above[:, :-1] - below[:, :-1] - above[:, 1:] + below[:, 1:])[squares]
        sigma.append(_SIGMA_PER_MEDIAN * float(np.median(np.abs(detail))) / 2)
    return np.array(sigma)


def _spread_rows(filled: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Choose pairs of rows, evenly spread, that hold enough filled cells for a steady median."""
    step = max(1, int(np.count_nonzero(filled)) // _ENOUGH_SQUARES)
    upper = np.arange(0, len(filled) - 1, step)
    return upper, upper + 1


def choose_beta(sigma: NDArray[np.float64]) -> float:
    """Choose beta so that noise alone keeps neighbours within reach, and edges do not.

    Parameters
    ----------
    sigma : ndarray of float64, shape (N,)
        Noise per channel, colours in [0, 1].

    Returns
    -------
    float
        Sample spacings per unit of colour. Without noise it is large, so that colours stay as they are.
    """
    # A channel without noise, such as constant alpha, says nothing of how far noise carries in the others.
    noisy = sigma[sigma > 0.1 * sigma.max()] if len(sigma) else sigma
    overall = float(np.sqrt(np.mean(np.square(noisy)))) if len(noisy) else 0.0
    return _BETA_SIGMA / max(overall, float(_QUANTISATION))
