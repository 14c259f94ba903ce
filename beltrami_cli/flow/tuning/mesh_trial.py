"""A sample of a triangulated surface on which iterations can be tried: some patches of it, with a rim around each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.noise.mesh import detail_around
from beltrami_cli.flow.tuning.sure import SampleTrial, wanted_probes

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.flow.mesh_manifold import MeshManifold

# Samples to try parameters on, as a share of all, so that trying takes hardly longer than smoothing: some sixty
# iterations are tried, each two or three times. Fewer than so many tell too little, and take some tenths of a second.
_SHARE_TRIED = 1 / 20
LEAST_TRIED = 6_000
# More tell nothing new.
_MOST_TRIED = 40_000

# Patches with their rims take nearly all of no more than so many times the samples to try on.
_WHOLE = 1.2

# Rings of a patch whose results count, and rings around these that only lend their colours.
_CORE, _RIM = 7, 3

# A patch of so many rings has about so many samples, each ring six more than the last.
_PATCH = 3 * (_CORE + _RIM) ** 2

# Patches end early on small pieces, and overlap: a share of the samples wanted that is enough, and how often there are
# more patches if it is not reached.
_ENOUGH, _TURNS = 0.75, 3


# Odd numbers with their bits well mixed, to hash with.
_MIX = np.uint64(0x9E3779B97F4A7C15)
_STIR = np.uint64(0xBF58476D1CE4E5B9)


def mesh_trial(manifold: MeshManifold) -> SampleTrial:
    """Choose patches of a surface, and draw the perturbations of their colours."""
    colours = manifold.colours
    around = fingerprints(colours, manifold.edges)
    patches = choose_patches(colours, around, manifold.edges)
    signs = random_signs(colours, around, wanted_probes(int(np.count_nonzero(patches.counting))))
    part, samples = manifold, patches.samples
    if len(samples) < manifold.size:
        part, colours, signs = manifold.cut(samples), colours[samples], signs[:, samples]
    scored = np.flatnonzero(patches.counting) if not patches.counting.all() else None
    return SampleTrial(part, colours, signs, scored)


@dataclass(frozen=True)
class Patches:
    """Samples to try on.

    Attributes
    ----------
    samples : ndarray of int64, shape (P,)
        Their indices, ascending.
    counting : ndarray of bool, shape (P,)
        Those whose results count.
    """

    samples: NDArray[np.int64]
    counting: NDArray[np.bool_]


def choose_patches(
    colours: NDArray[np.float32], around: NDArray[np.uint64], edges: NDArray[np.int32]
) -> Patches:
    """Choose patches spread at random over a surface, by the colours and not by the order of samples.

    Parameters
    ----------
    colours : ndarray of float32, shape (S, N)
        Noisy colours.
    around : ndarray of uint64, shape (S,)
        Their `fingerprints`.
    edges : ndarray of int32, shape (E, 2)
        Distinct edges; samples without any are left out.

    Returns
    -------
    Patches
    """
    joined = np.bincount(edges.ravel(), minlength=len(around)) > 0
    connected = np.flatnonzero(joined)
    budget = min(max(LEAST_TRIED, int(len(connected) * _SHARE_TRIED)), _MOST_TRIED)
    if len(connected) <= _WHOLE * budget:
        return Patches(connected, np.ones(len(connected), bool))
    ranked = _ranked(colours, around, edges, connected) if budget == LEAST_TRIED else None
    count = max(1, budget // _PATCH)
    for _ in range(_TURNS):
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


def _ranked(
    colours: NDArray[np.float32],
    around: NDArray[np.uint64],
    edges: NDArray[np.int32],
    connected: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Sort samples by the detail around them.

    A score of patches at random may miss what detail there is, or hold little else; one from each part of this order
    does neither. Many patches do neither at random.
    """
    detail = detail_around(colours, edges)[connected]
    return connected[np.lexsort((around[connected], detail))]


def _grown(middles: NDArray[np.bool_], edges: NDArray[np.int32]) -> Patches:
    """Let patches grow around some samples, ring by ring."""
    reached, counting = middles.copy(), middles
    low, high = np.ascontiguousarray(edges.T)
    for ring in range(_CORE + _RIM):
        leads_out = reached[low] != reached[high]
        reached[low[leads_out]] = True
        reached[high[leads_out]] = True
        if ring == _CORE - 1:
            counting = reached.copy()
    samples = np.flatnonzero(reached)
    return Patches(samples, counting[samples])


def fingerprints(colours: NDArray[np.float32], edges: NDArray[np.int32]) -> NDArray[np.uint64]:
    """Hash each sample's colours with those of its neighbours, and theirs.

    Parameters
    ----------
    colours : ndarray of float32, shape (S, N)
        Noisy colours.
    edges : ndarray of int32, shape (E, 2)
        Distinct edges.

    Returns
    -------
    ndarray of uint64, shape (S,)
    """
    hashes = np.zeros(len(colours), np.uint64)
    # A sum does not depend on the order of channels, nor on that of neighbours.
    for own in _bits(colours):
        hashes += _mixed(own)
    for _ in range(2):
        beside = np.zeros_like(hashes)
        np.add.at(beside, edges[:, 0], hashes[edges[:, 1]])
        np.add.at(beside, edges[:, 1], hashes[edges[:, 0]])
        hashes = _mixed(_mixed(hashes) + beside)
    return hashes


def random_signs(colours: NDArray[np.float32], around: NDArray[np.uint64], count: int) -> NDArray[np.float32]:
    """Return signs that look random but depend only on the colours around each sample.

    So what is chosen by them is the same for a mesh that was turned, or whose vertices or channels come in another
    order.

    Parameters
    ----------
    colours : ndarray of float32, shape (S, N)
        Noisy colours.
    around : ndarray of uint64, shape (S,)
        Their `fingerprints`.
    count : int
        How many signs each colour gets, at most 64.

    Returns
    -------
    ndarray of float32, shape (count, S, N)
        1 or -1.
    """
    signs = np.empty((count, *colours.shape), np.float32)
    for channel, own in enumerate(_bits(colours)):
        bits = _mixed(around + _mixed(own))
        for probe in range(count):
            signs[probe, :, channel] = np.where(bits >> np.uint64(probe) & np.uint64(1), 1, -1)
    return signs


def _bits(colours: NDArray[np.float32]) -> NDArray[np.uint64]:
    """Return the bits of each channel's colours as numbers, shape (N, S)."""
    return np.ascontiguousarray(colours.T).view(np.uint32).astype(np.uint64)


def _mixed(values: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Spread the bits of numbers over all bits, modulo 2^64."""
    mixed = (values + _MIX) * _STIR
    mixed ^= mixed >> np.uint64(29)
    mixed *= _MIX
    stirred: NDArray[np.uint64] = mixed ^ (mixed >> np.uint64(32))
    return stirred
