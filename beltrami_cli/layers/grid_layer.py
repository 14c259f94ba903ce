"""Colours on a grid: the vertices of a range image, or the pixels of an array."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Indices
from beltrami_cli.flow.beltrami_flow import FlowResult
from beltrami_cli.flow.decoding import plan_on_canvas
from beltrami_cli.flow.manifolds.grid.manifold import GridManifold
from beltrami_cli.flow.plan import Plan
from beltrami_cli.layers.image_surface import ImageSurface, canvas_of_image
from beltrami_cli.layers.layer import SampledVertices
from beltrami_cli.layers.reports import VertexReport
from beltrami_cli.layers.vertex_layer import VertexLayer


@dataclass(frozen=True, kw_only=True, eq=False)
class GridLayer(VertexLayer):
    """Vertices on a grid with holes."""

    label = "range image"

    grid: Indices  # shape (H, W): numbers of the vertices, -1 at holes
    surface: ImageSurface | None = None  # with the same holes; None: at the positions of the vertices

    @cached_property
    def _valid(self) -> Bools:
        """Where the grid has a vertex with a finite position, shape (H, W)."""
        has_place = np.isfinite(self.vertices.positions).all(axis=1)
        return np.append(has_place, False)[self.grid]  # the number -1 reads the last

    @cached_property
    def _measured(self) -> Indices:
        """The vertices of the samples, shape (S,)."""
        return self.grid[self._valid]

    def plan(self, tick: Callable[[], None] | None = None) -> Plan[GridManifold]:
        space, surface, vertex_at = self.settings.space, self.surface, self.grid.reshape(-1)
        if surface is None:
            positions = self._by_pixel(self.vertices.positions).reshape(*self.grid.shape, -1)
            surface = ImageSurface(positions=positions, valid=self._valid)
        canvas = canvas_of_image(
            surface, lambda pixels: self.working(vertex_at[pixels]), self.kernel,
            metric_channels=self.channels.metric,
            light=space if self.vertices.encoding == "linear" and space != "data" else None,
            guides=[dataclasses.replace(each, values=self._by_pixel(each.values)) for each in self.guides],
            deviations=None if self.deviations is None else self._by_pixel(self.deviations),
        )  # fmt: skip
        return plan_on_canvas(dataclasses.replace(canvas, resources=self.resources), tick=tick)

    def _by_pixel(self, values: Array) -> Array:
        """Return rows of vertices as rows of pixels; zeros at holes."""
        table = np.zeros((self.grid.size, *values.shape[1:]), values.dtype)
        table[self._valid.reshape(-1)] = values[self._measured]
        return table

    def places(self) -> SampledVertices:
        sample_of = np.full(len(self.vertices.positions), -1)
        sample_of[self._measured] = np.arange(len(self._measured))
        return SampledVertices(self.vertices, sample_of)

    @property
    def stored_colours(self) -> Float32s:
        return self.working(self._measured)

    def report(self, plan: Plan[GridManifold], result: FlowResult[GridManifold]) -> VertexReport:
        counts: dict[str, float] = {
            "triangles": len(self.vertices.faces),
            "samples": len(self._measured),
            "hard_edge_samples": 0,
        }
        return self._report(plan, result, counts)

    def describe(self) -> dict[str, object]:
        plan, grid, samples = self.plan(), self.grid, len(self._measured)
        return {
            "colours": self._described_colours(),
            "surface": {
                "range_image": [grid.shape[1], grid.shape[0]],
                "vertices": len(self.vertices.positions),
                "samples": samples,
                "holes": grid.size - samples,
                "mean_edge_length": plan.manifold.geometry.spacing,
            },
            **self._described_plan(plan),
        }
