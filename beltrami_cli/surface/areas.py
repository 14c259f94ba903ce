"""Areas of triangles, and of what each vertex stands for."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def triangle_areas(positions: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Compute the areas of triangles in any dimension.

    Parameters
    ----------
    positions : ndarray of float64, shape (V, M)
        Vertex positions.
    faces : ndarray of int32, shape (F, 3)
        Vertex indices.

    Returns
    -------
    ndarray of float64, shape (F,)
        In squared units of `positions`; from the Gram determinant, so M is free.
    """
    p = positions[faces[:, 1]] - positions[faces[:, 0]]
    q = positions[faces[:, 2]] - positions[faces[:, 0]]
    gram = (p * p).sum(1) * (q * q).sum(1) - (p * q).sum(1) ** 2
    areas: NDArray[np.float64] = 0.5 * np.sqrt(np.maximum(gram, 0))
    return areas


def vertex_areas(positions: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float32]:
    """Compute the area in space that each vertex stands for: a third of the triangles around it.

    Parameters
    ----------
    positions : ndarray of float64, shape (V, M)
        Vertex positions.
    faces : ndarray of int32, shape (F, 3)
        Vertex indices.

    Returns
    -------
    ndarray of float32, shape (V,)
        In units of the mean over all vertices; 0 at isolated vertices.
    """
    third = np.repeat(triangle_areas(positions, faces) / 3, 3)
    areas = np.bincount(faces.ravel(), third, len(positions))
    mean = areas.mean() if len(areas) else 0.0
    return (areas / mean if mean > 0 else areas).astype(np.float32)
