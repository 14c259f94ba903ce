"""Coarse levels of a mesh: means over clusters of samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
from typing import ClassVar

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s
from beltrami_cli.flow.manifolds.domain import CoarseLevel
from beltrami_cli.flow.manifolds.geometry import Stack
from beltrami_cli.flow.manifolds.mesh.fingerprints import random_signs
from beltrami_cli.flow.manifolds.mesh.patches import collaborate_on_graph
from beltrami_cli.flow.mixing import Mixing
from beltrami_cli.flow.noise.drawing import root_of
from beltrami_cli.flow.vertex_graph import Graph, Level, levels_of
from beltrami_cli.surface import large_arrays

# Minimum number of clusters: fewer contain too few patches to compare.
_MIN_CLUSTERS = 500


def clusters_for(samples: Graph, most: int, relative: Float32s | None) -> list[Clusters]:
    """Make up to `most` levels of clusters, fine to coarse, as long as there are enough clusters."""
    levels: list[Clusters] = []
    variances = np.ones((samples.size, 1), np.float32) if relative is None else relative
    for level in islice(levels_of(samples), 1, most + 1):
        if level.graph.size < _MIN_CLUSTERS:
            break
        levels.append(
            Clusters(level.graph, level.members, level.centres, samples, level.means(variances)[:, 0])
        )
    return levels


@dataclass(frozen=True, eq=False)
class Clusters(Level, CoarseLevel):
    """Means of clusters of samples, as a stack with one row per cluster."""

    axis: ClassVar[int] = 1
    width = 3.0

    samples: Graph
    relative_variances: Float32s

    @property
    def noise_ratio(self) -> float:
        """Mean variance of independent noise in the means, relative to that of samples."""
        return float(1 / self.counts.mean())

    def probe(self, means: Stack, noise: Float64s) -> Stack:
        signs = random_signs(means, self.graph.priorities, 1)[0]
        return np.asarray(np.einsum("ij,sj->si", root_of(noise), signs), np.float32)

    def collaborate(
        self, noisy: Stack, pilot: Stack, mixing: Mixing, progress: Callable[[int], None] | None = None, *,
        shared: bool = False,
    ) -> Stack:  # fmt: skip
        """Estimate means from patches of clusters; `shared` noise does not fall with their size."""
        variances = self.relative_variances
        if not shared:
            variances = variances / (self.counts * np.float32(self.noise_ratio))
        return collaborate_on_graph(self.graph, noisy, pilot, mixing, variances, progress, is_whole=shared)

    def add_enlarged_in_place(self, stack: Stack, changes: Stack) -> None:
        """Add changes of clusters to their samples, smoothed like bilinear interpolation of squares."""
        variance = 1 / (12 * self.noise_ratio)
        rows = large_arrays.empty(stack.shape, np.float32)
        for block in large_arrays.blocks(len(rows)):
            rows[block] = changes[self.members[block]]
        stack += self.samples.smoothed(rows, variance)

    @property
    def shape(self) -> tuple[int, ...]:
        return (self.graph.size,)

    def total(self, planes: Float32s) -> Float64s:
        return np.asarray(np.sum(planes * self.counts, axis=1, dtype=np.float64))

    def spread(self, planes: Float32s) -> Float32s:
        rows = np.ascontiguousarray((planes * (self.counts * np.float32(self.noise_ratio))).T)
        return np.ascontiguousarray(self.graph.smoothed(rows, self.width**2).T)
