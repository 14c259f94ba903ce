"""Colours of vertices as samples: on a mesh, on a surface fitted to points, or on the grid of a range image."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Array, Float32s, Float64s, Indices, Int32s, Int64s
from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.flow.beltrami_flow import FlowResult
from beltrami_cli.flow.chunks import IN_ONE_PIECE, Resources
from beltrami_cli.flow.decoding import plan_on_canvas
from beltrami_cli.flow.estimation import estimate_on_mesh
from beltrami_cli.flow.manifolds.grid_manifold import GridManifold
from beltrami_cli.flow.manifolds.guides import Guide
from beltrami_cli.flow.manifolds.mesh_manifold import (
    ColouredMesh,
    MeshManifold,
    mesh_manifold,
    samples_per_kernel,
)
from beltrami_cli.flow.manifolds.moving_positions import GeometryParameters
from beltrami_cli.flow.manifolds.new_colours import NewColours
from beltrami_cli.flow.plan import Plan, choose_parameters
from beltrami_cli.formats.colours import as_in_file
from beltrami_cli.layers.image_surface import ImageSurface, canvas_of_image
from beltrami_cli.layers.layer import (
    Change,
    ChosenChannels,
    Layer,
    LevelReport,
    Part,
    SampledVertices,
    StoredColours,
    VertexReport,
    choose_channels,
)
from beltrami_cli.layers.levelled_charts import level_photographs
from beltrami_cli.layers.settings import LevelSettings, SmoothSettings
from beltrami_cli.layers.units import unit_of_vertices
from beltrami_cli.surface.colour_values import from_space, to_space, unit_in_space
from beltrami_cli.surface.geometry import bounds, count_topology
from beltrami_cli.surface.large_arrays import blocks, copy_of, kept
from beltrami_cli.surface.points import faces_of_points
from beltrami_cli.surface.records import ColouredVertices, SampledSurface
from beltrami_cli.surface.sampling import VertexSampling, sample_vertices

# Number of kernels for an estimate of the mean number of samples, accurate to a few per cent within milliseconds.
_PROBED_KERNELS = 1000


def describe_colours(vertices: ColouredVertices) -> dict[str, object]:
    """Return facts about colours of vertices, in JSON types."""
    colours = vertices.colours
    return {
        "channels": list(vertices.channels),
        "stored": vertices.stored,
        "encoding": vertices.encoding,
        "full_scale": vertices.full_scale,
        "least": [float(value) for value in colours.min(axis=0)] if len(colours) else [],
        "greatest": [float(value) for value in colours.max(axis=0)] if len(colours) else [],
    }


@dataclass(frozen=True, kw_only=True, eq=False)
class VertexLayer(Layer):
    """Common base of vertices on a mesh and on a grid."""

    part: ClassVar[Part] = "vertices"

    vertices: ColouredVertices
    settings: SmoothSettings
    guides: Sequence[Guide] = ()
    noise: Float32s | None = None  # standard deviations, one row per vertex
    in_triangles: bool = False  # whether isolated vertices have no colour
    stored_unit: float = 1.0  # stored number that becomes 1 in the working space
    channels: ChosenChannels = field(init=False)
    names: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        channels = choose_channels(self.vertices.channels, self.settings, "the colours have")
        object.__setattr__(self, "channels", channels)
        object.__setattr__(self, "names", tuple(self.vertices.channels[each] for each in channels.sampled))

    def normalised(self) -> Self:
        return self._in_unit_of(self.vertices)

    def _in_unit_of(self, vertices: ColouredVertices) -> Self:
        found = unit_of_vertices(vertices, self.channels.sampled, are_data=self.settings.space == "data")
        return self if found == self.stored_unit else dataclasses.replace(self, stored_unit=found)

    def unit_in(self, space: str) -> float:
        return unit_in_space(self.stored_unit, self.vertices.encoding, space)

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

    def _stored_colours(
        self,
        vertices: NDArray[np.integer[Any]],
        rows: NDArray[np.integer[Any]],
        after: Float32s,
        positions: Float64s | None = None,
    ) -> StoredColours:
        """Give vertices the colours in rows; conversion there and back is not exact, but its result stays in range."""
        before, changing = self.vertices, self.channels.changing
        colours = copy_of(before.colours)
        if len(vertices):
            low, high = (limit(axis=0)[changing] for limit in (before.colours.min, before.colours.max))
        for block in blocks(len(vertices)):
            back = from_space(after[rows[block]], before.encoding, self.settings.space, self.stored_unit)
            colours[vertices[block, None], changing] = np.clip(back, low, high)
        return StoredColours(change_of(before, colours), colours, positions)


def change_of(vertices: ColouredVertices, colours: Float32s) -> Change:
    """Return how new colours of vertices change them in the file."""
    return Change.joined(
        Change.between(as_in_file(vertices, vertices.colours[block]), as_in_file(vertices, colours[block]))
        for block in blocks(len(colours))
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class MeshLayer(VertexLayer):
    """Vertices of a mesh; points without triangles are sampled on a surface fitted to them."""

    label = "vertex colours"

    fits_surface: bool = True  # to vertices without triangles
    # Returns the number of each vertex's photograph from the attribute that stores it.
    photographs_of: Callable[[str | None], Int64s] | None = None
    levelled_colours: Float32s | None = None  # (S, N): colours of samples without exposure steps
    level_report: LevelReport | None = None

    @property
    def _is_cloud(self) -> bool:
        return self.fits_surface and not len(self.vertices.faces)

    @property
    def _is_light(self) -> bool:
        colours = self.vertices.colours
        return self.vertices.encoding == "linear" and bool(colours.max(initial=0) > 1)

    @cached_property
    def joined(self) -> ColouredVertices:
        """The vertices with triangles, from the file or of the surface fitted to points."""
        return with_surface(self.vertices, self.settings) if self._is_cloud else self.vertices

    @cached_property
    def sampling(self) -> VertexSampling:
        # Points that only rounding distinguishes are not merged: triangles between points have no open borders.
        return sample_vertices(dataclasses.replace(self.joined, faces=self.vertices.faces))

    @cached_property
    def _stored(self) -> Float32s:
        """Stored colours of the samples in the working space, shape (S, N)."""
        colours = to_space(
            self.joined.colours[:, self.channels.sampled], self.joined.encoding, self.settings.space,
            self.stored_unit,
        )  # fmt: skip
        return kept(np.ascontiguousarray(colours[self.sampling.first_vertex]))

    def normalised(self) -> Self:
        if self.levelled_colours is not None:
            return self
        made = self._in_unit_of(self.joined)
        vars(made)["joined"] = self.joined  # expensive to compute
        return made

    def surface(self) -> SampledSurface:
        """Return the sampled surface, made on demand, since it is as large as the file."""
        surface = self.sampling.surface(self.joined, self._stored)
        levelled = self.levelled_colours
        return surface if levelled is None else dataclasses.replace(surface, colours=levelled)

    def plan(
        self, tick: Callable[[], None] | None = None, resources: Resources = IN_ONE_PIECE
    ) -> Plan[MeshManifold]:
        own, sampling, geometry = self.settings, self.sampling, None
        if own.embedding.smooth_geometry:
            geometry = GeometryParameters(sampling.place_of, own.embedding.normal_beta)
        mesh = ColouredMesh.of(
            self.surface(), self.kernel, metric_channels=self.channels.metric, geometry=geometry,
            guides=[Guide(guide.name, sampling.means(guide.values), guide.beta) for guide in self.guides],
            deviations=None if self.deviations is None else sampling.means(self.deviations), is_light=self._is_light,
            resources=resources,
        )  # fmt: skip
        return choose_parameters(mesh_manifold(mesh, estimate_on_mesh(mesh)), mesh.parameters, tick)

    def report(self, plan: Plan[MeshManifold], result: FlowResult[MeshManifold]) -> VertexReport:
        counts: dict[str, float] = {"triangles": len(self.vertices.faces)}
        if self._is_cloud:
            counts = dataclasses.asdict(count_cloud(self.joined))
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
        vertices, counts, plan = self.joined, self._counts(), self.plan()
        manifold, planned = plan.manifold, self._described_plan(plan)
        if (moved := manifold.moving) is not None:
            planned["smooth"] |= {"normal_noise": float(moved.sigma), "normal_beta": float(moved.beta)}
        in_kernel = samples_per_kernel(manifold, _PROBED_KERNELS, plan.step(0))
        planned["smooth"]["samples_per_kernel"] = round(in_kernel, 1)
        where = {"mean_edge_length": manifold.geometry.spacing, "bounds": bounds(vertices.positions)}
        what = "cloud" if self._is_cloud else "surface"
        return {"colours": describe_colours(vertices), what: counts | where, **planned}

    def _counts(self) -> dict[str, object]:
        vertices, samples = len(self.vertices.colours), len(self.sampling.first_vertex)
        places, place_of = self.sampling.places, self.sampling.place_of
        if self._is_cloud:
            counts = {"points": vertices, "samples": samples, "coincident_points": vertices - places}
            return {**counts, **dataclasses.asdict(count_cloud(self.joined))}
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
        return SampledVertices(self.joined, self.sampling.sample_of.astype(np.int64))

    def levelled(self, wanted: LevelSettings) -> MeshLayer:
        if self.photographs_of is None:
            raise UsageError(f"{self.label}: nothing says which photograph each vertex is from")
        photographs, surface = self.photographs_of(wanted.photographs), self.surface()
        photograph_of = np.zeros(len(surface.colours), np.int64)
        photograph_of[self.sampling.sample_of] = photographs
        colours, report = level_photographs(self.label, surface, photograph_of, wanted)
        return dataclasses.replace(self, levelled_colours=colours, level_report=report)

    def encode(self, new: NewColours, *, is_smoothed: bool = True) -> StoredColours:
        del is_smoothed
        written, sample_of = self.channels.written, self.sampling.sample_of
        after = new.table()[:, written]
        changed = np.any(after != self._stored[:, written], axis=1)[sample_of]
        vertices = np.flatnonzero(changed)
        positions = None if new.positions is None else new.positions[sample_of]
        return self._stored_colours(vertices, sample_of[vertices], after, positions)


@dataclass(frozen=True, kw_only=True, eq=False)
class GridLayer(VertexLayer):
    """Colours on a grid: vertices of a range image, or pixels of an image that is not in a file."""

    label = "range image"

    grid: Indices  # shape (H, W): numbers of the vertices, -1 at holes
    surface: ImageSurface | None = None  # with the same holes; None: at the positions of the vertices

    def plan(
        self, tick: Callable[[], None] | None = None, resources: Resources = IN_ONE_PIECE
    ) -> Plan[GridManifold]:
        space, surface = self.settings.space, self.surface
        if surface is None:
            measured = self.grid >= 0
            positions = np.full((*self.grid.shape, 3), np.nan)
            positions[measured] = self.vertices.positions[self.grid[measured]]
            surface = ImageSurface(positions=positions, valid=measured)
        canvas = canvas_of_image(
            surface, self._working, self.kernel, metric_channels=self.channels.metric,
            light=space if self.vertices.encoding == "linear" and space != "data" else None,
            guides=[dataclasses.replace(each, values=self._by_pixel(each.values)) for each in self.guides],
            deviations=None if self.deviations is None else self._by_pixel(self.deviations),
        )  # fmt: skip
        return plan_on_canvas(dataclasses.replace(canvas, resources=resources), tick=tick)

    def _by_pixel(self, values: Array) -> Array:
        """Return rows of vertices as rows of pixels; zeros at holes."""
        rows = self.grid.reshape(-1)
        table = np.zeros((len(rows), *values.shape[1:]), values.dtype)
        table[rows >= 0] = values[rows[rows >= 0]]
        return table

    def _working(self, places: Int64s) -> Float32s:
        """Return the colours at some places of the grid in the working space, shape (T, N)."""
        colours = self.vertices.colours[self.grid.reshape(-1)[places]][:, self.channels.sampled]
        return to_space(colours, self.vertices.encoding, self.settings.space, self.stored_unit)

    def report(self, plan: Plan[GridManifold], result: FlowResult[GridManifold]) -> VertexReport:
        samples = len(plan.manifold.geometry.atlas.owned_texels)
        counts: dict[str, float] = {"triangles": len(self.vertices.faces)}
        return self._report(plan, result, {**counts, "samples": samples, "hard_edge_samples": 0})

    def describe(self) -> dict[str, object]:
        plan, grid = self.plan(), self.grid
        measured = len(plan.manifold.geometry.atlas.owned_texels)
        return {
            "colours": describe_colours(self.vertices),
            "surface": {
                "range_image": [grid.shape[1], grid.shape[0]],
                "vertices": len(self.vertices.positions),
                "samples": measured,
                "holes": grid.size - measured,
                "mean_edge_length": plan.manifold.geometry.spacing,
            },
            **self._described_plan(plan),
        }

    def places(self) -> SampledVertices:
        measured = self.grid[self.grid >= 0]
        sample_of = np.full(len(self.vertices.positions), -1)
        sample_of[measured] = np.arange(len(measured))
        return SampledVertices(self.vertices, sample_of)

    def encode(self, new: NewColours, *, is_smoothed: bool = True) -> StoredColours:
        del is_smoothed
        written = self.channels.written
        after = new.table()[:, written]
        moved = np.flatnonzero(np.any(self._working(new.places)[:, written] != after, axis=1))
        return self._stored_colours(self.grid.reshape(-1)[new.places[moved]], moved, after)


def require_surface(vertices: ColouredVertices, name: str) -> None:
    """Raise InputError if the vertices of a file have no triangles."""
    if not len(vertices.faces):
        raise InputError(
            name,
            f"its {len(vertices.positions)} coloured vertices have no faces, so there is no surface to smooth on",
            "triangulate the points first",
        )


@dataclass(frozen=True)
class CloudCounts:
    """Numbers of triangles between points, each in a tangent plane, and of points without any, left unchanged."""

    triangles: int
    outliers: int


def with_surface(vertices: ColouredVertices, settings: SmoothSettings) -> ColouredVertices:
    """Return coloured vertices with their triangles, or with triangles of a surface fitted to the points."""
    # Points too far from all others, or on one line with them, are in no triangle. The same holds for points without a
    # finite position, which are put at the centre of the others.
    if len(vertices.faces):
        return vertices
    if settings.embedding.smooth_geometry:
        raise UsageError("smooth_geometry needs faces, but there are only points")
    measured = np.asarray(np.isfinite(vertices.positions).all(axis=1))
    if measured.all():
        return dataclasses.replace(
            vertices, faces=kept(faces_of_points(vertices, settings.kernel.thread_count))
        )
    rows = np.flatnonzero(measured).astype(np.int32)
    there = only_rows(vertices, rows)
    middle = there.positions.mean(axis=0) if len(rows) else np.zeros(vertices.positions.shape[1])
    return dataclasses.replace(
        vertices,
        positions=np.where(measured[:, None], vertices.positions, middle),
        faces=rows[faces_of_points(there, settings.kernel.thread_count)],
    )


def count_cloud(surface: ColouredVertices) -> CloudCounts:
    """Count the triangles and isolated points of `with_surface`."""
    joined = np.zeros(len(surface.positions), bool)
    joined[surface.faces] = True
    return CloudCounts(len(surface.faces), int(np.count_nonzero(~joined)))


def coloured_rows(vertices: ColouredVertices, *, in_triangles: bool = False) -> NDArray[np.intp]:
    """Return the vertices with a finite position, or only those in triangles."""
    valid = np.asarray(np.isfinite(vertices.positions).all(axis=1))
    if in_triangles:
        found = np.zeros(len(valid), bool)
        found[vertices.faces] = True
        valid &= found
    return np.flatnonzero(valid)


def restricted_to(vertices: ColouredVertices, rows: NDArray[np.intp]) -> ColouredVertices:
    """Select vertices, in ascending order, and the triangles with all corners among them."""
    if len(rows) == len(vertices.positions):
        return vertices
    number = np.full(len(vertices.positions), -1, np.int32)
    number[rows] = np.arange(len(rows))
    faces = number[vertices.faces]
    return only_rows(vertices, rows, faces[(faces >= 0).all(axis=1)])


def only_rows(
    vertices: ColouredVertices, rows: NDArray[np.integer[Any]], faces: Int32s | None = None
) -> ColouredVertices:
    """Select vertices and triangles between them, or none."""
    return dataclasses.replace(
        vertices,
        positions=vertices.positions[rows],
        faces=np.empty((0, 3), np.int32) if faces is None else faces,
        colours=vertices.colours[rows],
        space_of=None if vertices.space_of is None else vertices.space_of[rows],
    )
