"""What a file is like: its coloured parts, their noise, and what smoothing would do."""

from __future__ import annotations

import dataclasses
import os
from itertools import chain

from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.jobs.job import PLAIN_JOB, Job
from beltrami_cli.jobs.opening import open_input
from beltrami_cli.jobs.progress import Label, phases_of
from beltrami_cli.layers.layer import Layer, Part
from beltrami_cli.layers.selection import Selection, layer_of_vertices, select
from beltrami_cli.layers.settings import DEFAULTS, LevelSettings, SmoothSettings
from beltrami_cli.layers.texture_layer import TextureLayer
from beltrami_cli.surface.geometry import bounds, count_topology
from beltrami_cli.surface.grouping import group_places


def inspect_file(
    source: str | os.PathLike[str],
    settings: SmoothSettings = DEFAULTS,
    job: Job = PLAIN_JOB,
) -> dict[str, object]:
    """Describe a mesh file or an image, and what `smooth_file` would do with it.

    Parameters
    ----------
    source : path
        Any file that `smooth_file` reads; "-" for standard input.
    settings : SmoothSettings
        As for `smooth_file`.
    job : Job
        What may be read, and a callback for progress.

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
    job.begin("reading")
    document = open_input(os.fspath(source), settings, job.access)
    selection = select(document, settings)
    coarse = selection.require_scale()
    counts = selection.work()
    job.expect(chain(*(phases_of(["laying out", "choosing parameters"], count) for count in counts)))
    surface = dict[str, object]()
    if selection.slots and not selection.vertices:
        surface = _describe_under_textures(selection)
    notices = [*document.notices, *selection.notices, *coarse]
    described, layer_notices = _describe_layers(selection, job)
    notices += layer_notices
    # The facts of an image are known once there is enough memory to decode it.
    file = {"name": document.name, "format": document.format, **document.facts()}
    facts: dict[str, object] = {"file": file, **surface}
    for each in (*described["vertices"], *described["image"]):
        facts |= each
    if described["textures"]:
        facts["textures"] = described["textures"]
        left = [slot for slot in document.slots() if slot not in settings.textures.slots]
        if left:
            notices.append(f"it has textures in other slots, too; --slots {','.join(left)} shows them")
    return {**facts, "notices": notices}


def _describe_layers(selection: Selection, job: Job) -> tuple[dict[Part, list[dict[str, object]]], list[str]]:
    """Describe the selected layers, by the part of the document that they belong to; return also notices."""
    described: dict[Part, list[dict[str, object]]] = {"vertices": [], "image": [], "textures": []}
    settings = selection.settings
    notices = list[str]()
    with selection.within_memory():
        job.begin("laying out")
        for layer in selection.layers(in_groups=settings.fits_parts):
            job.begin(Label(f"{layer.label}: choosing parameters", "choosing parameters"))
            facts, exposure = layer.normalised().describe(), describe_exposure(layer)
            described[layer.part].append(facts if exposure is None else {**facts, "exposure": exposure})
            notices += layer.notices
        for slot, surface in zip(selection.slots, selection.surfaces, strict=True):
            groups = [each for each in described["textures"] if each["slot"] == slot]
            if len(groups) > 1:  # exposures belong to all groups together
                exposure = describe_exposure(TextureLayer.read(surface, slot, settings))
                for each in groups:
                    each["exposure"] = exposure
    return described, notices


def describe_exposure(layer: Layer) -> dict[str, object] | None:
    """Describe exposure steps, in JSON types; None for layers that cannot be levelled, such as data."""
    try:
        report = layer.levelled(LevelSettings(exposure_strength=0.0)).level_report
    except (UsageError, InputError):
        return None
    assert report is not None
    return {
        "step": report.before,
        "seams": report.seams,
        "stepped": report.stepped,
        "painted": report.painted,
        "explained": report.explained,
        "is_exposure": bool(report.exposures),
    }


def _describe_under_textures(selection: Selection) -> dict[str, object]:
    """Describe the surface that only textures are smoothed on, and its vertex colours, which stay."""
    document, settings = selection.document, selection.settings
    if settings.on == "auto" and document.grid() is None and document.has_vertex_colours():
        # They stay as they are, so no parameters are chosen for them.
        plain = dataclasses.replace(DEFAULTS, kernel=dataclasses.replace(settings.kernel, free=()))
        facts = layer_of_vertices(document, plain).normalised().describe()
        return {key: facts[key] for key in facts if key != "smooth"}
    surface = document.textured(selection.slots[0])
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
