"""Discs of a mesh on which parameters are tried, each with a rim."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Bools, Float32s, Float64s, Int32s, Int64s
from beltrami_cli.flow.manifolds.search_range import BUDGET_ON_MESHES
from beltrami_cli.flow.vertex_graph import sums_around

# Below this ratio of all samples to those wanted, discs with their rims would cover nearly the whole surface.
_WHOLE_SURFACE = 1.2

# Rings of a disc that are evaluated, and rings of its rim, which only supply colours.
_SCORED_RINGS, _RIM_RINGS = 7, 3

# Discs are small on small components, and overlap. Share of the wanted samples that suffices, and maximum number of
# rounds in which discs are added.
_SUFFICIENT_SHARE, _MAX_EXTENSIONS = 0.75, 3

# Rings over which detail is averaged to rank discs.
_RINGS_OF_DETAIL = 5


@dataclass(frozen=True)
class TrialSamples:
    """Samples on which parameters are tried: ascending indices, shape (P,), and which of them are evaluated."""

    samples: Int64s
    scored: Bools


def choose_discs(colours: Float32s, around: NDArray[np.uint64], edges: Int32s) -> TrialSamples:
    """Choose random discs by the `fingerprints` of colours, independently of the order of samples."""
    joined = np.bincount(edges.ravel(), minlength=len(around)) > 0
    connected = np.flatnonzero(joined)
    budget = BUDGET_ON_MESHES.of(len(connected))
    if len(connected) <= _WHOLE_SURFACE * budget:
        return TrialSamples(connected, np.ones(len(connected), bool))
    ranked = _ranked(colours, around, edges, connected) if budget == BUDGET_ON_MESHES.least else None
    of_disc = 3 * (_SCORED_RINGS + _RIM_RINGS) ** 2  # each ring has six samples more than the last
    count = max(1, budget // of_disc)
    for _ in range(_MAX_EXTENSIONS):
        middles = np.zeros(len(around), bool)
        if ranked is None:
            middles[connected[np.argpartition(around[connected], count - 1)[:count]]] = True
        else:
            middles[[part[np.argmin(around[part])] for part in np.array_split(ranked, count)]] = True
        discs = _grow_discs(middles, edges)
        if len(discs.samples) >= _SUFFICIENT_SHARE * budget:
            break
        count = min(len(connected), 1 + count * budget // len(discs.samples))
    return discs


def _ranked(colours: Float32s, around: NDArray[np.uint64], edges: Int32s, connected: Int64s) -> Int64s:
    """Sort samples by the detail around them.

    A few random discs may miss all detail, or contain nothing else. One disc from each part of this order does
    neither.
    """
    detail = _detail_around(colours, edges)[connected]
    return connected[np.lexsort((around[connected], detail))]


def _grow_discs(middles: Bools, edges: Int32s) -> TrialSamples:
    """Grow discs around some samples, ring by ring."""
    reached, scored = middles.copy(), middles
    low, high = np.ascontiguousarray(edges.T)
    for ring in range(_SCORED_RINGS + _RIM_RINGS):
        leads_out = reached[low] != reached[high]
        reached[low[leads_out]] = True
        reached[high[leads_out]] = True
        if ring == _SCORED_RINGS - 1:
            scored = reached.copy()
    samples = np.flatnonzero(reached)
    return TrialSamples(samples, scored[samples])


def _detail_around(colours: Float32s, edges: Int32s) -> Float64s:
    """Return the variation of colours around each sample, beyond that of noise."""
    size = np.bincount(edges.ravel(), minlength=len(colours))[:, None] + 1.0
    means = (colours + sums_around(colours.astype(np.float64), edges)) / size
    steps = np.square(means[edges[:, 0]] - means[edges[:, 1]]).sum(axis=1)
    ends = np.concatenate([edges[:, 0], edges[:, 1]])
    detail: Float64s = np.bincount(ends, np.concatenate([steps, steps]), len(colours)).astype(float)[:, None]
    for _ in range(_RINGS_OF_DETAIL):
        detail = (detail + sums_around(detail, edges)) / size
    return detail[:, 0]
