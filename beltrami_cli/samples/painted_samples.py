"""The common part of coloured vertices, whether triangles join them or a grid does."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Float32s, Float64s, Int32s, Int64s
from beltrami_cli.flow.beltrami_flow import FlowResult, Plan
from beltrami_cli.flow.embedding import Guide, from_space, to_space
from beltrami_cli.samples.reports import VertexReport
from beltrami_cli.samples.samples import (
    Change,
    ChosenChannels,
    Grains,
    Part,
    Repainted,
    Samples,
    choose_channels,
)
from beltrami_cli.samples.settings import SmoothSettings
from beltrami_cli.surface.grouping import group_places
from beltrami_cli.surface.records import PaintedVertices


def columns_of(painted: PaintedVertices, settings: SmoothSettings) -> ChosenChannels:
    """Choose the columns of vertex colours."""
    return choose_channels(painted.channels, settings, "the colours have")


def describe_colours(painted: PaintedVertices) -> dict[str, object]:
    """Return facts about colours of vertices, in JSON types."""
    colours = painted.colours
    return {
        "channels": list(painted.channels),
        "stored": painted.stored,
        "encoding": painted.encoding,
        "full_scale": painted.full_scale,
        "least": [float(value) for value in colours.min(axis=0)] if len(colours) else [],
        "greatest": [float(value) for value in colours.max(axis=0)] if len(colours) else [],
    }


class PaintedSamples(Samples):
    """The common part of vertices on a mesh and on a grid; `in_triangles`: vertices in none have no colour."""

    part: ClassVar[Part] = "vertices"

    def __init__(
        self,
        painted: PaintedVertices,
        settings: SmoothSettings,
        guides: Sequence[Guide] = (),
        noise: Float32s | None = None,
        *,
        in_triangles: bool = False,
    ) -> None:
        self.painted, self.settings, self.guides = painted, settings, tuple(guides)
        self._noise, self._in_triangles = noise, in_triangles
        self.channels = columns_of(painted, settings)
        self.names = tuple(painted.channels[channel] for channel in self.channels.sampled)

    @property
    def joined(self) -> PaintedVertices:
        """The vertices with triangles: their own, or those of the surface that points lie on."""
        return self.painted

    @abstractmethod
    def sample_of(self, plan: Plan[Any]) -> Int64s:
        """Return the sample of a manifold that each of the V vertices belongs to, shape (V,); -1: none."""

    def grains(self) -> Grains:
        # One random number for each place, so that split vertices stay equal.
        rows = self.coloured()
        painted, channels = self.painted, self.channels.changing
        colours = to_space(painted.colours[rows][:, channels], painted.encoding, self.settings.space)
        return Grains(colours, places_of(painted, rows), space=self.settings.space)

    def places(self) -> tuple[Float64s, Float64s]:
        painted, rows = self.painted, self.coloured()
        positions, place_of = painted.positions[rows], places_of(painted, rows)
        return positions, spacing_of(painted, rows, place_of)

    def coloured(self) -> NDArray[np.intp]:
        return coloured_rows(self.painted, in_triangles=self._in_triangles)

    def shift(self, grains: Grains, after: Float32s) -> Repainted:
        painted, places = self.painted, (self.coloured()[:, None], self.channels.changing)
        back = from_space(after, painted.encoding, self.settings.space)
        colours = painted.colours.copy()
        # Conversion to the working space and back is not exact: unchanged colours keep their bits.
        colours[places] = np.where(after != grains.colours, back, colours[places])
        return Repainted(Change.between(painted.colours, colours), colours)

    def _report(self, plan: Plan[Any], result: FlowResult[Any], counts: dict[str, float]) -> VertexReport:
        return VertexReport(
            counts={
                "vertices": len(self.painted.positions),
                **counts,
                "samples_per_kernel": round(result.samples_per_kernel, 2),
                "truncated_kernels": result.truncated,
            },
            spacing=plan.manifold.spacing,
            **self._used(plan, result),
        )

    def _repainted(self, vertices: NDArray[np.intp], after: Float32s) -> Repainted:
        """Give some vertices new colours; conversion there and back is not exact, but its result stays in range."""
        painted, changing = self.painted, self.channels.changing
        colours = painted.colours.copy()
        if len(vertices):
            before = painted.colours[:, changing]
            back = from_space(after, painted.encoding, self.settings.space)
            colours[vertices[:, None], changing] = np.clip(back, before.min(axis=0), before.max(axis=0))
        return Repainted(Change.between(painted.colours, colours), colours)


def coloured_rows(painted: PaintedVertices, *, in_triangles: bool = False) -> NDArray[np.intp]:
    """Return the vertices with a finite position, or only those in triangles."""
    valid = np.asarray(np.isfinite(painted.positions).all(axis=1))
    if in_triangles:
        found = np.zeros(len(valid), bool)
        found[painted.faces] = True
        valid &= found
    return np.flatnonzero(valid)


def only_rows(
    painted: PaintedVertices, rows: NDArray[np.integer[Any]], faces: Int32s | None = None
) -> PaintedVertices:
    """Return some of the vertices, with triangles of these, or none."""
    return dataclasses.replace(
        painted,
        positions=painted.positions[rows],
        faces=np.empty((0, 3), np.int32) if faces is None else faces,
        colours=painted.colours[rows],
        space_of=None if painted.space_of is None else painted.space_of[rows],
    )


def spacing_of(painted: PaintedVertices, rows: NDArray[np.intp], place_of: Int32s) -> Float64s:
    """Return the mean length of the sides at each vertex's place, or of points the distance to the next place."""
    count = int(place_of.max(initial=-1)) + 1
    first = np.zeros(count, np.int64)
    first[place_of] = np.arange(len(rows))
    places = painted.positions[rows[first]]
    if not len(painted.faces) and count > 1:
        from scipy.spatial import cKDTree

        apart = np.asarray(cKDTree(places).query(places, k=2)[0], np.float64)
        return np.asarray(apart[place_of, 1])
    number = np.full(len(painted.positions), -1)
    number[rows] = place_of
    corners = number[painted.faces]
    sides = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    sides = sides[(sides >= 0).all(axis=1) & (sides[:, 0] != sides[:, 1])]
    lengths = np.linalg.norm(places[sides[:, 0]] - places[sides[:, 1]], axis=1)
    total = np.bincount(sides.ravel(), np.repeat(lengths, 2), count)
    ends = np.bincount(sides.ravel(), minlength=count)
    return np.asarray((total / np.maximum(ends, 1))[place_of], np.float64)


def places_of(painted: PaintedVertices, rows: NDArray[np.intp]) -> Int32s:
    """Return the number of each vertex's place, shape (S,)."""
    spaces = None if painted.space_of is None else painted.space_of[rows]
    return group_places(painted.positions[rows], spaces)[0]
