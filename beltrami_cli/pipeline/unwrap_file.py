"""Smooth the colours of a file in a new texture: unwrap, bake, smooth, write."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.errors import UsageError
from beltrami_cli.formats.source import open_document
from beltrami_cli.pipeline.conversion import names_beside, write_textured
from beltrami_cli.pipeline.new_texture import texture_from_textures, texture_from_vertices
from beltrami_cli.pipeline.output import Output
from beltrami_cli.pipeline.report import SmoothReport, make_report
from beltrami_cli.pipeline.smooth_textures import smooth_slot
from beltrami_cli.pipeline.stopwatch import Stopwatch
from beltrami_cli.pipeline.work import choose_format

if TYPE_CHECKING:
    from collections.abc import Callable

    from beltrami_cli.formats.document import Document
    from beltrami_cli.pipeline.bake_settings import BakeSettings
    from beltrami_cli.pipeline.new_texture import NewTexture
    from beltrami_cli.pipeline.settings import SmoothSettings


def smooth_unwrapped(
    source: str,
    target: str,
    settings: SmoothSettings,
    wanted: BakeSettings,
    *,
    format: str | None = None,  # noqa: A002 -- the name of the option
    overwrite: bool = False,
    dry_run: bool = False,
    progress: Callable[[str, int, int], None] | None = None,
) -> SmoothReport:
    """Smooth the base colour, or else the vertex colours, in a new texture, and write a new file with that.

    Parameters
    ----------
    source, target, settings, format, overwrite, dry_run, progress
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
    output = None if dry_run else Output(target, overwrite=overwrite)
    stem = Path(target).stem
    with watch.stage("read"):
        document = open_document(source)
        target_format = choose_format(document, target, format)
        if output is not None:
            suffix = settings.textures.image_suffix or ".png"
            output.check_sidecars(names_beside(target_format, stem, suffix))
    with watch.stage("unwrap"):
        made = _new_texture(document, settings, wanted, progress)
    image, slots, notices = made.encoded(), [], list(made.notices)
    with watch.stage("smooth"):
        if settings.kernel.iterations > 0:
            label = "the new texture"
            result = smooth_slot(
                made.surface(),
                "baseColor",
                settings,
                None if progress is None else lambda done, total: progress(label, done, total),
            )
            (image,), slots = result.images.values(), [result.report]
            notices += result.notices
    with watch.stage("write"):
        written = write_textured(made.mesh(image), target_format, stem)
        if output is not None:
            output.write(written)
    files = [] if output is None else [target, *written.sidecars]
    warnings = [*document.notices, *notices, *written.notices]
    return make_report(source, target, target_format, document, settings, None, slots, watch, files, warnings)


def _check(settings: SmoothSettings) -> None:
    """Refuse what has no meaning for one new texture."""
    textures = settings.textures
    if settings.on == "both":
        raise UsageError("--unwrap smooths one new texture, so --on cannot be both")
    if textures.materials or textures.names or textures.slots != ("baseColor",):
        raise UsageError(
            "--unwrap makes one new base colour texture, so --material, --texture and --slots cannot choose"
        )


def _new_texture(
    document: Document,
    settings: SmoothSettings,
    wanted: BakeSettings,
    progress: Callable[[str, int, int], None] | None,
) -> NewTexture:
    textured = settings.on != "vertices" and (settings.on == "texture" or "baseColor" in document.slots())
    if not textured:
        return texture_from_vertices(document, wanted, progress)
    made = texture_from_textures(document, wanted, progress)
    if not document.has_vertex_colours():
        return made
    dropped = "Its vertex colours are not in the new file; --on vertices takes them rather than the texture."
    return dataclasses.replace(made, notices=(*made.notices, dropped))
