"""Write one kernel of a file, to be looked at or as numbers."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import TYPE_CHECKING, cast

from beltrami_cli.errors import UsageError
from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access
from beltrami_cli.jobs.documents import open_input
from beltrami_cli.jobs.kernel.location import read_location
from beltrami_cli.jobs.kernel.output import SUFFIXES, encode
from beltrami_cli.jobs.kernel.probe import probe_kernel
from beltrami_cli.jobs.writing.output import Output
from beltrami_cli.samples.memory_check import require_room_for_textures
from beltrami_cli.samples.selection import require_scale, samples_of, select
from beltrami_cli.samples.settings import DEFAULTS

if TYPE_CHECKING:
    from collections.abc import Callable

    from beltrami_cli.jobs.kernel.probe import ProbedSamples
    from beltrami_cli.samples.settings import SmoothSettings
    from beltrami_cli.samples.vertex_samples import VertexSamples


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
    samples = _probed(source, settings, access, whole=whole)
    probed = probe_kernel(samples, location, kernel, progress)
    facts = {"input": source, "output": target, **probed.facts}
    output.write(encode(probed, facts, suffix))
    return facts


def _probed(source: str, settings: SmoothSettings, access: Access, *, whole: bool) -> ProbedSamples:
    """Take the samples of a file of which there is one kind."""
    document = open_input(source, settings, access)
    selection = select(document, settings)
    require_scale(document, selection)
    if selection.vertices + len(selection.slots) + selection.image > 1:
        raise UsageError(
            f"{document.name}: a kernel is of one image; choose --on vertices, or --on texture and one of --slots"
        )
    require_room_for_textures(document, selection.slots, settings.textures, access)
    (samples,) = samples_of(document, selection, settings, access)
    from beltrami_cli.jobs.kernel.grid import ProbedPixels, ProbedRange, ProbedTexels
    from beltrami_cli.jobs.kernel.mesh import ProbedVertices
    from beltrami_cli.samples.pixel_samples import PixelSamples
    from beltrami_cli.samples.range_samples import RangeSamples
    from beltrami_cli.samples.texel_samples import TexelSamples

    if isinstance(samples, PixelSamples):
        return ProbedPixels(document, samples)
    if isinstance(samples, TexelSamples):
        return ProbedTexels(document, samples)
    if isinstance(samples, RangeSamples):
        return ProbedRange(document, samples)
    return ProbedVertices(document, cast("VertexSamples", samples), whole=whole)
