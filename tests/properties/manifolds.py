"""The core, driven the way that the flow drives it, for tests that look at single distances and kernels."""

from __future__ import annotations

from math import log, sqrt

import numpy as np

from beltrami_cli import _native


def image_manifold(positions, faces, colours, beta, unfold=True, threads=1):
    positions = np.ascontiguousarray(positions, np.float64)
    colours = np.ascontiguousarray(colours, np.float32)
    manifold = _native.TriangulatedManifold(
        np.ascontiguousarray(faces, np.int32).reshape(-1, 3), len(positions)
    )
    manifold.update_metric(positions, colours, beta, None, threads, unfold)
    return manifold


def distances(manifold, count, source, radius=1e30):
    """Distances to all vertices, infinity where the march did not come."""
    reached, values = manifold.distances(source, radius, count)
    result = np.full(count, np.inf)
    result[reached] = values
    return result


def one_iteration(positions, faces, colours, beta, t, threshold=0.01, weights=None, unfold=True, threads=1):
    manifold = image_manifold(positions, faces, colours, beta, unfold, threads)
    colours = np.ascontiguousarray(colours, np.float32)
    radius = sqrt(-4 * t * log(threshold))
    if weights is not None:
        weights = np.ascontiguousarray(weights, np.float32)
    return manifold.smooth(colours, weights, t, radius, len(colours) + 1, threads, None)
