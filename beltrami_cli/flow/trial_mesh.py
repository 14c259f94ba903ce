"""A sample of a triangulated surface on which iterations can be tried: some patches of it, with a rim around each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from beltrami_cli.flow.mesh_metric import MeshMetric
    from beltrami_cli.flow.risk import Step

# Rings of a patch whose results count, and rings around these that only lend their colours.
_CORE, _RIM = 12, 4

# A patch of so many rings has about so many samples, each ring six more than the last.
_PATCH = 3 * (_CORE + _RIM) ** 2

# Odd numbers with their bits well mixed, to hash with.
_MIX = np.uint64(0x9E3779B97F4A7C15)
_STIR = np.uint64(0xBF58476D1CE4E5B9)


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


class MeshTrial:
    """Patches of a surface.

    Parameters
    ----------
    colours : ndarray of float32, shape (P, N)
        Noisy colours of the patches' samples.
    signs : ndarray of float32, shape (P, N)
        1 or -1; see `random_signs`.
    counting : ndarray of bool, shape (P,)
        Samples whose results count.
    metric : MeshMetric
        Of the patches.
    iterate : callable
        Makes an iteration from the channels of the metric, colours, beta and t.
    """

    def __init__(
        self,
        colours: NDArray[np.float32],
        signs: NDArray[np.float32],
        counting: NDArray[np.bool_],
        metric: MeshMetric,
        iterate: Callable[..., NDArray[np.float32]],
    ) -> None:
        self.start, self.signs = colours, signs
        self._counting, self._metric, self._iterate = counting, metric, iterate
        self.samples = int(np.count_nonzero(counting))

    def step(self, state: NDArray[np.float32], step: Step) -> NDArray[np.float32]:
        """Return the colours after an iteration."""
        metric, beta = self._metric.join(state, step.beta, regularised=step.regularised)
        return self._iterate(metric, state, beta, step.t)

    def scored(self, state: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the colours of the samples that count, shape (samples, N)."""
        return state[self._counting]


def random_signs(colours: NDArray[np.float32], edges: NDArray[np.int32]) -> NDArray[np.float32]:
    """Return signs that look random but depend only on the colours around each sample, and not on the order of samples.

    So what is chosen by them is the same for a mesh that was turned, or whose vertices come in another order.

    Parameters
    ----------
    colours : ndarray of float32, shape (S, N)
        Noisy colours.
    edges : ndarray of int32, shape (E, 2)
        Distinct edges.

    Returns
    -------
    ndarray of float32, shape (S, N)
        1 or -1.
    """
    bits = _hashes(colours, edges)[:, None] >> np.arange(colours.shape[1], dtype=np.uint64) % np.uint64(40)
    return np.where(bits & np.uint64(1), np.float32(1), np.float32(-1))


def choose_patches(colours: NDArray[np.float32], edges: NDArray[np.int32], budget: int) -> Patches:
    """Choose patches spread at random over a surface, by the colours and not by the order of samples.

    Parameters
    ----------
    colours : ndarray of float32, shape (S, N)
        Noisy colours.
    edges : ndarray of int32, shape (E, 2)
        Distinct edges.
    budget : int
        About how many samples to take; a surface that has no more is taken whole.

    Returns
    -------
    Patches
    """
    count = len(colours)
    if count <= budget:
        return Patches(np.arange(count), np.bincount(edges.ravel(), minlength=count) > 0)
    joined = np.bincount(edges.ravel(), minlength=count) > 0
    rank = np.where(joined, _hashes(colours, edges), np.iinfo(np.uint64).max)
    reached = np.zeros(count, bool)
    reached[np.argsort(rank, kind="stable")[: max(1, budget // _PATCH)]] = True
    counting = reached & joined
    for ring in range(_CORE + _RIM):
        touched = reached[edges]
        reached[edges[touched.any(axis=1)]] = True
        if ring == _CORE - 1:
            counting = reached.copy()
    samples = np.flatnonzero(reached)
    return Patches(samples, counting[samples])


def _hashes(colours: NDArray[np.float32], edges: NDArray[np.int32]) -> NDArray[np.uint64]:
    """Hash each sample's colours with those of its neighbours, and theirs."""
    hashes = np.zeros(len(colours), np.uint64)
    for column in np.ascontiguousarray(colours.T).view(np.uint32):
        hashes = _mixed(hashes + column)
    for _ in range(2):
        # A sum does not depend on the order of neighbours.
        beside = np.zeros_like(hashes)
        np.add.at(beside, edges[:, 0], hashes[edges[:, 1]])
        np.add.at(beside, edges[:, 1], hashes[edges[:, 0]])
        hashes = _mixed(_mixed(hashes) + beside)
    return hashes


def _mixed(values: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Spread the bits of numbers over all bits, modulo 2^64."""
    mixed = (values + _MIX) * _STIR
    mixed ^= mixed >> np.uint64(29)
    mixed *= _MIX
    stirred: NDArray[np.uint64] = mixed ^ (mixed >> np.uint64(32))
    return stirred
