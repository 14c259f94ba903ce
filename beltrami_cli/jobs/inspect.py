"""What is coloured in a file and how, and what smoothing it would do."""

from __future__ import annotations

import dataclasses
import os
from typing import TYPE_CHECKING, cast

import numpy as np

from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access
from beltrami_cli.formats.image.document import ImageDocument
from beltrami_cli.jobs.documents import open_input
from beltrami_cli.samples.memory_check import require_room_for_textures
from beltrami_cli.samples.selection import require_scale, samples_of, select, vertex_samples
from beltrami_cli.samples.settings import DEFAULTS, SmoothSettings, describe_kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.flow.beltrami_flow import BeltramiFlow
    from beltrami_cli.flow.grid_manifold import GridManifold
    from beltrami_cli.formats.document import Document
    from beltrami_cli.samples.pixel_samples import PixelSamples
    from beltrami_cli.samples.range_samples import RangeSamples
    from beltrami_cli.samples.texel_samples import TexelSamples
    from beltrami_cli.samples.vertex_samples import PaintedSamples, VertexSamples
    from beltrami_cli.surface.records import PaintedVertices, SampledSurface, Slot, TexturedSurface
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
    document = open_input(os.fspath(source), settings, access)
    selection = select(document, settings)
    if isinstance(document, ImageDocument):
        (samples,) = samples_of(document, selection, settings, access)
        return _describe_image(document, cast("PixelSamples", samples))
    require_scale(document, selection)
    facts: dict[str, object] = {
        "file": {"name": document.name, "format": document.format, **document.facts()}
    }
    if selection.vertices:
        facts.update(_describe_painted(vertex_samples(document, settings, access)))
    elif selection.slots:
        facts.update(_describe_under_textures(document, selection.slots[0], settings, access))
    require_room_for_textures(document, selection.slots, settings.textures, access)
    textured = dataclasses.replace(selection, vertices=False)
    slots = [
        _describe_slot(cast("TexelSamples", samples))
        for samples in samples_of(document, textured, settings, access)
    ]
    if slots:
        facts["textures"] = slots
    others = [slot for slot in document.slots() if slots and slot not in settings.textures.slots]
    hint = (f"it has textures in other slots, too; --slots {','.join(others)} shows them",) if others else ()
    facts["notices"] = [*document.notices, *selection.notices, *hint]
    return facts


def _describe_image(document: ImageDocument, samples: PixelSamples) -> dict[str, object]:
    flow, facts = samples.flow(), samples.facts()
    return {
        "file": {"name": document.name, "format": facts.pop("format"), "bytes": len(document.data)},
        "image": {**facts, "pitch": flow.manifold.spacing},
        "noise": samples.named(flow.manifold.sigma),
        "smooth": describe_kernel(samples.settings, flow),
        "notices": samples.notices(),
    }


def _describe_painted(samples: PaintedSamples) -> dict[str, object]:
    from beltrami_cli.samples.range_samples import RangeSamples

    if isinstance(samples, RangeSamples):
        return _describe_range(samples)
    return _describe_vertices(cast("VertexSamples", samples))


def _describe_vertices(samples: VertexSamples) -> dict[str, object]:
    """Describe the vertex colours of a mesh or of points, and what smoothing would do to them."""
    painted = samples.joined
    facts = _describe_cloud(samples) if samples.is_cloud else _describe_mesh(samples)
    flow = samples.flow()
    manifold = flow.manifold
    moving = {}
    if manifold.moving is not None:
        moving = {"normal_noise": manifold.moving.sigma, "normal_beta": manifold.moving.beta}
    held = round(manifold.samples_per_kernel(_PROBED_KERNELS, flow.step(0)), 1)
    return {
        "colours": _describe_colours(painted),
        "cloud" if samples.is_cloud else "surface": {
            **facts,
            "mean_edge_length": manifold.spacing,
            "bounds": _bounds(painted.positions),
        },
        "noise": samples.named(manifold.sigma),
        "smooth": describe_kernel(samples.settings, flow) | moving | {"samples_per_kernel": held},
    }


def _describe_mesh(samples: VertexSamples) -> dict[str, object]:
    from beltrami_cli.surface.geometry import count_topology

    painted, surface, sampling = samples.painted, samples.surface, samples.sampling
    topology = count_topology(_place_positions(surface, sampling), sampling.place_of[surface.faces])
    return {
        "vertices": len(painted.positions),
        "triangles": len(painted.faces),
        "samples": len(surface.colours),
        "coincident_vertices": len(painted.positions) - sampling.places,
        "hard_edge_samples": len(surface.colours) - sampling.places,
        **dataclasses.asdict(topology),
    }


def _describe_cloud(samples: VertexSamples) -> dict[str, object]:
    from beltrami_cli.samples.vertex_samples import count_cloud

    return {
        "points": len(samples.painted.positions),
        "samples": len(samples.surface.colours),
        "coincident_points": len(samples.painted.positions) - samples.sampling.places,
        **dataclasses.asdict(count_cloud(samples.joined)),
    }


def _describe_range(samples: RangeSamples) -> dict[str, object]:
    """Describe a range image, and what smoothing would do to it."""
    flow, grid = samples.flow(), samples.grid
    measured = len(flow.manifold.atlas.owned_texels)
    return {
        "colours": _describe_colours(samples.painted),
        "surface": {
            "range_image": [grid.shape[1], grid.shape[0]],
            "vertices": len(samples.painted.positions),
            "samples": measured,
            "holes": grid.size - measured,
            "mean_edge_length": flow.manifold.spacing,
        },
        "noise": samples.named(flow.manifold.sigma),
        "smooth": describe_kernel(samples.settings, flow),
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


def _bounds(positions: NDArray[np.float64]) -> list[list[float]]:
    return [positions.min(axis=0).tolist(), positions.max(axis=0).tolist()] if len(positions) else []


def _describe_under_textures(
    document: Document, slot: Slot, settings: SmoothSettings, access: Access
) -> dict[str, object]:
    """Describe the surface that only textures are smoothed on, and the vertex colours that it has besides."""
    if settings.on == "auto" and document.grid() is None and document.has_vertex_colours():
        # They stay as they are, so no parameters are chosen for them.
        plain = dataclasses.replace(DEFAULTS, kernel=dataclasses.replace(settings.kernel, free=()))
        facts = _describe_painted(vertex_samples(document, plain, access))
        return {key: facts[key] for key in facts if key != "smooth"}
    return {"surface": _describe_surface(document.textured(slot))}


def _describe_surface(surface: TexturedSurface) -> dict[str, object]:
    """Count the triangles under textures."""
    from beltrami_cli.surface.geometry import count_topology
    from beltrami_cli.surface.grouping import group_equal_rows

    columns = [*surface.positions.T, *([] if surface.space_of is None else [surface.space_of])]
    place_of, first = group_equal_rows(*columns)
    positions = surface.positions[first]
    return {
        "vertices": len(surface.positions),
        "triangles": len(surface.faces),
        "coincident_vertices": len(surface.positions) - len(first),
        **dataclasses.asdict(count_topology(positions, place_of[surface.faces])),
        "bounds": _bounds(positions),
    }


def _describe_slot(samples: TexelSamples) -> dict[str, object]:
    """Describe the textures of a slot, together and each by itself, and what smoothing would do to them."""
    from beltrami_cli.samples.texel_samples import atlas_counts

    flow, described = samples.flow(), samples.facts()
    count = len(described)
    flows = [flow] if count == 1 else [_alone(samples, index) for index in range(count)]
    atlases = [samples.atlas] if count == 1 else [own.manifold.atlas for own in flows]
    for facts, atlas, own in zip(described, atlases, flows, strict=True):
        facts |= {"charts": atlas.charts, "seams": atlas.seams, "overlapped": atlas.overlapped}
        facts |= {"pitch": own.manifold.spacing, "noise": samples.named(own.manifold.sigma)}
    between = samples.atlas.seams - sum(atlas.seams for atlas in atlases)
    return {
        "slot": samples.slot,
        "images": described,
        **atlas_counts(samples.atlas),
        "seams_between_textures": max(0, between),
        "colour_jumps": flow.manifold.jumps,
        "pitch": flow.manifold.spacing,
        "noise": samples.named(flow.manifold.sigma),
        "smooth": describe_kernel(samples.settings, flow),
    }


def _alone(samples: TexelSamples, index: int) -> BeltramiFlow[GridManifold]:
    """Return a flow, with no parameters chosen, on one of several textures."""
    from beltrami_cli.flow.beltrami_flow import BeltramiFlow
    from beltrami_cli.flow.canvas import painted
    from beltrami_cli.flow.grid_manifold import GridManifold
    from beltrami_cli.samples.texel_colours import only_textures
    from beltrami_cli.samples.texel_samples import atlas_of
    from beltrami_cli.surface.atlas import without_owned

    kernel, picture = dataclasses.replace(samples.settings.kernel, free=()), samples.pictures[index]
    surface = only_textures(samples.surface, [index])
    atlas = atlas_of(surface, [picture], kernel)
    hidden = samples.colours.hidden(index, surface.textures[0], atlas.owned_texels)
    if hidden.any():
        atlas = without_owned(atlas, hidden)
    colours = samples.colours.working(picture, atlas.owned_texels)
    planes = painted(atlas, colours, kernel.thread_count)
    return BeltramiFlow(GridManifold(atlas, planes, kernel), kernel)
