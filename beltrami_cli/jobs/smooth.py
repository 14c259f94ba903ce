"""Smooth the colours of a file with the short-time Beltrami kernel: in their place, or in a new texture."""

from __future__ import annotations

import dataclasses
import os
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import UsageError
from beltrami_cli.fields import override
from beltrami_cli.formats.access import Access
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image.reading import measure_image
from beltrami_cli.formats.registry import sidecar_names, write_textured
from beltrami_cli.jobs.job import PLAIN_JOB, Job, Stopwatch
from beltrami_cli.jobs.recolour import FileReport, naming_of, open_input, recolour
from beltrami_cli.jobs.settings import BakeSettings
from beltrami_cli.jobs.smoothing import Smoothed, Smoothing, SmoothReport, smooth_report, smooth_samples
from beltrami_cli.samples.memory_check import require_memory_for_textures
from beltrami_cli.samples.selection import Selection, choose_format, require_scale, vertex_samples
from beltrami_cli.samples.settings import DEFAULTS, SmoothSettings
from beltrami_cli.samples.texel_samples import TexelSamples
from beltrami_cli.samples.vertex_samples import require_surface
from beltrami_cli.surface.records import ImageFile, TexturedSurface

if TYPE_CHECKING:
    from beltrami_cli.jobs.new_texture import NewTexture

    # A new texture, its smoothed image, what users should know, and what was smoothed.
    _InTexture = tuple[NewTexture, ImageFile, list[str], list[Smoothed]]


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
        The kernel's parameters, the working space, and what is smoothed. By default the parameters of the kernel are
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
    watch, (output, access) = Stopwatch(), job.output(target, settings.files_besides(source))
    with watch.stage("read"):
        document = open_input(source, settings, access)
        shown = document.readable(slot for slot in document.slots() if slot == "baseColor")
        textured = settings.on == "texture" or (settings.on != "vertices" and bool(shown))
        if not textured:
            document.painted()  # raises if there are no colours at all
        if job.check is not None:
            job.check(document)
        kind = choose_format(document, target, job.format).name
        image_suffix = settings.textures.image_suffix or ".png"
        naming = naming_of(document, source, target, output, access)
        stem = naming.free_stem(lambda stem: sidecar_names(kind, stem, image_suffix))
        if output is not None:
            output.check_sidecars(sidecar_names(kind, stem, image_suffix))
    if settings.kernel.iterations:
        require_scale(document, Selection(not textured, ("baseColor",) if textured else ()))
    if textured:
        if settings.embedding.guides:
            raise UsageError("--guide cannot guide the new texture that --unwrap makes; use both in turn")
        require_memory_for_textures(document, ("baseColor",), settings.textures, access)
        made, image, notices, done = _smooth_in_texture(document, settings, wanted, watch, job)
    else:
        made, image, notices, done = _smooth_on_vertices(document, settings, wanted, watch, job, access)
    with watch.stage("write"):
        written = write_textured(made.mesh(image), kind, stem)
        if output is not None:
            output.write(written)
    names = [] if output is None else [target, *written.sidecars]
    late = [warning for each in done for warning in each.warnings]
    warnings = [*document.notices, *notices, *written.notices, *late]
    report = FileReport(
        input=source, output=target, format=kind, stages=watch.stages, written=names, warnings=warnings
    )
    return dataclasses.replace(smooth_report(report, done, settings), new_texture=made.in_words)


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


def _smooth_in_texture(
    document: Document, settings: SmoothSettings, wanted: BakeSettings, watch: Stopwatch, job: Job
) -> _InTexture:
    """Smooth the textures, then make the new one; in the opposite order where textures are too small."""
    from beltrami_cli.jobs.new_texture import texture_from_textures

    # A new texture shows the old ones between texels, which spreads noise over several and makes it look like a
    # pattern.
    iterations, first = settings.kernel.iterations, None
    old_surface = document.textured("baseColor")
    if iterations and _are_large_enough(old_surface):
        with watch.stage("smooth"):
            # They are written for the way only, so in a format that loses nothing.
            textures = dataclasses.replace(settings.textures, image_suffix=".tif", small=False)
            in_passing = dataclasses.replace(settings, textures=textures)
            samples = TexelSamples(old_surface, "baseColor", in_passing)
            samples.require_writable()
            first = smooth_samples(samples, job)
    old = {} if first is None else {key: image for (_, key), image in first.repainted.images.items()}
    with watch.stage("unwrap"):
        made = texture_from_textures(document, wanted, job.progress, old)
    notices = list(made.notices)
    if document.has_vertex_colours():
        notices.append("Vertex colours are not in the new file; --on vertices takes them, not the texture.")
    if first is not None or not iterations:
        done = [] if first is None else [first]
        notices += [notice for each in done for notice in each.repainted.notices]
        return made, _encoded(made, settings), notices, done
    with watch.stage("smooth"):
        samples = TexelSamples(made.surface(), "baseColor", settings)
        samples.require_writable()
        smoothed = smooth_samples(samples, job, "the new texture")
    (image,) = smoothed.repainted.images.values()
    return made, image, [*notices, *smoothed.repainted.notices], [smoothed]


def _smooth_on_vertices(
    document: Document, settings: SmoothSettings, wanted: BakeSettings, watch: Stopwatch, job: Job, access: Access
) -> _InTexture:  # fmt: skip
    """Smooth the vertex colours, then make the texture."""
    from beltrami_cli.jobs.new_texture import texture_from_vertices

    # In a texture their noise would be spread over several texels each, where it looks like a pattern and stays.
    smoothed: list[Smoothed] = []
    require_surface(document.painted(), document.name)
    if settings.kernel.iterations > 0:
        with watch.stage("smooth"):
            smoothed = [smooth_samples(vertex_samples(document, settings, access), job)]
    with watch.stage("unwrap"):
        colours = smoothed[0].repainted.colours if smoothed else None
        made = texture_from_vertices(document, wanted, job.progress, colours)
    return made, _encoded(made, settings), list(made.notices), smoothed


def _are_large_enough(surface: TexturedSurface) -> bool:
    """Whether textures have a texel for each triangle, unlike palettes."""
    from beltrami_cli.jobs.new_texture import texels_of

    sizes = [measure_image(texture.data) for texture in surface.textures]
    sides = np.array([(0, 0) if size is None else (size.width, size.height) for size in sizes], np.int64)
    return texels_of(surface, sides.reshape(-1, 2)) >= int(np.count_nonzero(surface.texture_of >= 0))


def _encoded(made: NewTexture, settings: SmoothSettings) -> ImageFile:
    textures = settings.textures
    return made.encoded(textures.image_suffix, textures.jpeg_quality, small=textures.small)
