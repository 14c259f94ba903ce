"""Tests of whether samples are spread at random over a surface."""

from __future__ import annotations

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Int64s
from beltrami_cli.flow.corrections.comparison import ColouredSamples, Compared

# Number of runs of successive samples whose shares are compared: two for each of the fewest clumps that are judged.
_RUNS = 32


def are_spread_at_random(
    surface: ColouredSamples, chosen: Compared, sampled: Compared, is_allowed: Bools
) -> bool:
    """Whether chosen samples lie at random among the allowed ones; `sampled` represents all, evenly."""
    samples = np.sort(chosen.samples)
    return (
        _have_chance_neighbours(surface, samples, is_allowed)
        and _are_evenly_spread(surface, samples, is_allowed)
        and _have_same_distribution(sampled.medians[:, is_allowed], chosen.medians)
    )


def _have_chance_neighbours(surface: ColouredSamples, samples: Int64s, is_allowed: Bools) -> bool:
    """Whether about as many of the samples are within two steps of each other as by chance."""
    around = surface.surroundings.around(samples, 2)
    pairs = np.count_nonzero(np.isin(around, samples))
    expected = np.count_nonzero(around >= 0) * len(samples) / (surface.count * is_allowed.mean())
    error = 3 * np.sqrt(2 * expected) + 2  # each pair counts twice
    return bool(expected / 4 - error <= pairs <= 2 * expected + error)


def _are_evenly_spread(surface: ColouredSamples, samples: Int64s, is_allowed: Bools) -> bool:
    """Whether runs of successive samples contain about equal shares, by a chi-squared test."""
    places = np.searchsorted(surface.surroundings.samples, samples)
    counts = np.bincount(places * _RUNS // surface.count, minlength=_RUNS)
    allowed = np.bincount(np.flatnonzero(is_allowed) * _RUNS // len(is_allowed), minlength=_RUNS)
    expected = allowed * (len(samples) / np.count_nonzero(is_allowed))
    excess = float((np.square(counts - expected) / np.maximum(expected, 1)).sum()) - _RUNS
    return bool(excess <= 3 * np.sqrt(2 * _RUNS) + 0.1 * len(samples))


def _have_same_distribution(all_colours: Float32s, some: Float32s) -> bool:
    """Whether two sets of colours, shape (N, n), have the same distribution, by a Kolmogorov-Smirnov test."""
    levels = [each.mean(axis=0) for each in (all_colours, some)]
    places = np.concatenate(levels)
    ranks = [np.searchsorted(np.sort(each), places, "right") / len(each) for each in levels]
    return bool(np.abs(ranks[0] - ranks[1]).max() <= 0.1 + 1.2 / np.sqrt(len(levels[1])))
