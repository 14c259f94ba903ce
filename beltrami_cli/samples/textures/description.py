"""What the textures of a model are like, each and together, and the surface that they are painted on."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.beltrami_flow import BeltramiFlow
from beltrami_cli.flow.canvas import painted
from beltrami_cli.flow.grid_manifold import GridManifold
from beltrami_cli.samples.textures.choosing import only_textures
from beltrami_cli.samples.textures.prepare import build_slot_atlas
from beltrami_cli.surface.atlas import without_owned
from beltrami_cli.surface.geometry import count_topology
from beltrami_cli.surface.grouping import group_equal_rows

if TYPE_CHECKING:
    from beltrami_cli.samples.settings import SmoothSettings
    from beltrami_cli.samples.textures.prepare import PreparedSlot
    from beltrami_cli.surface.atlas import Atlas
    from beltrami_cli.surface.records import TexturedSurface


def describe_slot(
    prepared: PreparedSlot, flow: BeltramiFlow[GridManifold], settings: SmoothSettings
) -> dict[str, object]:
    """Return facts about the textures of a slot, together and each by itself.

    Parameters
    ----------
    prepared : PreparedSlot
        The textures.
    flow : BeltramiFlow
        On them all.
    settings : SmoothSettings
        As for `prepare_slot`.

    Returns
    -------
    dict
        JSON types. "images" has an entry for each texture: what `describe_textures` says; its charts, the seams between
        them, and its texels at several places ("overlapped"); the pitch of its texels on the surface, and its noise.
        The rest is of all textures together, where there are also seams from one to another.
    """
    described = describe_textures(prepared)
    flows = [flow] if len(described) == 1 else [_alone(prepared, i, settings) for i in range(len(described))]
    atlases = [prepared.atlas] if len(described) == 1 else [own.manifold.atlas for own in flows]
    for facts, atlas, own in zip(described, atlases, flows, strict=True):
        facts |= {"charts": atlas.charts, "seams": atlas.seams, "overlapped": atlas.overlapped}
        facts |= {"pitch": own.manifold.spacing, "noise": prepared.colours.named(own.manifold.sigma)}
    between = prepared.atlas.seams - sum(atlas.seams for atlas in atlases)
    return {
        "images": described,
        **atlas_counts(prepared.atlas),
        "seams_between_textures": max(0, between),
        "colour_jumps": flow.manifold.jumps,
        "pitch": flow.manifold.spacing,
        "noise": prepared.colours.named(flow.manifold.sigma),
    }


def _alone(prepared: PreparedSlot, index: int, settings: SmoothSettings) -> BeltramiFlow[GridManifold]:
    """Return a flow, with no parameters chosen, on one of several textures."""
    surface, picture = only_textures(prepared.surface, [index]), prepared.pictures[index]
    atlas = build_slot_atlas(surface, [picture], settings.kernel)
    hidden = prepared.colours.hidden(index, surface.textures[0], atlas.owned_texels)
    if hidden.any():
        atlas = without_owned(atlas, hidden)
    colours = prepared.colours.working(picture, atlas.owned_texels)
    planes = painted(atlas, colours, settings.kernel.thread_count)
    kernel = dataclasses.replace(settings.kernel, free=())
    return BeltramiFlow(GridManifold(atlas, planes, kernel), kernel)


def describe_surface(surface: TexturedSurface) -> dict[str, object]:
    """Return counts of the triangles under textures, and their bounds, in JSON types."""
    columns = [*surface.positions.T, *([] if surface.space_of is None else [surface.space_of])]
    place_of, first = group_equal_rows(*columns)
    positions = surface.positions[first]
    return {
        "vertices": len(surface.positions),
        "triangles": len(surface.faces),
        "coincident_vertices": len(surface.positions) - len(first),
        **dataclasses.asdict(count_topology(positions, place_of[surface.faces])),
        "bounds": [positions.min(axis=0).tolist(), positions.max(axis=0).tolist()] if len(positions) else [],
    }


def describe_textures(prepared: PreparedSlot) -> list[dict[str, object]]:
    """Return facts about each texture, in JSON types."""
    atlas = prepared.atlas
    covered = [len(atlas.owned_texels)]
    if len(prepared.pictures) > 1:
        covered = np.histogram(atlas.owned_texels, atlas.texture_offsets)[0].tolist()
    return [
        {
            "name": texture.name,
            "width": picture.pixels.shape[1],
            "height": picture.pixels.shape[0],
            "format": picture.format,
            "stored": picture.stored,
            "channels": list(picture.channels),
            "covered": round(float(count / picture.pixels[..., 0].size), 4),
        }
        for texture, picture, count in zip(prepared.surface.textures, prepared.pictures, covered, strict=True)
    ]


def atlas_counts(atlas: Atlas) -> dict[str, int]:
    """Return what an atlas is made of."""
    return {
        "charts": atlas.charts,
        "seams": atlas.seams,
        "covered": atlas.covered,
        "overlapped": atlas.overlapped,
    }
