"""Smoothing the colours of a file in a new texture."""

from __future__ import annotations

import dataclasses

import numpy as np

from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.fields import require_effect
from beltrami_cli.flow.chunks import Resources
from beltrami_cli.formats.image.sizes import measure_image
from beltrami_cli.formats.output_format import write_mesh
from beltrami_cli.jobs.file_job import FileJob, open_file_job
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.new_texture.from_textures import count_texels, texture_from_textures
from beltrami_cli.jobs.new_texture.from_vertices import texture_from_vertices
from beltrami_cli.jobs.new_texture.texture import NewTexture, texture_description
from beltrami_cli.jobs.recolour import apply_filter
from beltrami_cli.jobs.settings import BakeSettings
from beltrami_cli.jobs.smooth_report import SmoothReport, smooth_report
from beltrami_cli.jobs.smoothing import Smoothed, Smoothing, smooth_in_job
from beltrami_cli.layers.selection import Selection
from beltrami_cli.layers.settings import SmoothSettings, describe_settings
from beltrami_cli.layers.storing import all_images
from beltrami_cli.layers.texture_layer import TextureLayer
from beltrami_cli.surface.records import ImageFile, TexturedSurface


def smooth_unwrapped(
    source: str, target: str, settings: SmoothSettings, baking: BakeSettings, job: Job
) -> SmoothReport:
    """Smooth the base colour, or else the vertex colours, in a new texture, and write a new file with that."""
    _check(settings)
    file = open_file_job(source, target, settings, job, models_only=True)
    with file.watch.stage("read"):
        selection = _selected(file, settings)
        require_effect(file.document.access.typed, [*selection.kinds, "textures"], file.document.name)
        job.check_document(file.document)
        stem = file.reserve_new(settings.textures.image_suffix or ".png")
    notices = selection.require_scale() if settings.kernel.iterations else []
    _require_possible(selection)
    new, image, smoothed = _new_texture(file, selection, baking)
    notices += new.notices
    if selection.slots and file.document.has_vertex_colours():
        notices.append("Vertex colours are not in the new file; --on vertices takes them, not the texture.")
    notices += [notice for each in smoothed for notice in each.stored.notices]
    with file.watch.stage("write"):
        written = write_mesh(new.mesh(image), file.format.name, stem)
    warnings = [warning for each in smoothed for warning in each.warnings]
    report = file.write(written, describe_settings(settings), [*selection.notices, *notices], warnings)
    return dataclasses.replace(smooth_report(report, smoothed), new_texture=texture_description(image))


def _check(settings: SmoothSettings) -> None:
    """Refuse what has no meaning for one new texture."""
    textures, cause = settings.textures, ""
    if settings.level_seams:
        cause = "makes new charts; take exposure steps out with `beltrami level` before"
    elif settings.on == "both":
        cause = "smooths one new texture, so --on cannot be both"
    elif textures.materials or textures.names or textures.slots != ("baseColor",):
        cause = "makes one new base colour texture, so --material, --texture and --slots cannot choose"
    elif settings.embedding.smooth_geometry:
        cause = "writes a new file, in which --smooth-geometry cannot move vertices; use both in turn"
    if cause:
        raise UsageError(f"--unwrap {cause}")


def _selected(file: FileJob, settings: SmoothSettings) -> Selection:
    """Choose the base colour or the vertex colours; InputError if there are no colours at all."""
    document = file.document
    shown = document.readable(slot for slot in document.slots() if slot == "baseColor")
    if settings.on == "texture" or (settings.on != "vertices" and shown):
        return Selection(document, settings, slots=("baseColor",))
    document.coloured_vertices()  # raises if there are none
    return Selection(document, settings, vertices=True)


def _require_possible(selection: Selection) -> None:
    if selection.vertices:
        vertices = selection.document.coloured_vertices()
        if not len(vertices.faces):
            count = len(vertices.positions)
            cause = f"its {count} coloured vertices have no faces, so there is no surface to smooth on"
            raise InputError(selection.document.name, cause, "triangulate the points first")
        return
    if selection.settings.embedding.guides:
        raise UsageError("--guide cannot guide the new texture that --unwrap makes; use both in turn")
    selection.require_memory()


def _new_texture(
    file: FileJob, selection: Selection, baking: BakeSettings
) -> tuple[NewTexture, ImageFile, list[Smoothed]]:
    """Smooth the colours, then make the texture of them; in the opposite order where textures are too small."""
    # Between texels and vertices the new texture shows mixtures of the old colours. Their noise is spread over several
    # texels, where it looks like a pattern and stays.
    document, job, settings = file.document, file.job, selection.settings
    textures = settings.textures
    smooths, smoothed = bool(settings.kernel.iterations), list[Smoothed]()
    if smooths and (selection.vertices or _are_large_enough(document.textured("baseColor"))):
        # The images are only read by what follows, so they are written in a format that loses nothing.
        exact = dataclasses.replace(
            settings, textures=dataclasses.replace(textures, image_suffix=".tif", small=False)
        )
        with file.watch.stage("smooth"):
            smoothed = apply_filter(
                dataclasses.replace(selection, settings=exact), Smoothing(exact), job, Resources(job.chunking)
            )
    with file.watch.stage("unwrap"):
        if selection.vertices:
            colours = smoothed[0].stored.colours if smoothed else None
            new = texture_from_vertices(document, baking, job.progress, colours)
        else:
            images = all_images(each.stored for each in smoothed)[0]
            exact_document = document.with_colours(None, {key: image.data for key, image in images.items()})
            new = texture_from_textures(exact_document, baking, job.progress)
    if smoothed or not smooths:
        image = new.encoded(textures.image_suffix, textures.jpeg_quality, small=textures.small)
        return new, image, smoothed
    with file.watch.stage("smooth"):
        layer = TextureLayer.read(new.surface(), "baseColor", settings)
        layer = dataclasses.replace(layer, resources=Resources(job.chunking))
        layer.require_writable()
        again = smooth_in_job(layer, job, "the new texture")
    (image,) = again.stored.images.values()
    return new, image, [again]


def _are_large_enough(surface: TexturedSurface) -> bool:
    """Whether textures have a texel for each triangle, unlike palettes."""
    sizes = [measure_image(texture.data) for texture in surface.textures]
    sides = np.array([(0, 0) if size is None else (size.width, size.height) for size in sizes], np.int64)
    return count_texels(surface, sides.reshape(-1, 2)) >= int(np.count_nonzero(surface.texture_of >= 0))
