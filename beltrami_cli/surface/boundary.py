"""The boundary of a triangulated surface."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def on_boundary(faces: NDArray[np.int32], count: int) -> NDArray[np.bool_]:
    """Tell which vertices are ends of an edge that has one triangle only.

    Parameters
    ----------
    faces : ndarray of int32, shape (F, 3)
        Vertex indices in [0, count). Triangles with the same three vertices count once, those that repeat a vertex
        not at all.
    count : int
        Vertices.

    Returns
    -------
    ndarray of bool, shape (count,)
    """
    corners = np.sort(faces.astype(np.int64), axis=1)
    corners = corners[(corners[:, 0] != corners[:, 1]) & (corners[:, 1] != corners[:, 2])]
    # A triangle is told by its least edge and the third corner; both fit in 64 bits, one after the other.
    least = corners[:, 0] * count + corners[:, 1]
    order = np.lexsort((corners[:, 2], least))
    corners, least = corners[order], least[order]
    new = np.ones(len(corners), bool)
    new[1:] = (least[1:] != least[:-1]) | (corners[1:, 2] != corners[:-1, 2])
    corners = corners[new]
    keys = np.concatenate([corners[:, i] * count + corners[:, j] for i, j in ((0, 1), (0, 2), (1, 2))])
    edges, uses = np.unique(keys, return_counts=True)
    alone = edges[uses == 1]
    boundary = np.zeros(count, bool)
    boundary[alone // max(1, count)] = True
    boundary[alone % max(1, count)] = True
    return boundary
