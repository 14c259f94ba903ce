"""Smooth the colours of a file with the short-time Beltrami kernel."""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from beltrami_cli.fields import override
from beltrami_cli.jobs.job import PLAIN_JOB
from beltrami_cli.jobs.recolour import recolour
from beltrami_cli.jobs.report import SmoothReport
from beltrami_cli.jobs.stopwatch import peak_memory
from beltrami_cli.samples.selection import require_geometry, require_scale
from beltrami_cli.samples.settings import DEFAULTS, describe_settings

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from beltrami_cli.flow.beltrami_flow import FlowResult
    from beltrami_cli.formats.document import Document
    from beltrami_cli.jobs.job import Job
    from beltrami_cli.samples.reports import SamplesReport
    from beltrami_cli.samples.samples import Part, Repainted, Samples
    from beltrami_cli.samples.selection import OutputFormat, Selection
    from beltrami_cli.samples.settings import BakeSettings, SmoothSettings


@dataclass(frozen=True)
class Smoothed:
    """What smoothing makes of samples: their part of the document, what was done, and what users should know."""

    part: Part
    repainted: Repainted
    report: SamplesReport
    result: FlowResult
    warnings: list[str]


def smooth_samples(samples: Samples, progress: Callable[[int, int], None] | None = None) -> Smoothed:
    """Run the flow on samples, and put the colours back."""
    flow = samples.flow()
    result = flow.run(progress)
    report, warnings = samples.report(flow, result), samples.warnings(result)
    new = flow.manifold.new_colours()
    del flow  # before images as large are made
    repainted = samples.repaint(new)
    report = dataclasses.replace(report, change=repainted.change.summary())
    return Smoothed(samples.part, repainted, report, result, warnings)


class Smoothing:
    """A painter that smooths."""

    colours_only = False
    works_on_disk = True

    def __init__(self, settings: SmoothSettings) -> None:
        self._settings = settings
        self.changes = settings.kernel.iterations != 0
        self.done: list[Smoothed] = []

    def check(self, document: Document, selection: Selection, target: OutputFormat) -> None:
        """Raise what cannot be smoothed."""
        if self.changes:
            require_geometry(document, selection, self._settings, target)
        require_scale(document, selection)

    def paint(self, samples: Samples, progress: Callable[[int, int], None] | None) -> Repainted:
        """Smooth samples."""
        smoothed = smooth_samples(samples, progress)
        self.done.append(smoothed)
        return smoothed.repainted


def smooth_file(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    parameters: SmoothSettings = DEFAULTS,
    job: Job = PLAIN_JOB,
    *,
    unwrap: BakeSettings | None = None,
    **overrides: Any,
) -> SmoothReport:
    """Smooth the colours of a mesh file, in its vertices or textures, or of an image, and change nothing else.

    Parameters
    ----------
    source, target : path
        PLY, OBJ, glTF or GLB, or an image; "-" for standard input or output. Another extension converts.
        `source` may also be a level set on a grid (.npz, .nrrd), which is written as a mesh.
    parameters : SmoothSettings
        The kernel's parameters, the working space, and what is smoothed.
    job : Job
        What may be read, progress, and whether files are written and replaced.
    unwrap : BakeSettings, optional
        Put the colours in a new texture, smooth that, and write a new file with nothing else.
    **overrides
        Parameters by their names, such as ``iterations=3, slots=("normal",)``, in place of those in `parameters`.

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
    settings = override(parameters, **overrides)
    if unwrap is not None:
        from beltrami_cli.jobs.unwrap import smooth_unwrapped

        return smooth_unwrapped(source, target, settings, unwrap, job)
    painter = Smoothing(settings)
    made = recolour(source, target, settings, painter, job)
    # Several slots say the same of one surface.
    warnings = [
        *dict.fromkeys(made.warnings),
        *(warning for each in painter.done for warning in each.warnings),
    ]
    return make_report(
        (source, target), made.format, settings, painter.done, made.stages, made.written, warnings
    )


def make_report(
    ends: tuple[str, str],
    target_format: str,
    settings: SmoothSettings,
    done: Sequence[Smoothed],
    stages: dict[str, dict[str, float]],
    written: list[str],
    warnings: list[str],
) -> SmoothReport:
    """Put together what a job did, from `ends[0]` to `ends[1]`."""
    reports: dict[Part, list[Any]] = {"vertices": [], "textures": [], "image": []}
    for each in done:
        reports[each.part].append(each.report)
    return SmoothReport(
        input=ends[0],
        output=ends[1],
        format=target_format,
        parameters=describe_settings(settings),
        vertices=next(iter(reports["vertices"]), None),
        textures=reports["textures"],
        stages=stages,
        peak_memory=peak_memory(),
        written=written,
        warnings=warnings,
        image=next(iter(reports["image"]), None),
    )
