"""Lengths of edges, and the sample spacing: the unit of length that follows a sampling whose density varies."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Means over neighbours are taken this often: far enough to be steady where edges differ at random, near enough to
# follow a gradation of the mesh.
_ROUNDS = 3


def mean_side(positions: NDArray[np.float64], faces: NDArray[np.int32]) -> float:
    """Return the mean length of the sides of all faces; 1 without faces.

    Parameters
    ----------
    positions : ndarray of float64, shape (S, M)
        Of the samples.
    faces : ndarray of int32, shape (F, 3)
        Triangles.
    """
    corners = positions[faces]
    sides = corners - np.roll(corners, 1, axis=1)
    return float(np.sqrt((sides**2).sum(axis=2)).mean()) if len(corners) else 1.0


def edges_in_space(
    edges: NDArray[np.int32], positions: NDArray[np.float64]
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Find the edges that have a length in space.

    Parameters
    ----------
    edges : ndarray of int32, shape (E, 2)
        Distinct edges.
    positions : ndarray of float64, shape (S, M)
        Of the samples.

    Returns
    -------
    edges : ndarray of int32, shape (L, 2)
        Those whose ends lie apart.
    lengths : ndarray of float64, shape (L,)
        Their lengths, positive.
    """
    squared = np.zeros(len(edges))
    for axis in range(positions.shape[1]):
        squared += (positions[edges[:, 0], axis] - positions[edges[:, 1], axis]) ** 2
    long = squared > 0
    return edges[long], np.sqrt(squared[long])


def local_spacing(count: int, edges: NDArray[np.int32], lengths: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute the mean edge length around each vertex.

    Parameters
    ----------
    count : int
        Vertices.
    edges : ndarray of int32, shape (E, 2)
        Distinct edges.
    lengths : ndarray of float64, shape (E,)
        Their lengths, positive.

    Returns
    -------
    ndarray of float64, shape (count,)
        Positive; the mean of all edges at vertices without any. 1 if there are no edges.
    """
    if not len(edges):
        return np.ones(count)
    degree = np.bincount(edges.ravel(), minlength=count)
    total = np.bincount(edges[:, 0], lengths, count) + np.bincount(edges[:, 1], lengths, count)
    spacing: NDArray[np.float64] = np.where(degree > 0, total / np.maximum(degree, 1), lengths.mean())
    for _ in range(_ROUNDS):
        around = np.bincount(edges[:, 0], spacing[edges[:, 1]], count)
        around = around + np.bincount(edges[:, 1], spacing[edges[:, 0]], count)
        spacing = np.asarray((spacing + around) / (degree + 1), np.float64)
    return spacing
