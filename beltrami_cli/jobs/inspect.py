"""Description of a file: its coloured parts, their noise, and what smoothing would do."""

from __future__ import annotations

import dataclasses
import os
from collections import Counter
from typing import cast

from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access
from beltrami_cli.formats.document import Document
from beltrami_cli.jobs.file_job import open_input
from beltrami_cli.layers.image_layer import ImageLayer
from beltrami_cli.layers.levelled_charts import describe_exposure, photograph_attribute, photographs_of
from beltrami_cli.layers.memory_check import checked_memory, memory_beside, too_many_together
from beltrami_cli.layers.selection import layers_of, require_scale, select, vertex_layer
from beltrami_cli.layers.settings import DEFAULTS, SmoothSettings
from beltrami_cli.layers.texel_colours import choose_textures, only_textures
from beltrami_cli.layers.texture_layer import TextureLayer
from beltrami_cli.layers.tile_groups import TileGroups
from beltrami_cli.surface.geometry import bounds, count_topology
from beltrami_cli.surface.grouping import group_places
from beltrami_cli.surface.records import Slot


def inspect_file(
    source: str | os.PathLike[str], settings: SmoothSettings = DEFAULTS, access: Access = EVERYTHING_INSIDE
) -> dict[str, object]:
    """Describe a mesh file or an image, and what `smooth_file` would do with it.

    Parameters
    ----------
    source : path
        Any file that `smooth_file` reads; "-" for standard input.
    settings : SmoothSettings
        As for `smooth_file`.
    access : Access
        What may be read.

    Returns
    -------
    dict
        JSON types only: "file" (facts of the format); for vertex colours "colours", "surface" or for points without
        faces "cloud" (counts, spacing, bounds), "noise" (standard deviation per channel, full scale 1) and "smooth"
        (parameters as they would be used, and the mean number of samples in a kernel of the first iteration), which is
        omitted if textures are smoothed and vertex colours stay unchanged; "textures", a list with an entry for
        all textures of a slot that are smoothed together, in which "images" describes each, and "surface" for the mesh
        under them; "notices". For an image "file", "image", "noise", "smooth" and "notices".

    Raises
    ------
    InputError
        If the source cannot be read, is damaged, or has no colours.
    UsageError
        If the parameters contradict the file.
    """
    document = open_input(os.fspath(source), settings, access)
    selection = select(document, settings)
    require_scale(document, selection)
    facts = dict[str, object]()
    if selection.slots and not selection.vertices:
        facts |= _describe_under_textures(document, selection.slots[0], settings, access)
    notices, textures = [*document.notices, *selection.notices], list[dict[str, object]]()
    in_groups = settings.fits_parts
    memory, rest = memory_beside(document, access) if in_groups else None, list[Slot]()
    how = {"image": selection.image, "in_groups": in_groups}
    with checked_memory(document, selection.slots, settings.textures, access, None, **how):
        for slot in selection.slots:
            surface = choose_textures(document.textured(slot), settings.textures)
            many = too_many_together(surface.textures, memory)
            if many is None:
                rest.append(slot)
                continue
            textures.append(_describe_one_by_one(TileGroups(surface, *many), slot, settings))
            which = "estimated on some textures, as memory is small for all"
            notices.append(f"{slot}: noise and parameters are {which}.")
        chosen = dataclasses.replace(selection, slots=tuple(rest))
        for samples in layers_of(document, chosen, settings, access, in_groups=in_groups):
            if isinstance(samples, TextureLayer):
                textures.append(samples.describe())
                if samples.group is None:
                    textures[-1]["exposure"] = describe_exposure(samples)
            else:
                facts |= samples.describe()
                if samples.part == "vertices" and photograph_attribute(document) is not None:
                    facts["exposure"] = describe_exposure(samples, photographs_of(document))
            if isinstance(samples, ImageLayer):
                notices += [*samples.picture.notices, *samples.remarks]
        for slot in rest:
            groups = [each for each in textures if each["slot"] == slot]
            if len(groups) > 1:  # exposures belong to all groups together
                exposure = describe_exposure(TextureLayer.read(document.textured(slot), slot, settings))
                for each in groups:
                    each["exposure"] = exposure
    if textures:
        facts["textures"] = textures
        others = [slot for slot in document.slots() if slot not in settings.textures.slots]
        if others:
            notices.append(f"it has textures in other slots, too; --slots {','.join(others)} shows them")
    # Of images they are known once there is enough memory to decode them.
    file = {"name": document.name, "format": document.format, **document.facts()}
    return {"file": file, **facts, "notices": notices}


def _describe_one_by_one(groups: TileGroups, slot: Slot, settings: SmoothSettings) -> dict[str, object]:
    """Describe the textures of a slot one by one, and noise and parameters by some of them."""
    facts = TextureLayer.read(groups.evenly_chosen(), slot, settings).describe()
    del facts["seams_between_textures"], facts["exposure"]
    plain = dataclasses.replace(settings, kernel=dataclasses.replace(settings.kernel, free=()))
    images, counts = list[object](), Counter[str]()
    for index in range(len(groups.surface.textures)):
        samples = TextureLayer.read(only_textures(groups.surface, [index]), slot, plain)
        images += cast("list[object]", samples.describe()["images"])
        counts.update(samples.atlas.counts)
    return {**facts, "images": images, **counts}


def _describe_under_textures(
    document: Document, slot: Slot, settings: SmoothSettings, access: Access
) -> dict[str, object]:
    """Describe the surface that only textures are smoothed on, and the vertex colours that it has besides."""
    if settings.on == "auto" and document.grid() is None and document.has_vertex_colours():
        # They stay as they are, so no parameters are chosen for them.
        plain = dataclasses.replace(DEFAULTS, kernel=dataclasses.replace(settings.kernel, free=()))
        facts = vertex_layer(document, plain, access).describe()
        return {key: facts[key] for key in facts if key != "smooth"}
    surface = document.textured(slot)
    place_of, first = group_places(surface.positions, surface.space_of, surface.faces)
    positions = surface.positions[first]
    counts = {
        "vertices": len(surface.positions),
        "triangles": len(surface.faces),
        "coincident_vertices": len(surface.positions) - len(first),
        **count_topology(positions, place_of[surface.faces]),
        "bounds": bounds(positions),
    }
    return {"surface": counts}
