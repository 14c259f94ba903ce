"""Clumps of neighbouring samples among chosen ones."""

from __future__ import annotations

import numpy as np

from beltrami_cli.arrays import Array, Bools, Int64s
from beltrami_cli.flow.corrections.comparison import ColouredSamples


def small_clumps(surface: ColouredSamples, samples: Int64s, limits: Array) -> Int64s:
    """Return the small isolated clump that each of the samples, ascending, belongs to; -1: none.

    A clump is isolated if no sample around it has a similar colour, within `limits`. It is small if it is no larger
    than clumps that form by chance.
    """
    if not len(samples):
        return samples
    around = surface.surroundings.around(samples, 1)
    index = np.searchsorted(samples, around).clip(0, len(samples) - 1)
    is_chosen = (around >= 0) & (samples[index] == around)
    away = np.abs(surface.at(around) - surface.at(samples)[..., None]).max(axis=0)
    has_similar = ((away <= limits[:, None]) & (around >= 0) & ~is_chosen).any(axis=1)
    clumps = _connected(np.where(is_chosen, index, np.arange(len(samples))[:, None]))
    is_isolated = np.bincount(clumps, has_similar)[clumps] == 0
    return np.where(_are_small(np.bincount(clumps)[clumps], is_isolated, surface.count), clumps, -1)


def _connected(neighbours: Int64s) -> Int64s:
    """Return the least index in the clump of each sample, given the indices of its neighbours, shape (n, W)."""
    # SciPy has this, but importing it takes longer.
    label, before = np.arange(len(neighbours)), np.zeros(0, np.int64)
    while not np.array_equal(label, before):
        before, label = label, np.minimum(label, label[neighbours].min(axis=1))
        label = label[label]
    return label


def _are_small(sizes: Int64s, is_isolated: Bools, count: int) -> Bools:
    """Mark the samples of isolated clumps up to the size that forms by chance among `count` samples."""
    small = np.zeros(len(sizes), bool)
    for _ in range(5):  # the share converges
        # Four samples, since images may have been enlarged by two. On a lattice with eight neighbours the mean size of
        # random clumps is 1 / (1 - 8 share) for small shares, and the largest clumps grow faster.
        share = np.count_nonzero(small) / count
        small = is_isolated & (sizes <= 4 / max(1 - 8 * share, 0.1) ** 2)
    return small
