"""The Laplace-Beltrami operator of a triangulated manifold, from its edge lengths alone.

Cotangent weights as in U. Pinkall, K. Polthier, "Computing discrete minimal surfaces and their conjugates",
Experimental Mathematics 2 (1993); areas by Heron's formula in W. Kahan's stable form.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse


def laplace_beltrami(embedding, faces):
    """Return the operator and the areas of the vertices.

    Parameters
    ----------
    embedding : array_like of float, shape (V, D)
        Vertices in any dimension.
    faces : array_like of int, shape (F, 3)
        Triangles with non-zero area.

    Returns
    -------
    stiffness : sparse array of float64, shape (V, V)
        Symmetric, rows sum to zero; ``(stiffness @ f) / mass`` approximates the Laplacian of f, so its
        eigenvalues are not positive.
    mass : ndarray of float64, shape (V,)
        A third of the areas of the faces about each vertex.
    """
    embedding, faces = np.asarray(embedding, float), np.asarray(faces)
    count = len(embedding)
    # Side k lies opposite corner k.
    corners = embedding[faces]
    sides = np.stack([np.linalg.norm(corners[:, k - 1] - corners[:, k - 2], axis=1) for k in range(3)])
    area = triangle_areas(sides)
    squares = sides**2
    rows, columns, values = [], [], []
    for k in range(3):
        half_cotangent = (squares[k - 1] + squares[k - 2] - squares[k]) / (8 * area)
        i, j = faces[:, k - 1], faces[:, k - 2]
        rows += [i, j, i, j]
        columns += [j, i, i, j]
        values += [half_cotangent, half_cotangent, -half_cotangent, -half_cotangent]
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    mass = np.bincount(faces.ravel(), np.repeat(area / 3, 3), count)
    return sparse.csr_array(sparse.coo_array(entries, shape=(count, count))), mass


def triangle_areas(sides):
    """Return the areas of triangles with the sides (3, F)."""
    c, b, a = np.sort(sides, axis=0)
    return np.sqrt(np.maximum((a + (b + c)) * (c - (a - b)) * (c + (a - b)) * (a + (b - c)), 0.0)) / 4
