"""Smooth the colours of a file and write them in a new texture: unwrap, bake, write."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import UsageError
from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access
from beltrami_cli.formats.image.reading import measure_image
from beltrami_cli.formats.registry import sidecar_names, write_textured
from beltrami_cli.jobs.new_texture import texels_of, texture_from_textures, texture_from_vertices
from beltrami_cli.jobs.opening import open_input
from beltrami_cli.jobs.smooth.reporting import make_report
from beltrami_cli.jobs.smooth.stopwatch import Stopwatch
from beltrami_cli.jobs.writing.output import Output
from beltrami_cli.samples.memory_check import require_room_for_textures
from beltrami_cli.samples.selection import Work, choose_format, require_scale
from beltrami_cli.samples.textures.smooth import smooth_slot
from beltrami_cli.samples.vertices.guides import vertex_guides
from beltrami_cli.samples.vertices.prepare import require_surface
from beltrami_cli.samples.vertices.smooth import smooth_painted

if TYPE_CHECKING:
    from collections.abc import Callable

    from beltrami_cli.flow.embedding import Guide
    from beltrami_cli.formats.document import Document
    from beltrami_cli.jobs.new_texture import NewTexture
    from beltrami_cli.jobs.smooth.report import SmoothReport
    from beltrami_cli.jobs.writing.files import FileSet
    from beltrami_cli.samples.settings import BakeSettings, SmoothSettings
    from beltrami_cli.samples.textures.smooth import SlotReport
    from beltrami_cli.samples.vertices.result import SmoothResult
    from beltrami_cli.surface.records import ImageFile, TexturedSurface

    Progress = Callable[[str, int, int], None] | None


@dataclass(frozen=True)
class _Done:
    """A new texture, its smoothed image, what to tell the user, and reports of what was smoothed."""

    made: NewTexture
    image: ImageFile
    notices: list[str]
    vertices: SmoothResult | None = None
    slots: list[SlotReport] = field(default_factory=list)


def smooth_unwrapped(
    source: str,
    target: str,
    settings: SmoothSettings,
    wanted: BakeSettings,
    *,
    format: str | None = None,  # noqa: A002 -- the name of the option
    overwrite: bool = False,
    dry_run: bool = False,
    progress: Progress = None,
    access: Access = EVERYTHING_INSIDE,
    files: FileSet | None = None,
) -> SmoothReport:
    """Smooth the base colour, or else the vertex colours, in a new texture, and write a new file with that.

    Parameters
    ----------
    source, target, settings, format, overwrite, dry_run, progress, access, files
        As for `smooth_file`.
    wanted : BakeSettings
        How the texture is made.

    Returns
    -------
    SmoothReport

    Raises
    ------
    UsageError, InputError, ProcessingError, OutputError
        As `smooth_file`; and if the mesh cannot be unwrapped.
    """
    _check(settings)
    watch = Stopwatch()
    output = None if dry_run else Output(target, overwrite=overwrite, files=files)
    if output is not None:
        output.files.guard(settings.files_besides(source))
        access = output.files.watching(access)
    stem = Path(target).stem
    with watch.stage("read"):
        document = open_input(source, settings, access)
        target_format = choose_format(document, target, format)
        if output is not None:
            suffix = settings.textures.image_suffix or ".png"
            output.check_sidecars(sidecar_names(target_format, stem, suffix))
    textured = _is_textured(document, settings)
    if settings.kernel.iterations:
        require_scale(document, Work(vertices=not textured, slots=("baseColor",) if textured else ()))
    if textured:
        if settings.embedding.guides:
            raise UsageError("--guide cannot guide the new texture that --unwrap makes; use both in turn")
        require_room_for_textures(document, ("baseColor",), settings.textures, access)
        done = _smooth_in_texture(document, settings, wanted, watch, progress)
    else:
        guides = vertex_guides(document, settings, access)
        done = _smooth_on_vertices(document, settings, wanted, watch, progress, guides)
    with watch.stage("write"):
        written = write_textured(done.made.mesh(done.image), target_format, stem)
        if output is not None:
            output.write(written)
    names = [] if output is None else [target, *written.sidecars]
    warnings = [*document.notices, *done.notices, *written.notices]
    return make_report(
        source, target, target_format, document, settings, done.vertices, done.slots, watch, names, warnings
    )


def _check(settings: SmoothSettings) -> None:
    """Refuse what has no meaning for one new texture."""
    textures = settings.textures
    if settings.on == "both":
        raise UsageError("--unwrap smooths one new texture, so --on cannot be both")
    if textures.materials or textures.names or textures.slots != ("baseColor",):
        raise UsageError(
            "--unwrap makes one new base colour texture, so --material, --texture and --slots cannot choose"
        )
    if settings.embedding.smooth_geometry:
        raise UsageError(
            "--unwrap writes a new file, in which --smooth-geometry cannot move vertices; use both in turn"
        )


def _is_textured(document: Document, settings: SmoothSettings) -> bool:
    return settings.on != "vertices" and (settings.on == "texture" or "baseColor" in document.slots())


def _smooth_in_texture(
    document: Document, settings: SmoothSettings, wanted: BakeSettings, watch: Stopwatch, progress: Progress
) -> _Done:
    """Smooth the textures, then make the new one; afterwards, where the old ones are no place to do so.

    A new texture shows theirs between texels, which spreads noise over several and makes it look like a pattern.
    """
    iterations, first = settings.kernel.iterations, None
    if iterations and _has_room(document.textured("baseColor")):
        with watch.stage("smooth"):
            first = smooth_slot(
                document.textured("baseColor"), "baseColor", _in_passing(settings),
                _labelled(progress, "baseColor textures"), document,
            )  # fmt: skip
    old = {} if first is None else {key: image for (_, key), image in first.images.items()}
    with watch.stage("unwrap"):
        made = texture_from_textures(document, wanted, progress, old)
    notices = list(made.notices)
    if document.has_vertex_colours():
        notices.append("Vertex colours are not in the new file; --on vertices takes them, not the texture.")
    if first is not None or not iterations:
        told = () if first is None else first.notices
        image = _encoded(made, settings)
        return _Done(made, image, [*notices, *told], slots=[] if first is None else [first.report])
    with watch.stage("smooth"):
        result = smooth_slot(made.surface(), "baseColor", settings, _labelled(progress, "the new texture"))
    (image,) = result.images.values()
    return _Done(made, image, [*notices, *result.notices], slots=[result.report])


def _smooth_on_vertices(
    document: Document,
    settings: SmoothSettings,
    wanted: BakeSettings,
    watch: Stopwatch,
    progress: Progress,
    guides: list[Guide],
) -> _Done:
    """Smooth the vertex colours, then make the texture.

    In a texture their noise would be spread over several texels each, where it looks like a pattern and stays.
    """
    painted, smoothed = document.painted(), None
    require_surface(painted, document.name)
    if settings.kernel.iterations > 0:
        with watch.stage("smooth"):
            smoothed = smooth_painted(painted, settings, _labelled(progress, "vertex colours"), guides)
    with watch.stage("unwrap"):
        colours = None if smoothed is None else smoothed.colours
        made = texture_from_vertices(document, wanted, progress, colours)
    return _Done(made, _encoded(made, settings), list(made.notices), vertices=smoothed)


def _has_room(surface: TexturedSurface) -> bool:
    """Tell whether textures have a texel for each triangle; in palettes triangles are points, and share few colours."""
    sizes = [measure_image(texture.data) for texture in surface.textures]
    sides = np.array([(0, 0) if size is None else (size.width, size.height) for size in sizes], np.int64)
    return texels_of(surface, sides.reshape(-1, 2)) >= int(np.count_nonzero(surface.texture_of >= 0))


def _in_passing(settings: SmoothSettings) -> SmoothSettings:
    """Return settings for textures that are written for the way only: in a format that loses nothing."""
    return dataclasses.replace(
        settings, textures=dataclasses.replace(settings.textures, image_suffix=".tif", small=False)
    )


def _encoded(made: NewTexture, settings: SmoothSettings) -> ImageFile:
    textures = settings.textures
    return made.encoded(textures.image_suffix, textures.jpeg_quality, small=textures.small)


def _labelled(progress: Progress, label: str) -> Callable[[int, int], None] | None:
    return None if progress is None else lambda done, total: progress(label, done, total)
