"""Exact polyhedral distances (Mitchell, Mount, Papadimitriou 1987) on surfaces in space, by pygeodesic."""

from __future__ import annotations

import numpy as np
from pygeodesic import geodesic


def exact_distances(positions, faces, source):
    """Return the lengths of the shortest paths over the faces of a surface.

    Parameters
    ----------
    positions : array_like of float, shape (V, 3)
        A grey image as a surface is (x, y, beta I).
    faces : array_like of int, shape (F, 3)
        Triangles of a manifold; every vertex belongs to one, all are connected.
    source : int
        The vertex with distance 0.

    Returns
    -------
    ndarray of float64, shape (V,)
    """
    points = np.ascontiguousarray(positions, dtype=np.float64)
    solver = geodesic.PyGeodesicAlgorithmExact(points, np.ascontiguousarray(faces, dtype=np.int32))
    found, _ = solver.geodesicDistances(np.array([source], dtype=np.int32), None)
    return np.asarray(found)
