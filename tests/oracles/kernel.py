"""One iteration of the short-time Beltrami kernel, sample by sample.

Follows A. Spira, R. Kimmel, N. Sochen, "A short time Beltrami kernel for smoothing images and manifolds",
IEEE Transactions on Image Processing 16 (2007), equations (8) and (9).
"""

from __future__ import annotations

from math import log, sqrt

import numpy as np

from oracles.fast_marching import Manifold


def embed(positions, colours, beta):
    """Return the image manifold (X, beta I), shape (V, M + N)."""
    return np.hstack([np.asarray(positions, float), beta * np.asarray(colours, float)])


def short_time_kernel(embedding, faces, colours, t, threshold=0.01, weights=None):
    """Return the colours after one Jacobi iteration on an image manifold; `t` is in squared units of it."""
    colours = np.asarray(colours, float)
    weights = np.ones(len(colours)) if weights is None else np.asarray(weights, float)
    manifold = Manifold(embedding, faces)
    reach = sqrt(-4 * t * log(threshold))
    smoothed = np.empty_like(colours)
    for p in range(len(colours)):
        d = manifold.distances(p, stop=reach)
        kernel = np.where(np.isfinite(d), weights * np.exp(-(np.minimum(d, 1e6 * reach) ** 2) / (4 * t)), 0.0)
        # A sample whose whole neighbourhood counts nothing keeps its colour.
        smoothed[p] = kernel @ colours / kernel.sum() if kernel.sum() > 0 else colours[p]
    return smoothed
