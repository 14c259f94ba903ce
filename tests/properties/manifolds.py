"""The core, driven the way that the flow drives it, for tests that look at single distances and kernels."""

from functools import partial
from math import log, sqrt

import numpy as np

from beltrami_cli import _native


def image_manifold(positions, faces, colours, beta, kind=_native.TriangulatedManifold):
    """Make the manifold of fast marching, or another one."""
    manifold = kind(np.ascontiguousarray(faces, np.int32).reshape(-1, 3), len(positions))
    colours = np.ascontiguousarray(colours, np.float32)
    manifold.update_metric(np.ascontiguousarray(positions, np.float64), colours, beta, None, 1)
    return manifold


segment_manifold = partial(image_manifold, kind=_native.SegmentManifold)


def distances(manifold, count, source, radius=1e30):
    """Distances to all vertices, infinity where the march did not come."""
    reached, values = manifold.distances(source, radius, count)
    result = np.full(count, np.inf)
    result[reached] = values
    return result


def apply_kernel(manifold, colours, t, weights=None, max_samples=10**6, threads=1, threshold=0.01):
    """Return the colours after one iteration, the samples that kernels held, and how many kernels were cut short."""
    colours = np.ascontiguousarray(colours, np.float32)
    if weights is not None:
        weights = np.ascontiguousarray(weights, np.float32)
    return manifold.smooth(colours, weights, t, sqrt(-4 * t * log(threshold)), max_samples, threads, None)


def one_iteration(positions, faces, colours, beta, t, threshold=0.01, weights=None):
    manifold = image_manifold(positions, faces, colours, beta)
    return apply_kernel(manifold, colours, t, weights, len(colours) + 1, threshold=threshold)[0]


def require_same(result, expected):
    """Check that results agree but for samples that rounding moves over the cut-off (weight 0.01 in some 30)."""
    difference = np.abs(result - expected)
    assert difference.mean() < 1e-5
    assert difference.max() < 5e-3
