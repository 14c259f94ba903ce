"""Colours of vertices on a mesh, or on a surface fitted to points."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from beltrami_cli.arrays import Float32s, Int64s
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.beltrami_flow import FlowResult
from beltrami_cli.flow.estimation import estimate_on_mesh
from beltrami_cli.flow.manifolds.guides import Guide
from beltrami_cli.flow.manifolds.mesh.manifold import (
    ColouredMesh,
    MeshManifold,
    mean_samples_per_kernel,
    mesh_manifold,
)
from beltrami_cli.flow.manifolds.moving_positions import PositionParameters
from beltrami_cli.flow.plan import Plan, choose_parameters
from beltrami_cli.layers.layer import SampledVertices
from beltrami_cli.layers.levelled_charts import level_photographs
from beltrami_cli.layers.reports import VertexReport
from beltrami_cli.layers.settings import LevelSettings
from beltrami_cli.layers.vertex_layer import VertexLayer
from beltrami_cli.surface.geometry import bounds, count_topology
from beltrami_cli.surface.large_arrays import kept
from beltrami_cli.surface.points import count_cloud, with_surface
from beltrami_cli.surface.records import ColouredVertices, SampledSurface
from beltrami_cli.surface.sampling import VertexSampling, sample_vertices

# Number of kernels for an estimate of the mean number of samples, accurate to a few per cent within milliseconds.
_PROBED_KERNELS = 1000


@dataclass(frozen=True, kw_only=True, eq=False)
class MeshLayer(VertexLayer):
    """Vertices of a mesh; points without triangles are sampled on a surface fitted to them."""

    label = "vertex colours"

    fits_surface: bool = True  # to vertices without triangles
    fitted: ColouredVertices | None = None  # the vertices with that surface, once it is known
    # Returns the number of each vertex's photograph from the attribute that stores it.
    photographs_of: Callable[[str | None], Int64s] | None = None

    @property
    def _is_cloud(self) -> bool:
        return self.fits_surface and not len(self.vertices.faces)

    @property
    def _is_light(self) -> bool:
        colours = self.vertices.colours
        return self.vertices.encoding == "linear" and bool(colours.max(initial=0) > 1)

    @cached_property
    def triangulated(self) -> ColouredVertices:
        """The vertices with triangles, from the file or of the surface fitted to points."""
        if not self._is_cloud:
            return self.vertices
        if self.settings.embedding.smooth_geometry:
            raise UsageError("smooth_geometry needs faces, but there are only points")
        return self.fitted or with_surface(self.vertices, self.settings.kernel.thread_count)

    @cached_property
    def sampling(self) -> VertexSampling:
        # Points that only rounding distinguishes are not merged: triangles between points have no open borders.
        return sample_vertices(dataclasses.replace(self.triangulated, faces=self.vertices.faces))

    @cached_property
    def stored_colours(self) -> Float32s:
        return kept(np.ascontiguousarray(self.working(self.sampling.first_vertex)))

    def _in_own_unit(self) -> Self:
        return dataclasses.replace(
            super()._in_own_unit(), fitted=self.triangulated if self._is_cloud else None
        )

    def surface(self) -> SampledSurface:
        """Return the sampled surface, made on demand, since it is as large as the file."""
        surface = self.sampling.surface(self.triangulated, self.stored_colours)
        levelled = self.levelled_colours
        return surface if levelled is None else dataclasses.replace(surface, colours=levelled)

    def plan(self, tick: Callable[[], None] | None = None) -> Plan[MeshManifold]:
        embedding, sampling, moving = self.settings.embedding, self.sampling, None
        if embedding.smooth_geometry:
            moving = PositionParameters(sampling.place_of, embedding.normal_beta)
        mesh = ColouredMesh.of(
            self.surface(), self.kernel, metric_channels=self.channels.metric, moving=moving,
            guides=[Guide(guide.name, sampling.means(guide.values), guide.beta) for guide in self.guides],
            deviations=None if self.deviations is None else sampling.means(self.deviations), is_light=self._is_light,
            resources=self.resources,
        )  # fmt: skip
        return choose_parameters(mesh_manifold(mesh, estimate_on_mesh(mesh)), tick, can_stay=True)

    def report(self, plan: Plan[MeshManifold], result: FlowResult[MeshManifold]) -> VertexReport:
        counts: dict[str, float] = {"triangles": len(self.vertices.faces)}
        if self._is_cloud:
            counts = dataclasses.asdict(count_cloud(self.triangulated))
        samples = len(self.sampling.first_vertex)
        counts |= {"samples": samples, "hard_edge_samples": samples - self.sampling.places}
        report = self._report(plan, result, counts)
        moving = result.manifold.moving
        if moving is None:
            return report
        positions = result.manifold.geometry.in_order(moving.positions)[self.sampling.sample_of]
        moves = np.linalg.norm(positions - self.vertices.positions, axis=1)
        geometry = {
            "normal_noise": moving.sigma,
            "normal_beta": moving.beta,
            "mean_move": float(moves.mean()),
            "rms_move": float(np.sqrt(np.mean(np.square(moves)))),
            "largest_move": float(moves.max()),
        }
        return dataclasses.replace(report, geometry=geometry)

    def describe(self) -> dict[str, object]:
        vertices, counts, plan = self.triangulated, self._counts(), self.plan()
        manifold, planned = plan.manifold, self._described_plan(plan)
        if (moved := manifold.moving) is not None:
            planned["smooth"] |= {"normal_noise": float(moved.sigma), "normal_beta": float(moved.beta)}
        in_kernel = mean_samples_per_kernel(manifold, _PROBED_KERNELS, plan.step(0))
        planned["smooth"]["samples_per_kernel"] = round(in_kernel, 1)
        where = {"mean_edge_length": manifold.geometry.spacing, "bounds": bounds(vertices.positions)}
        what = "cloud" if self._is_cloud else "surface"
        return {"colours": self._described_colours(), what: counts | where, **planned}

    def _counts(self) -> dict[str, object]:
        vertices, samples = len(self.vertices.colours), len(self.sampling.first_vertex)
        places, place_of = self.sampling.places, self.sampling.place_of
        if self._is_cloud:
            counts = {"points": vertices, "samples": samples, "coincident_points": vertices - places}
            return {**counts, **dataclasses.asdict(count_cloud(self.triangulated))}
        surface = self.surface()
        # Position of each place; a hard colour edge is not a boundary of the surface.
        positions = np.empty((places, surface.positions.shape[1]))
        positions[place_of] = surface.positions
        return {
            "vertices": vertices,
            "triangles": len(self.vertices.faces),
            "samples": samples,
            "coincident_vertices": vertices - places,
            "hard_edge_samples": samples - places,
            **count_topology(positions, place_of[surface.faces]),
        }

    def places(self) -> SampledVertices:
        return SampledVertices(self.triangulated, self.sampling.sample_of)

    def levelled(self, wanted: LevelSettings) -> MeshLayer:
        assert not self.is_normalised, "exposures are as stored"
        if self.photographs_of is None:
            raise UsageError(f"{self.label}: nothing says which photograph each vertex is from")
        photographs, surface = self.photographs_of(wanted.photographs), self.surface()
        photograph_of = np.zeros(len(surface.colours), np.int64)
        photograph_of[self.sampling.sample_of] = photographs
        colours, report = level_photographs(self.label, surface, photograph_of, wanted)
        return dataclasses.replace(self, levelled_colours=colours, level_report=report)
