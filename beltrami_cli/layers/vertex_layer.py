"""Common base of colours of vertices: on a mesh, on a surface fitted to points, or on a grid."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np

from beltrami_cli.arrays import Float32s
from beltrami_cli.flow.beltrami_flow import FlowResult
from beltrami_cli.flow.manifolds.new_colours import NewColours
from beltrami_cli.flow.plan import Plan
from beltrami_cli.formats.colours import as_in_file
from beltrami_cli.layers.channels import ChosenChannels, choose_channels
from beltrami_cli.layers.layer import Layer, Part, SampledVertices
from beltrami_cli.layers.reports import VertexReport
from beltrami_cli.layers.storing import Change, StoredColours
from beltrami_cli.layers.units import unit_of_vertices
from beltrami_cli.surface.colour_values import from_space, to_space, unit_in_space
from beltrami_cli.surface.large_arrays import blocks, copy_of
from beltrami_cli.surface.records import ColouredVertices


@dataclass(frozen=True, kw_only=True, eq=False)
class VertexLayer(Layer):
    part: ClassVar[Part] = "vertices"

    vertices: ColouredVertices
    stored_unit: float = 1.0  # stored number that becomes 1 in the working space

    @cached_property
    def channels(self) -> ChosenChannels:
        return choose_channels(self.vertices.channels, self.settings, "the colours have")

    @property
    def triangulated(self) -> ColouredVertices:
        """The vertices with all triangles that are known of their surface."""
        return self.vertices

    def _in_own_unit(self) -> Self:
        are_data = self.settings.space == "data"
        unit = unit_of_vertices(self.triangulated, self.channels.sampled, are_data=are_data)
        return dataclasses.replace(self, stored_unit=unit)

    def unit_in(self, space: str) -> float:
        return unit_in_space(self.stored_unit, self.vertices.encoding, space)

    @abstractmethod
    def places(self) -> SampledVertices: ...

    @property
    @abstractmethod
    def stored_colours(self) -> Float32s:
        """The stored colours of the samples in the working space, shape (S, N)."""

    def working(self, rows: Any) -> Float32s:
        """Return the sampled channels of some vertices in the working space, shape (K, N)."""
        colours = self.vertices.colours[rows][:, self.channels.sampled]
        return to_space(colours, self.vertices.encoding, self.settings.space, self.stored_unit)

    def encode(self, new: NewColours, *, is_smoothed: bool = True) -> StoredColours:
        del is_smoothed
        before, changing, written = self.vertices, self.channels.changing, self.channels.written
        sample_of, after = self.places().sample_of, new.table()[:, written]
        is_changed = np.any(after != self.stored_colours[:, written], axis=1)
        changed = np.flatnonzero(np.append(is_changed, False)[sample_of])  # the number -1 reads the last
        colours = copy_of(before.colours)
        if len(changed):
            low, high = (limit(axis=0)[changing] for limit in (before.colours.min, before.colours.max))
        for block in blocks(len(changed)):
            rows = changed[block]
            back = from_space(after[sample_of[rows]], before.encoding, self.settings.space, self.stored_unit)
            # Conversion there and back is not exact, but its result stays in range.
            colours[rows[:, None], changing] = np.clip(back, low, high)
        positions = None if new.positions is None else new.positions[sample_of]
        return StoredColours(change_of(before, colours), colours, positions)

    def _report(self, plan: Plan[Any], result: FlowResult[Any], counts: dict[str, float]) -> VertexReport:
        return VertexReport(
            counts={
                "vertices": len(self.vertices.colours),
                **counts,
                "samples_per_kernel": round(result.samples_per_kernel, 2),
                "truncated_kernels": result.truncated,
            },
            spacing=plan.manifold.geometry.spacing,
            **self._common_report(plan, result),
        )

    def _described_colours(self) -> dict[str, object]:
        """Return facts about the stored colours, in JSON types."""
        vertices, colours = self.vertices, self.vertices.colours
        return {
            "channels": list(vertices.channels),
            "stored": vertices.stored,
            "encoding": vertices.encoding,
            "full_scale": vertices.full_scale,
            "least": [float(value) for value in colours.min(axis=0)] if len(colours) else [],
            "greatest": [float(value) for value in colours.max(axis=0)] if len(colours) else [],
        }


def change_of(vertices: ColouredVertices, colours: Float32s) -> Change:
    """Return how new colours of vertices change them in the file."""
    return Change.joined(
        Change.between(as_in_file(vertices, vertices.colours[block]), as_in_file(vertices, colours[block]))
        for block in blocks(len(colours))
    )
