"""Exact polyhedral distances (Mitchell, Mount, Papadimitriou 1987) on surfaces in space, by pygeodesic."""

from __future__ import annotations

import numpy as np
from pygeodesic import geodesic


def exact_distances(positions, faces, source):
    """Return the lengths of the shortest paths over a manifold in space, every vertex of which has a face."""
    points = np.ascontiguousarray(positions, dtype=np.float64)
    solver = geodesic.PyGeodesicAlgorithmExact(points, np.ascontiguousarray(faces, dtype=np.int32))
    found, _ = solver.geodesicDistances(np.array([source], dtype=np.int32), None)
    return np.asarray(found)
