"""A sample of a triangulated surface on which iterations can be tried: some patches of it, with a rim around each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Bools, Float32s, Float64s, Int32s, Int64s
from beltrami_cli.flow.vertex_graph import sums_around

# Samples to try parameters on, as a share of all, so that trying takes hardly longer than smoothing: some sixty
# iterations are tried, each two or three times. Fewer than the least are too uncertain; these take tenths of a second.
# More than the most do not improve the choice.
TRIED = {"share": 1 / 20, "least": 6_000, "most": 40_000}

# Up to this many times the samples to try on, patches with their rims would cover nearly the whole surface.
_WHOLE = 1.2

# Rings of a patch that are scored, and rings around these that only supply colours.
_CORE, _RIM = 7, 3

# Patches end early on small components, and overlap: the share of the wanted samples that suffices, and how often more
# patches are added to reach it.
_ENOUGH, _ROUNDS = 0.75, 3


# Rings over which detail is averaged to rank patches.
_RINGS_OF_DETAIL = 5

# Odd numbers with their bits well mixed, to hash with, as in SplitMix64.
_MIXERS = np.array([0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9], np.uint64)


@dataclass(frozen=True)
class TrialSamples:
    """Samples to try parameters on: ascending indices, shape (P,), and which of them are scored."""

    samples: Int64s
    scored: Bools


def choose_patches(colours: Float32s, around: NDArray[np.uint64], edges: Int32s) -> TrialSamples:
    """Choose patches spread at random, by the `fingerprints` of colours and not by the order of samples."""
    joined = np.bincount(edges.ravel(), minlength=len(around)) > 0
    connected = np.flatnonzero(joined)
    budget = int(np.clip(len(connected) * TRIED["share"], TRIED["least"], TRIED["most"]))
    if len(connected) <= _WHOLE * budget:
        return TrialSamples(connected, np.ones(len(connected), bool))
    ranked = _ranked(colours, around, edges, connected) if budget == TRIED["least"] else None
    of_patch = 3 * (_CORE + _RIM) ** 2  # each ring has six samples more than the last
    count = max(1, budget // of_patch)
    for _ in range(_ROUNDS):
        middles = np.zeros(len(around), bool)
        if ranked is None:
            middles[connected[np.argpartition(around[connected], count - 1)[:count]]] = True
        else:
            middles[[part[np.argmin(around[part])] for part in np.array_split(ranked, count)]] = True
        patches = _grown(middles, edges)
        if len(patches.samples) >= _ENOUGH * budget:
            break
        count = min(len(connected), 1 + count * budget // len(patches.samples))
    return patches


def _ranked(colours: Float32s, around: NDArray[np.uint64], edges: Int32s, connected: Int64s) -> Int64s:
    # A few patches at random may miss all detail, or hold nothing else; one from each part of this order does neither.
    detail = _detail_around(colours, edges)[connected]
    return connected[np.lexsort((around[connected], detail))]


def _grown(middles: Bools, edges: Int32s) -> TrialSamples:
    """Grow patches around some samples, ring by ring."""
    reached, scored = middles.copy(), middles
    low, high = np.ascontiguousarray(edges.T)
    for ring in range(_CORE + _RIM):
        leads_out = reached[low] != reached[high]
        reached[low[leads_out]] = True
        reached[high[leads_out]] = True
        if ring == _CORE - 1:
            scored = reached.copy()
    samples = np.flatnonzero(reached)
    return TrialSamples(samples, scored[samples])


def _detail_around(colours: Float32s, edges: Int32s) -> Float64s:
    """Return how uneven colours are around each sample, beyond what noise makes of them."""
    size = np.bincount(edges.ravel(), minlength=len(colours))[:, None] + 1.0
    means = (colours + sums_around(colours.astype(np.float64), edges)) / size
    steps = np.square(means[edges[:, 0]] - means[edges[:, 1]]).sum(axis=1)
    ends = np.concatenate([edges[:, 0], edges[:, 1]])
    detail: Float64s = np.bincount(ends, np.concatenate([steps, steps]), len(colours)).astype(float)[:, None]
    for _ in range(_RINGS_OF_DETAIL):
        detail = (detail + sums_around(detail, edges)) / size
    return detail[:, 0]


def fingerprints(colours: Float32s, edges: Int32s) -> NDArray[np.uint64]:
    """Hash each sample's colours with its neighbours' and their neighbours' colours; uint64, shape (S,)."""
    hashes = np.zeros(len(colours), np.uint64)
    # A sum does not depend on the order of channels, nor on that of neighbours.
    for own in _bits(colours):
        hashes += _mixed(own)
    for _ in range(2):
        around = np.zeros_like(hashes)
        np.add.at(around, edges[:, 0], hashes[edges[:, 1]])
        np.add.at(around, edges[:, 1], hashes[edges[:, 0]])
        hashes = _mixed(_mixed(hashes) + around)
    return hashes


def random_signs(colours: Float32s, around: NDArray[np.uint64], count: int) -> Float32s:
    """Return signs, shape (count, S, N), that look random but depend only on nearby colours; `count` <= 64."""
    # So the choice is the same for a mesh that was rotated, or whose vertices or channels come in another order.
    signs = np.empty((count, *colours.shape), np.float32)
    for channel, own in enumerate(_bits(colours)):
        bits = _mixed(around + _mixed(own))
        for probe in range(count):
            signs[probe, :, channel] = np.where(bits >> np.uint64(probe) & np.uint64(1), 1, -1)
    return signs


def _bits(colours: Float32s) -> NDArray[np.uint64]:
    """Return the bits of each channel's colours as numbers, shape (N, S)."""
    return np.ascontiguousarray(colours.T).view(np.uint32).astype(np.uint64)


def _mixed(values: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Spread the bits of numbers over all bits, modulo 2^64."""
    mixed = (values + _MIXERS[0]) * _MIXERS[1]
    mixed ^= mixed >> np.uint64(29)
    mixed *= _MIXERS[0]
    stirred: NDArray[np.uint64] = mixed ^ (mixed >> np.uint64(32))
    return stirred
