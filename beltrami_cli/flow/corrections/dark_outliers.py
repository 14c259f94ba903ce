"""Dark outliers of noise that neighbours share.

Noise of cameras is not normal in the dark: encoding stretches dark values down to 0, and some samples are so far out
that patches would keep them as detail. So dark outliers in plain places are replaced first. Genuine detail spans
several samples there, since the process that correlated the noise blurred the detail too.
"""

from __future__ import annotations

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s
from beltrami_cli.flow.corrections.clipping import MIN_SHARE
from beltrami_cli.flow.manifolds.blocks import in_blocks
from beltrami_cli.flow.manifolds.domain import CoarseLevel
from beltrami_cli.flow.manifolds.geometry import Geometry
from beltrami_cli.flow.manifolds.manifold import Manifold
from beltrami_cli.surface import large_arrays

# Standard deviations below the local mean from which on samples are outliers: 3 in 100,000 samples of normal noise.
_OUTLIER = 4.0

# Ratio of the local variance to that of noise below which a place is plain.
_PLAIN = 1.4

# Number of searches: outliers add to the local variance, which hides others.
_ROUNDS = 2


def fill_dark_outliers_in_place(manifold: Manifold, level: CoarseLevel, sigma: Float64s) -> None:
    """Replace single samples in plain places that are too far below the local mean for noise."""
    geometry = manifold.geometry
    colours, relative = (
        np.moveaxis(each, geometry.axis, 0) for each in (manifold.colours, manifold.relative_variance)
    )
    shares = np.maximum(level.spread(np.ones((1, *level.shape), np.float32)), np.float32(MIN_SHARE))
    for _ in range(_ROUNDS):
        for channel, deviation in zip(colours, sigma, strict=True):
            moments = _local_moments(geometry, level, channel, shares)
            single = geometry.isolated(_are_far_below(channel, moments, deviation, relative))
            channel[single] = moments[0][single]
    geometry.refresh(manifold.colours)


def _are_far_below(channel: Float32s, moments: Float32s, sigma: float, relative: Float32s) -> Bools:
    """Mark the samples in plain places that are too far below the local mean for noise."""
    are_far = np.zeros(channel.shape, bool)
    for colour, (mean, spread), variance, is_far in in_blocks(
        0, channel[None], moments, relative, are_far[None]
    ):
        noise, below = np.float32(sigma**2) * variance[0], mean - colour[0]
        is_far[0] = (below > 0) & (np.square(below) > _OUTLIER**2 * noise) & (spread < _PLAIN * noise)
    return are_far


def _local_moments(geometry: Geometry, level: CoarseLevel, channel: Float32s, shares: Float32s) -> Float32s:
    """Return the local mean and variance of a channel, along the first axis, computed from means of a level.

    `shares`: the result of spreading ones over the level.
    """
    axis = geometry.axis
    both = large_arrays.empty((2, *geometry.shape), np.float32)
    for colour, (value, square) in in_blocks(0, channel[None], both):
        value[:], square[:] = colour[0], np.square(colour[0])
    means = np.ascontiguousarray(np.moveaxis(level.means(np.moveaxis(both, 0, axis)), axis, 0))
    means = level.spread(means)
    means /= shares
    means[1] -= np.square(means[0])
    both[:] = 0
    enlarged = np.ascontiguousarray(np.moveaxis(both, 0, axis))
    level.add_enlarged_in_place(enlarged, np.ascontiguousarray(np.moveaxis(means, 0, axis)))
    return np.moveaxis(enlarged, axis, 0)
