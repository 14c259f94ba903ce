"""The common part of coloured vertices, whether triangles join them or a grid does."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Float32s, Float64s, Int32s, Int64s
from beltrami_cli.flow.beltrami_flow import FlowResult, Plan
from beltrami_cli.flow.embedding import Guide, from_space
from beltrami_cli.layers.layer import Change, ChosenChannels, Layer, Part, Repainted, choose_channels
from beltrami_cli.layers.reports import VertexReport
from beltrami_cli.layers.settings import SmoothSettings
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


@dataclass(frozen=True, kw_only=True, eq=False)
class PaintedLayer(Layer):
    """The common part of vertices on a mesh and on a grid."""

    part: ClassVar[Part] = "vertices"

    painted: PaintedVertices
    settings: SmoothSettings
    guides: Sequence[Guide] = ()
    noise: Float32s | None = None  # standard deviations, with a row for each vertex
    in_triangles: bool = False  # vertices in no triangle have no colour

    @cached_property
    def channels(self) -> ChosenChannels:
        return columns_of(self.painted, self.settings)

    @cached_property
    def names(self) -> tuple[str, ...]:
        return tuple(self.painted.channels[channel] for channel in self.channels.sampled)

    @property
    def joined(self) -> PaintedVertices:
        """The vertices with triangles: from the file, or of the surface that is fitted to points."""
        return self.painted

    @abstractmethod
    def sample_of(self, plan: Plan[Any]) -> Int64s:
        """Return the sample of a manifold that each of the V vertices belongs to, shape (V,); -1: none."""

    def _report(self, plan: Plan[Any], result: FlowResult[Any], counts: dict[str, float]) -> VertexReport:
        return VertexReport(
            counts={
                "vertices": len(self.painted.colours),
                **counts,
                "samples_per_kernel": round(result.samples_per_kernel, 2),
                "truncated_kernels": result.truncated,
            },
            spacing=plan.manifold.geometry.spacing,
            **self._used(plan, result),
        )

    def _repainted(
        self, vertices: NDArray[np.integer[Any]], after: Float32s, positions: Float64s | None = None
    ) -> Repainted:
        """Give some vertices new colours; conversion there and back is not exact, but its result stays in range."""
        painted, changing = self.painted, self.channels.changing
        colours = painted.colours.copy()
        if len(vertices):
            before = painted.colours[:, changing]
            back = from_space(after, painted.encoding, self.settings.space)
            colours[vertices[:, None], changing] = np.clip(back, before.min(axis=0), before.max(axis=0))
        return Repainted(Change.between(painted.colours, colours), colours, positions)


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
