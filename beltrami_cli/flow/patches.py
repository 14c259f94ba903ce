"""Which patches of a triangulated surface parameters are tried on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.noise import detail_around

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Samples to try parameters on, as a share of all, so that trying takes hardly longer than smoothing: some sixty
# iterations are tried, each two or three times. Fewer than so many tell too little, and take some tenths of a second.
_SHARE_TRIED = 1 / 20
_LEAST_TRIED = 6_000
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
    budget = min(max(_LEAST_TRIED, int(len(connected) * _SHARE_TRIED)), _MOST_TRIED)
    if len(connected) <= _WHOLE * budget:
        return Patches(connected, np.ones(len(connected), bool))
    ranked = _ranked(colours, around, edges, connected) if budget == _LEAST_TRIED else None
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
