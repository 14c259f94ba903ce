"""Gaussian means over the neighbours of vertices, for the regularised metric and for averages over a mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beltrami_cli._native import neighbour_means
from beltrami_cli.arrays import Float32s, Float64s, Int32s
from beltrami_cli.surface import large_arrays

# Standard deviation of the Gaussian of one pass over neighbours, in spacings: their weights are nearly equal.
PASS_SCALE = 3.0
# Variance that a pass adds on a triangular lattice, in squared spacings.
PASS_VARIANCE = 0.43


@dataclass(frozen=True, eq=False)
class MeshGaussian:
    """Gaussian means over the neighbours of each vertex."""

    edges: Int32s  # with a length in space: no bridges over hard colour edges
    weights: Float32s
    total: Float64s  # of the weights at each vertex, including its own of 1
    gain: float  # remaining standard deviation of white noise
    threads: int = 1

    @classmethod
    def of(
        cls,
        count: int,
        edges: Int32s,
        lengths: Float64s,
        scale: float,
        gain: float | None = None,
        threads: int = 1,
    ) -> MeshGaussian:
        """Weight edges by a Gaussian of their `lengths`; these and `scale` (sigma) are in sample spacings."""
        weights: Float32s = large_arrays.empty(len(edges), np.float32)
        for block in large_arrays.blocks(len(edges)):
            weights[block] = np.exp(-(lengths[block] ** 2) / (2 * scale**2))
        total = _sums_at_ends(count, edges, weights)
        total += 1
        if gain is None:
            gains = np.sqrt(1 + _sums_at_ends(count, edges, weights**2)) / total
            joined = total > 1  # isolated vertices keep their noise, and are ignored
            gain = float(gains[joined].mean()) if joined.any() else 1.0
        return cls(edges, weights, total, gain, threads)

    def smooth(self, colours: Float32s) -> Float32s:
        return neighbour_means(colours, self.edges, self.weights, self.total, self.threads)


def _sums_at_ends(count: int, edges: Int32s, weights: Float32s) -> Float64s:
    sums = np.zeros(count), np.zeros(count)
    for block in large_arrays.blocks(len(edges)):
        for total, ends in zip(sums, edges[block].T, strict=True):
            np.add.at(total, ends.astype(np.intp), weights[block].astype(np.float64))
    np.add(*sums, out=sums[0])
    return sums[0]
