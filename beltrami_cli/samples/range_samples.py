"""Colours of a range image as samples of a manifold: vertices on the grid that they were measured on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.arrays import Float32s, Int64s
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.beltrami_flow import BeltramiFlow, FlowResult
from beltrami_cli.flow.embedding import Guide, to_space
from beltrami_cli.flow.grid_manifold import GridManifold
from beltrami_cli.flow.records import NewColours
from beltrami_cli.formats.document import Document
from beltrami_cli.samples.image_surface import ImageSurface, grid_flow, options_of_meshes
from beltrami_cli.samples.painted_samples import PaintedSamples, describe_colours
from beltrami_cli.samples.reports import VertexReport
from beltrami_cli.samples.samples import Repainted
from beltrami_cli.samples.settings import SmoothSettings
from beltrami_cli.surface.records import PaintedVertices

if TYPE_CHECKING:
    from beltrami_cli.samples.probes.probe import Probe


class RangeSamples(PaintedSamples):
    """Vertices on a grid, shape (H, W), of vertex numbers, or -1 at holes."""

    label = "range image"

    def __init__(
        self,
        painted: PaintedVertices,
        grid: Int64s,
        settings: SmoothSettings,
        guides: Sequence[Guide] = (),
        noise: Float32s | None = None,
    ) -> None:
        super().__init__(painted, settings, guides, noise)
        self.grid = grid

    def flow(self, tick: Callable[[], None] | None = None) -> BeltramiFlow[GridManifold]:
        if wrong := options_of_meshes(self.settings):
            cause = f"{', '.join(wrong)}: not on range images, whose vertices lie on a grid; leave it out"
            raise UsageError(cause)
        measured = self.grid >= 0
        positions = np.full((*self.grid.shape, 3), np.nan)
        positions[measured] = self.painted.positions[self.grid[measured]]
        surface, kernel = ImageSurface(None, positions, measured), self.settings.kernel
        known = self.guides, self.channels.metric, tick, self._noise
        return grid_flow(surface, self._working, kernel, *known, rows=self.grid.reshape(-1))

    def _working(self, places: Int64s) -> Float32s:
        """Return the colours at some places of the grid in the working space, shape (T, N)."""
        colours = self.painted.colours[self.grid.reshape(-1)[places]][:, self.channels.sampled]
        return to_space(colours, self.painted.encoding, self.settings.space)

    def report(self, flow: BeltramiFlow[GridManifold], result: FlowResult) -> VertexReport:
        samples = len(flow.manifold.atlas.owned_texels)
        counts: dict[str, float] = {"triangles": len(self.painted.faces)}
        return self._report(flow, result, {**counts, "samples": samples, "hard_edge_samples": 0})

    def describe(self) -> dict[str, object]:
        flow, grid = self.flow(), self.grid
        measured = len(flow.manifold.atlas.owned_texels)
        return {
            "colours": describe_colours(self.painted),
            "surface": {
                "range_image": [grid.shape[1], grid.shape[0]],
                "vertices": len(self.painted.positions),
                "samples": measured,
                "holes": grid.size - measured,
                "mean_edge_length": flow.manifold.spacing,
            },
            **self._planned(flow),
        }

    def probe(self, document: Document, *, whole: bool) -> Probe:
        from beltrami_cli.samples.probes.cells import RangeProbe
        from beltrami_cli.samples.probes.probe import WorkingColours

        colours = WorkingColours(self.names, self.settings.space)
        return RangeProbe(self.flow(), colours, self.painted, self.grid, document.name)

    def repaint(self, new: NewColours) -> Repainted:
        written = self.channels.written
        after = new.table()[:, written]
        moved = np.any(self._working(new.places)[:, written] != after, axis=1)
        return self._repainted(self.grid.reshape(-1)[new.places[moved]], after[moved])
