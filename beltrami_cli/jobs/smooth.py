"""Smooth the colours of a file with the short-time Beltrami kernel: in their place, or in a new texture."""

from __future__ import annotations

import dataclasses
import os
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import UsageError
from beltrami_cli.fields import override
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image.reading import measure_image
from beltrami_cli.formats.registry import write_textured
from beltrami_cli.jobs.file_job import FileJob, begin
from beltrami_cli.jobs.job import PLAIN_JOB, Job
from beltrami_cli.jobs.recolour import paint, recolour
from beltrami_cli.jobs.settings import BakeSettings
from beltrami_cli.jobs.smoothing import Smoothed, Smoothing, SmoothReport, smooth_in_job, smooth_report
from beltrami_cli.layers.memory_check import require_memory_for_textures
from beltrami_cli.layers.selection import Selection, require_scale
from beltrami_cli.layers.settings import DEFAULTS, SmoothSettings
from beltrami_cli.layers.texture_layer import TextureLayer
from beltrami_cli.layers.vertex_layer import require_surface
from beltrami_cli.surface.records import ImageFile, TexturedSurface

if TYPE_CHECKING:
    from beltrami_cli.jobs.new_texture import NewTexture


def smooth_file(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    parameters: SmoothSettings = DEFAULTS,
    job: Job = PLAIN_JOB,
    *,
    unwrap: BakeSettings | None = None,
    **overrides: Any,
) -> SmoothReport:
    """Smooth the colours of a file, at its vertices, in its textures or of its pixels, and change nothing else.

    Parameters
    ----------
    source, target : path
        PLY, OBJ, glTF or GLB, points (.xyz, .asc, .txt, .csv, .pts, .npz) or an image; "-" for standard input or
        output. If the extension of `target` is that of another format, the file is converted. `source` may also be a
        mesh format that is read only (OFF, STL, 3MF, COLLADA), or a level set on a grid (.npz, .nrrd), which is
        written as a mesh.
    parameters : SmoothSettings
        The kernel's parameters, the working space, and the choice of colours. By default the kernel's parameters are
        chosen from the data, by the estimated error of the result.
    job : Job
        What may be read, a callback for progress, and whether files are written and replaced.
    unwrap : BakeSettings, optional
        Put the colours into a new texture atlas, smooth these, and write a new file that contains nothing else.
    **overrides
        Single parameters by name, such as ``iterations=3, slots=("normal",)``, which replace those in `parameters`.

    Returns
    -------
    SmoothReport
        The parameters used, counts, noise, changes, times, and the files that were written.

    Raises
    ------
    UsageError
        If a parameter is unknown or out of its range, if parameters contradict each other or the file, or if the format
        of the target is unknown.
    InputError
        If the source cannot be read, is damaged, or has no colours.
    OutputError
        If the target cannot be written, or exists and `job.overwrite` is not set. Existing files stay as they were.
    """
    source, target = os.fspath(source), os.fspath(target)
    settings = override(parameters, **overrides)
    if unwrap is not None:
        return _smooth_unwrapped(source, target, settings, unwrap, job)
    return smooth_report(*recolour(source, target, settings, Smoothing.of(settings), job), settings)


def _smooth_unwrapped(
    source: str, target: str, settings: SmoothSettings, wanted: BakeSettings, job: Job
) -> SmoothReport:
    """Smooth the base colour, or else the vertex colours, in a new texture, and write a new file with that."""
    _check(settings)
    file = begin(source, target, settings, job, models_only=True)
    with file.watch.stage("read"):
        selection = _selected(file.document, settings)
        stem = file.reserve_new(settings.textures.image_suffix or ".png")
    if settings.kernel.iterations:
        require_scale(file.document, selection)
    _require_possible(file, selection, settings)
    made, image, smoothed = _new_texture(file, selection, settings, wanted)
    notices = [*made.notices]
    if selection.slots and file.document.has_vertex_colours():
        notices.append("Vertex colours are not in the new file; --on vertices takes them, not the texture.")
    notices += [notice for each in smoothed for notice in each.repainted.notices]
    with file.watch.stage("write"):
        written = write_textured(made.mesh(image), file.format.name, stem)
    report = file.write(written, notices, [warning for each in smoothed for warning in each.warnings])
    return dataclasses.replace(smooth_report(report, smoothed, settings), new_texture=made.in_words)


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


def _selected(document: Document, settings: SmoothSettings) -> Selection:
    """Choose the base colour or the vertex colours; InputError if there are no colours at all."""
    shown = document.readable(slot for slot in document.slots() if slot == "baseColor")
    if settings.on == "texture" or (settings.on != "vertices" and shown):
        return Selection(slots=("baseColor",))
    document.painted()  # raises if there are none
    return Selection(vertices=True)


def _require_possible(file: FileJob, selection: Selection, settings: SmoothSettings) -> None:
    if selection.vertices:
        require_surface(file.document.painted(), file.document.name)
        return
    if settings.embedding.guides:
        raise UsageError("--guide cannot guide the new texture that --unwrap makes; use both in turn")
    require_memory_for_textures(file.document, selection.slots, settings.textures, file.job.access)


def _new_texture(
    file: FileJob, selection: Selection, settings: SmoothSettings, wanted: BakeSettings
) -> tuple[NewTexture, ImageFile, list[Smoothed]]:
    """Smooth the colours, then make the texture of them; in the opposite order where textures are too small."""
    from beltrami_cli.jobs.new_texture import texture_from_textures, texture_from_vertices

    # Between texels and vertices the new texture shows mixtures of the old colours. Their noise is spread over several
    # texels, where it looks like a pattern and stays.
    document, job, textures = file.document, file.job, settings.textures
    smooths, smoothed = bool(settings.kernel.iterations), list[Smoothed]()
    if smooths and (selection.vertices or _are_large_enough(document.textured("baseColor"))):
        # The images are only read by what follows, so they are written in a format that loses nothing.
        exact = dataclasses.replace(
            settings, textures=dataclasses.replace(textures, image_suffix=".tif", small=False)
        )
        with file.watch.stage("smooth"):
            smoothed = paint(document, selection, exact, Smoothing(exact), job, in_groups=False)
    with file.watch.stage("unwrap"):
        if selection.vertices:
            colours = smoothed[0].repainted.colours if smoothed else None
            made = texture_from_vertices(document, wanted, job.progress, colours)
        else:
            images = {key: image for each in smoothed for (_, key), image in each.repainted.images.items()}
            made = texture_from_textures(document, wanted, job.progress, images)
    if smoothed or not smooths:
        return (
            made,
            made.encoded(textures.image_suffix, textures.jpeg_quality, small=textures.small),
            smoothed,
        )
    with file.watch.stage("smooth"):
        layer = TextureLayer.read(made.surface(), "baseColor", settings)
        layer.require_writable()
        again = smooth_in_job(layer, job, "the new texture")
    (image,) = again.repainted.images.values()
    return made, image, [again]


def _are_large_enough(surface: TexturedSurface) -> bool:
    """Whether textures have a texel for each triangle, unlike palettes."""
    from beltrami_cli.jobs.new_texture import texels_of

    sizes = [measure_image(texture.data) for texture in surface.textures]
    sides = np.array([(0, 0) if size is None else (size.width, size.height) for size in sizes], np.int64)
    return texels_of(surface, sides.reshape(-1, 2)) >= int(np.count_nonzero(surface.texture_of >= 0))
