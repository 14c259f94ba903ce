"""A quick estimate of the clean colours in neighbourhoods, whose residual shows the structure of the noise.

The pilot averages neighbouring samples with weights that fall to 0 at differences which noise hardly reaches, so that
edges stay. It is no result, but it is even where the picture is, and its levels are nearly free of noise.
"""

from __future__ import annotations

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Int64s

# Squared difference of three channels, in units of the noise variance, at which a weight is 0 (J. Tukey's biweight).
# Differences of independent noise have a mean of 6, and exceed 24 in one of 200 pairs.
_MAX_SQUARE = np.float32(24)

# Passes over the nearest neighbours. The noise that is left halves with each.
_PASSES = 3

# Rows and columns to the neighbours of a cell; the others are opposite.
_STEPS = (0, 1), (1, 0), (1, 1), (1, -1)


def smoothed_squares(colours: Float32s, filled: Bools | None, variances: Float32s) -> Float32s:
    """Return the pilot of squares of a grid, shape (3, P, S, S), for noise of variances that broadcast to (P, S, S)."""
    pilot, limits = colours.copy(), np.broadcast_to(_MAX_SQUARE * variances, colours.shape[1:])
    is_filled = None if filled is None else filled.astype(np.float32)
    for number in range(_PASSES):
        sums, weights = np.zeros_like(pilot), np.ones_like(pilot[0])
        for step in _STEPS:
            one, other = _pairs(step)
            weight, difference = _weigh(
                pilot[:, one[0], one[1], one[2]], pilot[:, other[0], other[1], other[2]],
                (limits[one] + limits[other]) * np.float32(0.5 / 4**number),
            )  # fmt: skip
            if is_filled is not None:
                weight *= is_filled[one] * is_filled[other]
            difference *= weight
            weights[one] += weight
            weights[other] += weight
            sums[:, one[0], one[1], one[2]] += difference
            sums[:, other[0], other[1], other[2]] -= difference
        pilot += sums / weights
    return pilot


def smoothed_graph(colours: Float32s, edges: Int64s, variances: Float32s) -> Float32s:
    """Return the pilot of samples joined by edges, shape (3, n), for noise of variances that broadcast to (n,)."""
    pilot, (one, other), count = colours.astype(np.float32), edges.T, colours.shape[1]
    limits = np.broadcast_to(_MAX_SQUARE * variances, count)
    limits = (limits[one] + limits[other]) / 2
    for number in range(_PASSES):
        weight, difference = _weigh(pilot[:, one], pilot[:, other], limits * np.float32(0.25**number))
        total = 1 + np.bincount(one, weight, count) + np.bincount(other, weight, count)
        for plane, own in zip(pilot, difference * weight, strict=True):
            change = (np.bincount(one, own, count) - np.bincount(other, own, count)) / total
            plane += change.astype(np.float32)
    return pilot


def _weigh(one: Array, other: Array, limits: Array) -> tuple[Float32s, Float32s]:
    """Return the weights of pairs of samples, and their differences."""
    difference = other - one
    weight = 1 - np.einsum("k...,k...->...", difference, difference) / np.maximum(limits, np.float32(1e-6))
    np.maximum(weight, 0, out=weight)
    return np.square(weight, out=weight), difference


def _pairs(step: tuple[int, int]) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Return the cells of squares, and their neighbours at a step."""
    down, across = step
    one = slice(None), slice(0, -down or None), slice(max(0, -across), -max(0, across) or None)
    other = slice(None), slice(down, None), slice(max(0, across), min(0, across) or None)
    return one, other
