"""What is coloured in a file and how, and what smoothing it would do."""

from __future__ import annotations

import dataclasses
import os
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access, read_source
from beltrami_cli.formats.image.recognition import is_image
from beltrami_cli.jobs.opening import document_from, refuse_options_of_level_sets
from beltrami_cli.samples.memory_check import require_room_for_textures
from beltrami_cli.samples.selection import choose_work, require_scale
from beltrami_cli.samples.settings import DEFAULTS, SmoothSettings, describe_kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.document import Document
    from beltrami_cli.samples.vertices.prepare import PreparedVertices
    from beltrami_cli.surface.records import PaintedVertices, SampledSurface, Slot
    from beltrami_cli.surface.vertex_sampling import VertexSampling

# Enough for a mean within a few per cent, and a matter of milliseconds.
_PROBED_KERNELS = 1000


def inspect_file(
    source: str | os.PathLike[str], settings: SmoothSettings = DEFAULTS, access: Access = EVERYTHING_INSIDE
) -> dict[str, object]:
    """Describe a mesh file or an image, and what `smooth_file` would do with it.

    Parameters
    ----------
    source : path
        PLY, OBJ, glTF or GLB, an image, or a level set on a grid (.npz, .nrrd); "-" for standard input.
    settings : SmoothSettings
        As for smoothing.
    access : Access
        What may be read.

    Returns
    -------
    dict
        JSON types only: "file" (facts of the format); for vertex colours "colours", "surface" or for points without
        faces "cloud" (counts, spacing, bounds), "noise" (standard deviation per channel, full scale 1) and "smooth"
        (parameters as they would be used, and the mean number of samples that a kernel of the first iteration would
        hold), which is left out if they would stay as they are beside textures; "textures", a list with an entry for
        each slot that would be smoothed, in which "images" describes each texture, and "surface" for the mesh under
        them; "notices". For an image "file", "image", "noise", "smooth" and "notices".

    Raises
    ------
    InputError
        If the source cannot be read or holds no colours.
    UsageError
        If the settings contradict the file.
    """
    name = os.fspath(source)
    data = read_source(name, access)
    if is_image(data, name):
        refuse_options_of_level_sets(settings, name)
        return _describe_image(data, "<stdin>" if name == "-" else name, settings, access)
    return _describe_model(document_from(data, name, settings, access), settings, access)


def _describe_image(data: bytes, name: str, settings: SmoothSettings, access: Access) -> dict[str, object]:
    from beltrami_cli.samples.images.prepare import prepare_image

    prepared = prepare_image(data, name, settings, access)
    flow = prepared.flow(settings)
    facts = prepared.facts()
    return {
        "file": {"name": name, "format": facts.pop("format"), "bytes": len(data)},
        "image": {**facts, "pitch": flow.manifold.spacing},
        "noise": prepared.colours.named(flow.manifold.sigma),
        "smooth": describe_kernel(settings, flow),
        "notices": list(prepared.notices),
    }


def _describe_model(document: Document, settings: SmoothSettings, access: Access) -> dict[str, object]:
    work = choose_work(document, settings)
    require_scale(document, work)
    facts: dict[str, object] = {
        "file": {"name": document.name, "format": document.format, **document.facts()}
    }
    grid = document.grid() if work.vertices else None
    if grid is not None:
        facts.update(_describe_range(document, grid, settings, access))
    elif work.vertices:
        facts.update(_describe_vertices(document, settings, access))
    elif work.slots:
        facts.update(_describe_under_textures(document, work.slots[0], settings, access))
    require_room_for_textures(document, work.slots, settings.textures, access)
    slots = [_describe_slot(document, slot, settings, access) for slot in work.slots]
    if slots:
        facts["textures"] = slots
    others = [slot for slot in document.slots() if slots and slot not in settings.textures.slots]
    hint = (f"it has textures in other slots, too; --slots {','.join(others)} shows them",) if others else ()
    facts["notices"] = [*document.notices, *work.notices, *hint]
    return facts


def _describe_vertices(document: Document, settings: SmoothSettings, access: Access) -> dict[str, object]:
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


def _describe_range(
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


def _describe_under_textures(
    document: Document, slot: Slot, settings: SmoothSettings, access: Access
) -> dict[str, object]:
    """Describe the surface that only textures are smoothed on, and the vertex colours that it has besides."""
    if settings.on == "auto" and document.grid() is None and document.has_vertex_colours():
        # They stay as they are, so no parameters are chosen for them.
        plain = dataclasses.replace(DEFAULTS, kernel=dataclasses.replace(settings.kernel, free=()))
        facts = _describe_vertices(document, plain, access)
        return {key: facts[key] for key in facts if key != "smooth"}
    from beltrami_cli.samples.textures.description import describe_surface

    return {"surface": describe_surface(document.textured(slot))}


def _describe_slot(
    document: Document, slot: Slot, settings: SmoothSettings, access: Access
) -> dict[str, object]:
    from beltrami_cli.samples.textures.description import describe_slot
    from beltrami_cli.samples.textures.prepare import prepare_slot

    prepared = prepare_slot(document.textured(slot), slot, settings, document, access)
    flow = prepared.flow(settings)
    return {
        "slot": slot,
        **describe_slot(prepared, flow, settings),
        "smooth": describe_kernel(settings, flow),
    }
