"""Normals of a triangulated surface at its vertices."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def vertex_normals(
    positions: NDArray[np.float64], faces: NDArray[np.int32], group_of: NDArray[np.int32]
) -> NDArray[np.float32]:
    """Compute the mean normal of the triangles around each vertex, weighted by their areas.

    Parameters
    ----------
    positions : ndarray of float64, shape (V, 3)
        Vertex positions.
    faces : ndarray of int32, shape (F, 3)
        Vertex indices; counter-clockwise seen from outside.
    group_of : ndarray of int32, shape (V,)
        Vertices with the same number have one normal in common, such as the copies of a split vertex.

    Returns
    -------
    ndarray of float32, shape (V, 3)
        Unit vectors; 0 where the triangles have no area, or cancel out.
    """
    corners = positions[faces]
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    groups = group_of[faces].T.ravel()
    count = int(group_of.max(initial=-1)) + 1
    sums = np.stack([np.bincount(groups, np.tile(column, 3), count) for column in crosses.T], axis=1)
    length = np.linalg.norm(sums, axis=1, keepdims=True)
    normals: NDArray[np.float64] = np.divide(sums, length, out=np.zeros_like(sums), where=length > 0)
    return np.asarray(normals[group_of], np.float32)
