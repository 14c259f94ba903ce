"""Pieces of a triangulated surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.flow.partitions.exchange import Advance
from beltrami_cli.flow.partitions.rings import Neighbours

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli._native import SegmentManifold, TriangulatedManifold
    from beltrami_cli.flow.mesh_metric import MeshMetric
    from beltrami_cli.flow.parameters import KernelParameters

# Sixteen samples make a group of the solver along segments, and groups are cut within blocks of so many samples that
# follow each other. What a group holds changes the rounding of its averages, so pieces own whole blocks.
_BLOCK = 4096

# All that the core knows of a sample is as on the whole surface if all samples within so many edges are there. Segments
# lead over strips of three triangles, which end two edges away; an obtuse corner is unfolded over up to 48 triangles.
# To that come the corner's own triangle, the triangles beyond the strip's edges, which tell whether it may go on, and
# the neighbours of all these, from which the colours are smoothed that distances are taken from.
_KNOWN_FOR_SEGMENTS = 4
_KNOWN_FOR_MARCHING = 52

# A kernel value that does not vanish in float32, nor in an average over many samples.
_FAINTEST = 1e-20

_UNLIMITED = 2**31 - 1


@dataclass(frozen=True)
class MeshFields:
    """A surface as the flow has it, its S samples in the order in which they lie in memory.

    Attributes
    ----------
    positions : ndarray of float64, shape (S, M)
        Of the samples.
    faces : ndarray of int32, shape (F, 3)
        All triangles, walls of hard edges too.
    edges : ndarray of int32, shape (E, 2)
        All edges of these.
    scales, weights : ndarray of float32, shape (S,), or None
        As the core takes them.
    metric : MeshMetric
        Of the whole surface.
    channels : int
        How many of the values are colours, which the metric is made of.
    parameters : KernelParameters
        What to run with.
    along_segments : bool
        The solver.
    """

    positions: NDArray[np.float64]
    faces: NDArray[np.int32]
    edges: NDArray[np.int32]
    scales: NDArray[np.float32] | None
    weights: NDArray[np.float32] | None
    metric: MeshMetric
    channels: int
    parameters: KernelParameters
    along_segments: bool


class MeshPiece:
    """Samples [first, last) of a surface with what lies around them, as a surface of its own.

    Parameters
    ----------
    fields : MeshFields
        The whole surface.
    first, last : int
        What it owns: whole blocks.
    ring : ndarray of int32, shape (S,)
        How many edges samples are away from these; -1: they do not belong to the piece.
    known : int
        Samples up to this ring have all their neighbours that matter in the piece.
    """

    def __init__(
        self, fields: MeshFields, first: int, last: int, ring: NDArray[np.int32], known: int
    ) -> None:
        samples = np.flatnonzero(ring >= 0)
        before = int(np.count_nonzero(samples < first))
        gap = -before % _BLOCK  # so that the blocks begin where blocks begin
        places = np.arange(len(samples)) + np.where(samples < first, 0, gap)
        self._count, self._gap = len(samples) + gap, gap
        rank = np.full(len(ring), -1, np.int32)
        rank[samples] = places
        inside = (samples >= first) & (samples < last)
        self.owned, self.borrowed = samples[inside], samples[~inside]
        self._first = before + gap
        self._borrowed_places = places[~inside]
        corners = rank[fields.faces]
        self._faces = corners[(corners >= 0).all(axis=1)]
        self._positions = self._at(places, fields.positions[samples])
        self._scales = None if fields.scales is None else self._at(places, fields.scales[samples], 1)
        self._weights = None if fields.weights is None else self._at(places, fields.weights[samples], 1)
        self._unknown = self._at(places, (ring[samples] > known).astype(np.float32)[:, None])
        self._metric = fields.metric.piece(rank, samples, self._count)
        self._beta, self._channels = fields.metric.beta, fields.channels
        self._parameters, self._along_segments = fields.parameters, fields.along_segments
        self.threads = fields.parameters.threads
        self._manifold: SegmentManifold | TriangulatedManifold | None = None

    def _at(self, places: NDArray[np.int64], rows: NDArray[Any], filling: float = 0) -> NDArray[Any]:
        spread = np.full((self._count, *rows.shape[1:]), filling, rows.dtype)
        spread[places] = rows
        return spread

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_manifold": None}  # made again wherever it is needed

    def advance(
        self, own: NDArray[np.float32], borrowed: NDArray[np.float32], iteration: int, threads: int
    ) -> Advance:
        """As for `Piece`."""
        manifold = self._ready()
        values = np.zeros((self._count, own.shape[1]), np.float32)
        values[self._first : self._first + len(own)] = own
        values[self._borrowed_places] = borrowed
        parameters = self._parameters
        metric, beta = self._metric.join(
            np.ascontiguousarray(values[:, : self._channels]),
            self._beta * parameters.growth(iteration),
            regularised=parameters.is_regularised(iteration),
        )
        manifold.update_metric(self._positions, metric, beta, self._scales, threads)
        # What is not fully known is marked in a channel of its own: averages are not 0 where kernels hold any of it.
        marks_ride_along = self._weights is None and parameters.threshold >= _FAINTEST
        if marks_ride_along:
            values = np.concatenate([values, self._unknown], axis=1)
        smoothed, held, truncated = manifold.smooth(
            values, self._weights, parameters.t, parameters.radius, parameters.max_samples, threads, None
        )
        mine = smoothed[self._first : self._first + len(own)]
        if marks_ride_along:
            is_exact, mine = not mine[:, -1].any(), mine[:, :-1]
        # Along segments, what kernels reached before they were cut short tells in which order the rest is summed up.
        cut_short = self._along_segments and truncated > 0
        if cut_short or not marks_ride_along:
            most = _UNLIMITED if cut_short else parameters.max_samples
            is_exact = not self._reaches_unknown(manifold, parameters.radius, most, threads)
        # The core counts for all samples; of those around about the same holds as of those that are owned.
        share = len(own) / max(1, self._count - self._gap)
        return Advance(
            np.ascontiguousarray(mine), (held - self._gap) * share, round(truncated * share), is_exact
        )

    def _ready(self) -> SegmentManifold | TriangulatedManifold:
        """Return the manifold, made where it is needed."""
        if self._manifold is None:
            from beltrami_cli._native import SegmentManifold, TriangulatedManifold

            solver = SegmentManifold if self._along_segments else TriangulatedManifold
            self._manifold = solver(self._faces, self._count)
        return self._manifold

    def _reaches_unknown(
        self, manifold: SegmentManifold | TriangulatedManifold, radius: float, most: int, threads: int
    ) -> bool:
        """Tell whether kernels of the samples that it owns hold any that is not fully known."""
        # With so long a time step no kernel value is small.
        marks, _, _ = manifold.smooth(
            self._unknown, None, max(radius, 1e-6) ** 2, radius, most, threads, None
        )
        return bool(marks[self._first : self._first + len(self.owned)].any())


def cut_mesh(fields: MeshFields, count: int, reach: int) -> list[MeshPiece]:
    """Cut a surface into pieces.

    Parameters
    ----------
    fields : MeshFields
        The whole.
    count : int
        How many; fewer if there are not so many blocks of samples.
    reach : int
        How many edges away kernels may reach.
    """
    size = len(fields.positions)
    neighbours = Neighbours(size, fields.edges)
    blocks = -(-size // _BLOCK)
    borders = np.unique(np.linspace(0, blocks, min(count, blocks) + 1).round().astype(int)) * _BLOCK
    beyond = _KNOWN_FOR_SEGMENTS if fields.along_segments else _KNOWN_FOR_MARCHING
    pieces = []
    for first, last in zip(borders[:-1].tolist(), np.minimum(borders[1:], size).tolist(), strict=True):
        ring = neighbours.rings(first, last, reach + beyond)
        pieces.append(MeshPiece(fields, first, last, ring, reach))
    return pieces
