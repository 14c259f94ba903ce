"""What the vertices of a file have for colours, and on which surface."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.samples.settings.description import describe_kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.access import Access
    from beltrami_cli.formats.document import Document
    from beltrami_cli.samples.settings.smooth import SmoothSettings
    from beltrami_cli.samples.vertices.prepare import PreparedVertices
    from beltrami_cli.surface.records import PaintedVertices, SampledSurface
    from beltrami_cli.surface.vertex_sampling import VertexSampling

# Enough for a mean within a few per cent, and a matter of milliseconds.
_PROBED_KERNELS = 1000


def describe_vertices(document: Document, settings: SmoothSettings, access: Access) -> dict[str, object]:
    """Describe the vertex colours of a mesh or of points, and what smoothing would do to them."""
    from beltrami_cli.samples.vertices.guides import vertex_guides
    from beltrami_cli.samples.vertices.point_cloud import with_surface
    from beltrami_cli.samples.vertices.prepare import prepare

    painted = with_surface(document.painted(), settings)
    prepared = prepare(painted, settings, vertex_guides(document, settings, access))
    flow = prepared.flow(settings)
    is_mesh = len(document.painted().faces) > 0
    return {
        "colours": _describe_colours(painted),
        "surface" if is_mesh else "cloud": {
            **(_describe_mesh(painted, prepared) if is_mesh else _describe_cloud(painted, prepared)),
            "mean_edge_length": flow.manifold.spacing,
            "bounds": _bounds(painted),
        },
        "noise": {
            painted.channels[i]: float(s)
            for i, s in zip(prepared.channels.taking_part, flow.manifold.sigma, strict=True)
        },
        "smooth": describe_kernel(settings, flow)
        | (
            {}
            if flow.manifold.moving is None
            else {"normal_noise": flow.manifold.moving.sigma, "normal_beta": flow.manifold.moving.beta}
        )
        | {"samples_per_kernel": round(flow.manifold.samples_per_kernel(_PROBED_KERNELS, flow.step(0)), 1)},
    }


def _describe_mesh(painted: PaintedVertices, prepared: PreparedVertices) -> dict[str, object]:
    from beltrami_cli.surface.geometry import count_topology

    surface, sampling = prepared.surface, prepared.sampling
    topology = count_topology(_place_positions(surface, sampling), sampling.place_of[surface.faces])
    return {
        "vertices": len(painted.positions),
        "triangles": len(painted.faces),
        "samples": len(surface.colours),
        "coincident_vertices": len(painted.positions) - sampling.places,
        "hard_edge_samples": len(surface.colours) - sampling.places,
        **dataclasses.asdict(topology),
    }


def _describe_cloud(painted: PaintedVertices, prepared: PreparedVertices) -> dict[str, object]:
    from beltrami_cli.samples.vertices.point_cloud import count_cloud

    return {
        "points": len(painted.positions),
        "samples": len(prepared.surface.colours),
        "coincident_points": len(painted.positions) - prepared.sampling.places,
        **dataclasses.asdict(count_cloud(painted)),
    }


def describe_range(
    document: Document, grid: NDArray[np.int64], settings: SmoothSettings, access: Access
) -> dict[str, object]:
    """Describe a range image, and what smoothing would do to it."""
    from beltrami_cli.samples.images.range_image import prepare_range
    from beltrami_cli.samples.vertices.guides import vertex_guides

    prepared = prepare_range(document.painted(), grid, settings, vertex_guides(document, settings, access))
    flow = prepared.flow(settings)
    samples = len(flow.manifold.atlas.owned_texels)
    return {
        "colours": _describe_colours(prepared.painted),
        "surface": {
            "range_image": [grid.shape[1], grid.shape[0]],
            "vertices": len(prepared.painted.positions),
            "samples": samples,
            "holes": grid.size - samples,
            "mean_edge_length": flow.manifold.spacing,
        },
        "noise": prepared.named(flow.manifold.sigma),
        "smooth": describe_kernel(settings, flow),
    }


def _place_positions(surface: SampledSurface, sampling: VertexSampling) -> NDArray[np.float64]:
    """Return the position of each place: a hard colour edge is no boundary of the surface."""
    positions = np.empty((sampling.places, surface.positions.shape[1]))
    positions[sampling.place_of] = surface.positions
    return positions


def _describe_colours(painted: PaintedVertices) -> dict[str, object]:
    colours = painted.colours
    return {
        "channels": list(painted.channels),
        "stored": painted.stored,
        "encoding": painted.encoding,
        "least": [float(value) for value in colours.min(axis=0)] if len(colours) else [],
        "greatest": [float(value) for value in colours.max(axis=0)] if len(colours) else [],
    }


def _bounds(painted: PaintedVertices) -> list[list[float]]:
    if not len(painted.positions):
        return []
    return [painted.positions.min(axis=0).tolist(), painted.positions.max(axis=0).tolist()]
