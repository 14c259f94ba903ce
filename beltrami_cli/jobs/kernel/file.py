"""Write one kernel of a file, to be looked at or as numbers."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.errors import UsageError
from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access, read_source
from beltrami_cli.formats.image.recognition import is_image
from beltrami_cli.jobs.kernel.location import read_location
from beltrami_cli.jobs.kernel.output import SUFFIXES, encode
from beltrami_cli.jobs.kernel.probe import probe_kernel
from beltrami_cli.jobs.opening import document_from, refuse_options_of_level_sets
from beltrami_cli.jobs.writing.output import Output
from beltrami_cli.samples.memory_check import require_room_for_textures
from beltrami_cli.samples.selection import choose_work, require_scale
from beltrami_cli.samples.settings import DEFAULTS

if TYPE_CHECKING:
    from collections.abc import Callable

    from beltrami_cli.formats.document import Document
    from beltrami_cli.jobs.kernel.probe import ProbedSamples
    from beltrami_cli.samples.settings import SmoothSettings


def kernel_file(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    at: str,
    settings: SmoothSettings = DEFAULTS,
    *,
    iteration: int = 1,
    whole: bool = False,
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
    access: Access = EVERYTHING_INSIDE,
) -> dict[str, object]:
    """Write the geodesic distances and the weights of the kernel at a sample, in an iteration; return its facts."""
    source, target = os.fspath(source), os.fspath(target)
    if iteration < 1:
        raise UsageError(f"iteration is {iteration}, but must be 1 or more")
    suffix = ".csv" if target == "-" else Path(target).suffix.lower()
    if suffix not in SUFFIXES:
        raise UsageError(
            f"{target}: a kernel is written as .ply, .png, .csv, .json or .npz; end the name in one"
        )
    location = read_location(at)
    output = Output(target, overwrite=overwrite, is_text=suffix == ".csv", what="kernel", reads=[source])
    access = output.files.watching(access)
    # What is restored of clipped colours comes after the averages of all iterations, and is none of them.
    kernel = dataclasses.replace(settings.kernel, iterations=iteration - 1, clipping="keep", free=())
    settings = dataclasses.replace(settings, kernel=kernel)
    samples = _samples(source, settings, access, whole=whole)
    probed = probe_kernel(samples, location, kernel, progress)
    facts = {"input": source, "output": target, **probed.facts}
    output.write(encode(probed, facts, suffix))
    return facts


def _samples(source: str, settings: SmoothSettings, access: Access, *, whole: bool) -> ProbedSamples:
    data = read_source(source, access)
    if is_image(data, source):
        from beltrami_cli.jobs.kernel.grid import PixelSamples

        name = "<stdin>" if source == "-" else source
        refuse_options_of_level_sets(settings, name)
        return PixelSamples(data, name, settings, access)
    return _samples_of_model(document_from(data, source, settings, access), settings, access, whole=whole)


def _samples_of_model(
    document: Document, settings: SmoothSettings, access: Access, *, whole: bool
) -> ProbedSamples:
    work = choose_work(document, settings)
    require_scale(document, work)
    if work.vertices and not work.slots:
        grid = document.grid()
        if grid is not None:
            from beltrami_cli.jobs.kernel.grid import RangeSamples

            return RangeSamples(document, grid, settings, access)
        from beltrami_cli.jobs.kernel.mesh import VertexSamples

        return VertexSamples(document, settings, access, whole=whole)
    if work.vertices or len(work.slots) > 1:
        raise UsageError(
            f"{document.name}: a kernel is of one image; choose --on vertices, or --on texture and one of --slots"
        )
    require_room_for_textures(document, work.slots, settings.textures, access)
    from beltrami_cli.jobs.kernel.grid import TexelSamples

    return TexelSamples(document, work.slots[0], settings, access)
