"""What is coloured in a file and how, and what smoothing it would do."""

from __future__ import annotations

import dataclasses
import os
from typing import TYPE_CHECKING

from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access, read_source
from beltrami_cli.formats.image.recognition import is_image
from beltrami_cli.jobs.inspect.vertices import describe_range, describe_vertices
from beltrami_cli.jobs.opening import document_from, refuse_options_of_level_sets
from beltrami_cli.samples.memory_check import require_room_for_textures
from beltrami_cli.samples.selection import choose_work, require_scale
from beltrami_cli.samples.settings.description import describe_kernel
from beltrami_cli.samples.settings.smooth import DEFAULTS, SmoothSettings

if TYPE_CHECKING:
    from beltrami_cli.formats.document import Document
    from beltrami_cli.surface.records import Slot


def inspect_file(
    source: str | os.PathLike[str], settings: SmoothSettings = DEFAULTS, access: Access = EVERYTHING_INSIDE
) -> dict[str, object]:
    """Describe a mesh file or an image, and what `smooth_file` would do with it.

    Parameters
    ----------
    source : path
        PLY, OBJ, glTF or GLB, an image, or a level set on a grid (.npz, .nrrd); "-" for standard input.
    settings : SmoothSettings
        What smoothing would be told.
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
    document = document_from(data, name, settings, access)
    work = choose_work(document, settings)
    require_scale(document, work)
    facts: dict[str, object] = {
        "file": {"name": document.name, "format": document.format, **document.facts()}
    }
    grid = document.grid() if work.vertices else None
    if grid is not None:
        facts.update(describe_range(document, grid, settings, access))
    elif work.vertices:
        facts.update(describe_vertices(document, settings, access))
    elif work.slots:
        facts.update(_describe_under_textures(document, work.slots[0], settings, access))
    require_room_for_textures(document, work.slots, settings.textures, access)
    slots = [_describe_slot(document, slot, settings, access) for slot in work.slots]
    if slots:
        facts["textures"] = slots
    others = [slot for slot in document.slots() if slots and slot not in settings.textures.slots]
    told = (f"it has textures in other slots, too; --slots {','.join(others)} shows them",) if others else ()
    facts["notices"] = [*document.notices, *work.notices, *told]
    return facts


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


def _describe_under_textures(
    document: Document, slot: Slot, settings: SmoothSettings, access: Access
) -> dict[str, object]:
    """Describe the surface that only textures are smoothed on, and the vertex colours that it has besides."""
    if settings.on == "auto" and document.grid() is None and document.has_vertex_colours():
        # They stay as they are, so no parameters are chosen for them.
        plain = dataclasses.replace(DEFAULTS, kernel=dataclasses.replace(settings.kernel, free=()))
        facts = describe_vertices(document, plain, access)
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
