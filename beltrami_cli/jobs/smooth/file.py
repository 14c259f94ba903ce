"""Smooth the colours of a file: read, sample, iterate, write."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access, read_source
from beltrami_cli.formats.image.recognition import is_image
from beltrami_cli.jobs.conversion import make_files
from beltrami_cli.jobs.opening import document_from, refuse_options_of_level_sets
from beltrami_cli.jobs.sidecars import is_moved, plan_companions
from beltrami_cli.jobs.smooth.reporting import make_report
from beltrami_cli.jobs.smooth.stopwatch import Stopwatch
from beltrami_cli.jobs.writing.output import Output
from beltrami_cli.samples.memory_check import room_for_smoothing
from beltrami_cli.samples.selection import Work, choose_format, choose_work, require_scale
from beltrami_cli.samples.settings import DEFAULTS, SmoothSettings
from beltrami_cli.samples.vertices.guides import vertex_guides
from beltrami_cli.samples.vertices.moved import moved_vertices, require_geometry
from beltrami_cli.samples.vertices.point_cloud import smooth_cloud
from beltrami_cli.samples.vertices.smooth import smooth_painted

if TYPE_CHECKING:
    from collections.abc import Callable

    from beltrami_cli.formats.document import Document
    from beltrami_cli.jobs.smooth.report import SmoothReport
    from beltrami_cli.jobs.writing.files import FileSet
    from beltrami_cli.samples.settings import BakeSettings
    from beltrami_cli.samples.textures.smooth import SlotReport
    from beltrami_cli.samples.vertices.result import SmoothResult
    from beltrami_cli.surface.records import ImageFile, Slot


def smooth_file(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    settings: SmoothSettings = DEFAULTS,
    *,
    unwrap: BakeSettings | None = None,
    format: str | None = None,  # noqa: A002 -- the name of the option
    overwrite: bool = False,
    dry_run: bool = False,
    progress: Callable[[str, int, int], None] | None = None,
    access: Access = EVERYTHING_INSIDE,
    files: FileSet | None = None,
) -> SmoothReport:
    """Smooth the colours of a mesh file, in its vertices or textures, or of an image, and change nothing else.

    Parameters
    ----------
    source, target : path
        PLY, OBJ, glTF or GLB, or an image; "-" for standard input or output. Another extension converts.
        `source` may also be a level set on a grid (.npz, .nrrd), which is written as a mesh.
    settings : SmoothSettings
        The kernel's parameters, the working space, and what is smoothed.
    unwrap : BakeSettings, optional
        Put the colours in a new texture, smooth that, and write a new file with nothing else.
    format : {"ply", "obj", "glb", "gltf", "png", ...}, optional
        Format to write where the name of `target` does not tell.
    overwrite : bool
        Whether existing files may be replaced.
    dry_run : bool
        Compute everything and write nothing.
    progress : callable, optional
        Called with a label of what is being smoothed, the work done so far and the work to do; may raise to stop.
    access : Access
        What may be read.
    files : FileSet, optional
        The files of the run, if there are others that are put in place together with `target`: by the caller.

    Returns
    -------
    SmoothReport

    Raises
    ------
    UsageError
        If the format cannot be told, or settings contradict each other or the file.
    InputError
        If the source cannot be read or holds no colours.
    OutputError
        If the target cannot be written; existing files are as they were.
    """
    source, target = os.fspath(source), os.fspath(target)
    if unwrap is not None:
        from beltrami_cli.jobs.smooth.unwrap import smooth_unwrapped

        return smooth_unwrapped(
            source, target, settings, unwrap,
            format=format, overwrite=overwrite, dry_run=dry_run, progress=progress, access=access,
            files=files,
        )  # fmt: skip
    watch = Stopwatch()
    output = None if dry_run else Output(target, overwrite=overwrite, files=files)
    if output is not None:
        output.files.guard(settings.files_besides(source))
        access = output.files.watching(access)
    with watch.stage("read"):
        data = read_source(source, access)
    if is_image(data, source):
        from beltrami_cli.jobs.smooth.image_file import smooth_image_file

        refuse_options_of_level_sets(settings, source)
        return smooth_image_file(
            data, source, target, settings, output, watch, format=format, progress=progress, access=access
        )
    with watch.stage("read"):
        document = document_from(data, source, settings, access)
        target_format = choose_format(document, target, format)
        work = choose_work(document, settings)
        if settings.kernel.iterations == 0:
            work = Work(vertices=False, slots=())  # the output is the input
        else:
            require_geometry(document, work, settings, written_back=target_format == document.format)
        require_scale(document, work)
        companions = plan_companions(document, work, settings, target_format, source, target, output, access)
    place = None if output is None else target
    with watch.stage("smooth"), room_for_smoothing(document, work.slots, settings.textures, access, place):
        vertices = _smooth_vertices(document, work, settings, progress, access)
        images, slots, notices = _smooth_slots(document, work, settings, progress, access)
    with watch.stage("write"):
        if not is_moved(source, target):
            images = _changed(document, images)
        colours = None if vertices is None else vertices.colours
        positions = None if vertices is None else vertices.positions
        places = None if positions is None else moved_vertices(document, positions)
        stem = Path(target).stem
        written = make_files(
            document, colours, images, target_format, stem, moved=companions.keep_names, places=places
        )
        written = companions.complete(written, access)
        if output is not None:
            output.write(written)
    names = [] if output is None else [target, *written.sidecars]
    # Several slots say the same of one surface.
    warnings = list(dict.fromkeys([*document.notices, *work.notices, *notices, *written.notices]))
    return make_report(
        source, target, target_format, document, settings, vertices, slots, watch, names, warnings
    )


def _smooth_vertices(
    document: Document,
    work: Work,
    settings: SmoothSettings,
    progress: Callable[[str, int, int], None] | None,
    access: Access,
) -> SmoothResult | None:
    if not work.vertices:
        return None
    painted, grid = document.painted(), document.grid()
    guides = vertex_guides(document, settings, access)
    if grid is not None:
        from beltrami_cli.samples.images.range_image import smooth_range

        return smooth_range(painted, grid, settings, _labelled(progress, "range image"), guides)
    job = smooth_painted if len(painted.faces) else smooth_cloud
    return job(painted, settings, _labelled(progress, "vertex colours"), guides)


def _smooth_slots(
    document: Document,
    work: Work,
    settings: SmoothSettings,
    progress: Callable[[str, int, int], None] | None,
    access: Access,
) -> tuple[dict[tuple[Slot, str], ImageFile], list[SlotReport], list[str]]:
    images: dict[tuple[Slot, str], ImageFile] = {}
    reports: list[SlotReport] = []
    notices: list[str] = []
    if work.slots:
        from beltrami_cli.samples.textures.choosing import choose_textures
        from beltrami_cli.samples.textures.shared import SharedImages
        from beltrami_cli.samples.textures.smooth import smooth_slot

        chosen = [choose_textures(document.textured(slot), settings.textures) for slot in work.slots]
        shared = SharedImages(texture.key for surface in chosen for texture in surface.textures)
    for slot in work.slots:
        textured, label = document.textured(slot), f"{slot} textures"
        result = smooth_slot(textured, slot, settings, _labelled(progress, label), document, access, shared)
        images.update(result.images)
        reports.append(result.report)
        notices.extend(result.notices)
    return images, reports, notices


def _changed(
    document: Document, images: dict[tuple[Slot, str], ImageFile]
) -> dict[tuple[Slot, str], ImageFile]:
    """Leave out images that are as they were: beside the source, the output names them as the source does."""
    return {
        (slot, key): image
        for (slot, key), image in images.items()
        if all(image.data != each.data for each in document.textured(slot).textures if each.key == key)
    }


def _labelled(
    progress: Callable[[str, int, int], None] | None, label: str
) -> Callable[[int, int], None] | None:
    return None if progress is None else lambda done, total: progress(label, done, total)
