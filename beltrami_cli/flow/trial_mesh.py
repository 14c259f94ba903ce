"""A sample of a triangulated surface on which iterations can be tried: some patches of it, with a rim around each."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli._native import SegmentManifold, TriangulatedManifold
    from beltrami_cli.flow.mesh_metric import MeshMetric
    from beltrami_cli.flow.parameters import KernelParameters
    from beltrami_cli.flow.patches import Patches
    from beltrami_cli.flow.risk import Step

# Odd numbers with their bits well mixed, to hash with.
_MIX = np.uint64(0x9E3779B97F4A7C15)
_STIR = np.uint64(0xBF58476D1CE4E5B9)


@dataclass(frozen=True)
class SampleFields:
    """What is known at each of S samples: positions, noisy colours, P signs (P, S, N), scales and weights (or None)."""

    positions: NDArray[np.float64]
    colours: NDArray[np.float32]
    signs: NDArray[np.float32]
    scales: NDArray[np.float32] | None
    weights: NDArray[np.float32] | None

    def at(self, samples: NDArray[np.int64]) -> SampleFields:
        """Return the rows of some samples."""
        return SampleFields(
            self.positions[samples],
            self.colours[samples],
            self.signs[:, samples],
            None if self.scales is None else self.scales[samples],
            None if self.weights is None else self.weights[samples],
        )


class MeshTrial:
    """Patches of a surface, as a surface of their own.

    Parameters
    ----------
    patches : Patches
        Which of the S samples to try on.
    fields : SampleFields
        Of all samples.
    faces : ndarray of int32, shape (F, 3)
        All triangles.
    manifold : TriangulatedManifold or SegmentManifold
        Of all samples; used if the patches are all.
    metric : MeshMetric
        Of all samples.
    parameters : KernelParameters
        What is not tried: the threshold and the like.

    Attributes
    ----------
    samples : int
        Samples whose results count.
    """

    def __init__(
        self,
        patches: Patches,
        fields: SampleFields,
        faces: NDArray[np.int32],
        manifold: TriangulatedManifold | SegmentManifold,
        metric: MeshMetric,
        parameters: KernelParameters,
    ) -> None:
        count, samples = len(fields.colours), patches.samples
        self._manifold, self._metric, self._fields = manifold, metric, fields
        if len(samples) < count:
            rank = np.full(count, -1, np.int32)
            rank[samples] = np.arange(len(samples), dtype=np.int32)
            corners = rank[faces]
            self._manifold = type(manifold)(corners[(corners >= 0).all(axis=1)], len(samples))
            self._metric, self._fields = metric.cut_out(samples), fields.at(samples)
        self._counting, self._parameters = patches.counting, parameters
        self.samples = int(np.count_nonzero(patches.counting))

    @property
    def start(self) -> NDArray[np.float32]:
        """The noisy colours."""
        return self._fields.colours

    @property
    def signs(self) -> NDArray[np.float32]:
        """Random signs, see `random_signs`."""
        return self._fields.signs

    def step(self, state: NDArray[np.float32], step: Step) -> NDArray[np.float32]:
        """Return the colours after an iteration."""
        own, fields = self._parameters, self._fields
        if step.t != own.t:
            own = dataclasses.replace(own, t=step.t)
        metric, beta = self._metric.join(state, step.beta, regularised=step.regularised)
        self._manifold.update_metric(fields.positions, metric, beta, fields.scales, own.thread_count)
        smoothed, _, _ = self._manifold.smooth(
            state, fields.weights, own.t, own.radius, own.max_samples, own.thread_count, None
        )
        return smoothed

    def scored(self, state: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the colours of the samples that count, shape (samples, N)."""
        return state if self.samples == len(state) else state[self._counting]


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
