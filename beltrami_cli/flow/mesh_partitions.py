"""Partitions of a triangulated surface: consecutive samples, and what lies around them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Int32s
from beltrami_cli.flow.manifold import Metric
from beltrami_cli.flow.mesh_manifold import MeshManifold, average_rows
from beltrami_cli.flow.partitions import Advance
from beltrami_cli.flow.records import Step, at_step

# Sixteen samples make a group of the solver along segments, and groups are formed within blocks of this many
# consecutive samples. The members of a group change the rounding of its averages, so partitions own whole blocks.
_BLOCK = 4096

# A sample has the same data in the core as on the whole surface if all samples within this many edges are present.
# Segments cross strips of three triangles, which end two edges away; an obtuse corner is unfolded over up to 48
# triangles. Add the corner's own triangle, the triangles beyond the strip's edges, which decide whether it may
# continue, and the neighbours of all these, over which the colours of the regularised metric are smoothed.
_KNOWN_FOR_SEGMENTS = 4
_KNOWN_FOR_MARCHING = 52

# A kernel value that does not vanish in float32, nor in an average over many samples.
_FAINTEST = 1e-20

_UNLIMITED = 2**31 - 1

# How far, in edges, kernels are first expected to reach for each sample spacing.
EDGES_PER_SPACING = 2.0


class MeshPartition:
    """Samples [first, last) of a surface with what lies around them, a `Partition`."""

    def __init__(
        self,
        whole: MeshManifold,
        owned: tuple[int, int],
        ring: Int32s,  # edges from each sample to the owned ones, shape (S,); -1: not received
        known: int,
        steps: Sequence[Step],
        channels: int,
    ) -> None:
        first, last = owned
        samples = np.flatnonzero(ring >= 0)
        before = int(np.count_nonzero(samples < first))
        gap = -before % _BLOCK  # so that the blocks begin where blocks begin
        places = np.arange(len(samples)) + np.where(samples < first, 0, gap)
        self._part = whole.cut(samples, places, len(samples) + gap)
        # Up to `known` edges away from the owned samples all data are as on the whole surface.
        self._gap, self._steps, self._channels = gap, tuple(steps), channels
        inside = (samples >= first) & (samples < last)
        self.owned, self.borrowed = samples[inside], samples[~inside]
        self._own = slice(before + gap, before + gap + len(self.owned))
        self._borrowed_places = places[~inside]
        self._unknown = np.zeros((len(samples) + gap, 1), np.float32)
        self._unknown[places, 0] = ring[samples] > known
        self.threads = whole.parameters.threads

    def advance(self, own: Float32s, borrowed: Float32s, iteration: int, threads: int) -> Advance:
        parameters = dataclasses.replace(self._part.parameters, threads=threads)
        part, size = dataclasses.replace(self._part, parameters=parameters), len(self._unknown)
        values = np.zeros((size, own.shape[1]), np.float32)
        values[self._own] = own
        values[self._borrowed_places] = borrowed
        metric = part.measure(np.ascontiguousarray(values[:, : self._channels]), self._steps[iteration])
        # Incomplete samples are marked in a further channel: averages are not 0 where kernels hold any of them.
        marks_ride_along = parameters.weights == "uniform" and parameters.threshold >= _FAINTEST
        channels = np.concatenate([values, self._unknown], axis=1) if marks_ride_along else values
        smoothed, held, truncated = average_rows(part, channels, metric)
        mine, is_exact = smoothed[self._own], True
        if marks_ride_along:
            is_exact, mine = not mine[:, -1].any(), mine[:, :-1]
        # Along segments, the samples that kernels reached before they were cut short decide the order of summation.
        cut_short = part.geometry.is_along_segments and truncated > 0
        if cut_short or not marks_ride_along:
            limit = _UNLIMITED if cut_short else parameters.max_samples
            is_exact = not _marked(part, metric, self._unknown, limit)[self._own].any()
        # The core counts over all samples; the share of the owned ones is estimated.
        share = len(own) / max(1, size - self._gap)
        return Advance(
            np.ascontiguousarray(mine), (held - self._gap) * share, round(truncated * share), is_exact
        )


def _marked(part: MeshManifold, metric: Metric, marks: Float32s, max_samples: int) -> Bools:
    """Find the samples whose kernels hold a marked one, with kernels of up to `max_samples`."""
    own = at_step(part.parameters, metric.step)
    t = max(own.radius, 1e-6) ** 2  # with such a long time step no kernel value is small
    averages = part.geometry.core.smooth(marks, None, t, own.radius, max_samples, own.thread_count, None)[0]
    return np.asarray(averages.any(axis=1))


def cut_mesh(
    whole: MeshManifold, count: int, widening: int, steps: Sequence[Step], channels: int
) -> list[MeshPartition]:
    """Cut into up to `count` partitions, which receive samples as far as kernels are expected to reach."""
    mesh, own = whole.geometry, whole.parameters
    spacing = (mesh.spacing or 1.0) if own.units == "world" else 1.0
    reach = widening * min(mesh.size, 2 + int(EDGES_PER_SPACING * own.radius / spacing))
    if any(step.regularised for step in steps):
        gain = mesh.gaussian(own.metric_scale).gain
        whole = dataclasses.replace(whole, geometry=dataclasses.replace(mesh, gain=gain))
    neighbours = Neighbours(mesh.size, mesh.core.edges())
    blocks = -(-mesh.size // _BLOCK)
    borders = np.unique(np.linspace(0, blocks, min(count, blocks) + 1).round().astype(int)) * _BLOCK
    beyond = _KNOWN_FOR_SEGMENTS if mesh.is_along_segments else _KNOWN_FOR_MARCHING
    partitions = []
    for owned in zip(borders[:-1].tolist(), np.minimum(borders[1:], mesh.size).tolist(), strict=True):
        ring = neighbours.rings(*owned, reach + beyond)
        partitions.append(MeshPartition(whole, owned, ring, reach, steps, channels))
    return partitions


class Neighbours:
    """The neighbours of every vertex, from edges of shape (E, 2)."""

    def __init__(self, count: int, edges: Int32s) -> None:
        both = np.concatenate([edges[:, 0], edges[:, 1]])
        order = np.argsort(both, kind="stable")
        self._targets = np.concatenate([edges[:, 1], edges[:, 0]])[order]
        self._offsets = np.zeros(count + 1, np.int64)
        np.cumsum(np.bincount(both, minlength=count), out=self._offsets[1:])

    def rings(self, first: int, last: int, limit: int) -> Int32s:
        """Return for each vertex how many edges it is away from those in [first, last); -1: more than `limit`."""
        ring = np.full(len(self._offsets) - 1, -1, np.int32)
        ring[first:last] = 0
        front: Int32s = np.arange(first, last, dtype=np.int32)
        for number in range(1, limit + 1):
            around: Int32s = np.unique(self._around(front))
            front = around[ring[around] < 0]
            if not len(front):
                break
            ring[front] = number
        return ring

    def _around(self, vertices: Int32s) -> Int32s:
        starts = self._offsets[vertices]
        counts = self._offsets[vertices + 1] - starts
        # Entry i of a row of `counts` numbers that begins at `starts`.
        places = np.arange(int(counts.sum())) + np.repeat(starts - (np.cumsum(counts) - counts), counts)
        around: Int32s = self._targets[places]
        return around
