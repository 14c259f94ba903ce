"""Means of clusters of neighbouring vertices, at which patches see further: shared noise, and plain colours."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import islice
from typing import ClassVar

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s
from beltrami_cli.flow.chunks import Figures, Work, chunking
from beltrami_cli.flow.domain import CoarseLevel, Mixing, Stack
from beltrami_cli.flow.noise.haar_noise import root_of
from beltrami_cli.flow.risk import random_signs
from beltrami_cli.flow.vertex_graph import Graph, Level, levels_of

# Fewer clusters hold no patches that could be compared.
_FEWEST = 500


def collaborate_on_graph(
    graph: Graph,
    noisy: Stack,
    pilot: Stack,
    mixing: Mixing,
    relative: Float32s | None,
    progress: Callable[[int], None] | None = None,
    *,
    is_whole: bool = False,
) -> Stack:
    """Estimate colours from similar patches, compared on the pilot; `relative`: variance of the noise by its mean."""
    stacks, wanted = [noisy, pilot, *([] if relative is None else [relative[:, None]])], chunking()
    # Parameters are chosen by colours without shared noise, which must have the same bits in any number of chunks.
    if wanted is None or is_whole:
        sums, _ = _sums_of_patches(graph, stacks, graph.threads, mixing, progress)
    else:
        sums = np.zeros((graph.size, 2 * noisy.shape[1]), np.float32)
        work = Work(_sums_of_patches, (mixing,), adds=True)
        wanted.apply(graph.chunks, work, stacks, sums, progress, size=graph.size, threads=graph.threads)
    estimates, weights = np.split(sums, 2, axis=1)
    is_known = weights > 0  # not of isolated samples
    mixed = np.divide(estimates, weights, out=np.zeros_like(pilot), where=is_known)
    return np.where(is_known, np.einsum("ij,sj->si", mixing.back, mixed), pilot)


def _sums_of_patches(
    graph: Graph,
    stacks: Sequence[Stack],
    threads: int,
    mixing: Mixing,
    progress: Callable[[int], None] | None = None,
) -> tuple[Float32s, Figures]:
    """Sum what the groups of patches estimate of mixed channels, and the weights of that, shape (S, 2 N)."""
    noisy, pilot, *relative = stacks
    estimates, weights = np.zeros_like(noisy), np.zeros_like(noisy)
    variances = relative[0][:, 0] if relative else None
    graph.patches.collaborate(
        noisy, pilot, mixing.parts, variances, mixing.has_pilot, estimates, weights, threads, progress
    )
    return np.concatenate([estimates, weights], axis=1), (0, 0)


class Clusters(CoarseLevel):
    """Means of clusters of samples, as a stack with a row a cluster."""

    axis: ClassVar[int] = 1
    width: ClassVar[float] = 3.0

    def __init__(self, samples: Graph, level: Level, relative: Float32s) -> None:
        self._samples, self._level, self._graph = samples, level, level.graph
        self._counts, self.noise, self.relative = level.counts, level.noise, relative

    def means(self, stack: Stack) -> Float32s:
        return self._level.means(stack)

    def probe(self, means: Stack, noise: Float64s) -> Stack:
        signs = random_signs(means, self._graph.priorities, 1)[0]
        return np.asarray(np.einsum("ij,sj->si", root_of(noise), signs), np.float32)

    def collaborate(self, noisy: Stack, pilot: Stack, mixing: Mixing, *, shared: bool = False) -> Stack:
        """Estimate means from patches of clusters; shared noise does not fall with their size."""
        relative = self.relative if shared else self.relative / (self._counts * np.float32(self.noise))
        return collaborate_on_graph(self._graph, noisy, pilot, mixing, relative, is_whole=shared)

    def add_enlarged(self, stack: Stack, changes: Stack) -> None:
        """Add changes of clusters to their samples, smoothed as far as linear interpolation smooths squares."""
        variance = 1 / (12 * self.noise)
        stack += self._samples.smoothed(changes[self._level.members], variance)

    def planes(self, count: int) -> Float32s:
        return np.zeros((count, self._graph.size), np.float32)

    def total(self, planes: Float32s) -> Float64s:
        return np.asarray(np.sum(planes * self._counts, axis=1, dtype=np.float64))

    def spread(self, planes: Float32s) -> Float32s:
        rows = np.ascontiguousarray((planes * (self._counts * np.float32(self.noise))).T)
        return np.ascontiguousarray(self._graph.smoothed(rows, self.width**2).T)


def clusters_for(samples: Graph, most: int, relative: Float32s | None) -> list[Clusters]:
    """Return up to `most` levels of clusters, fine to coarse, as far as they hold enough of them."""
    found: list[Clusters] = []
    variances = np.ones((samples.size, 1), np.float32) if relative is None else relative
    for level in islice(levels_of(samples), 1, most + 1):
        if level.graph.size < _FEWEST:
            break
        found.append(Clusters(samples, level, level.means(variances)[:, 0]))
    return found
