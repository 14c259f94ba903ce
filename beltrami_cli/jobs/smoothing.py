"""Smoothing as a painter, and the record of what was done to a file, which can be written as JSON."""

from __future__ import annotations

import dataclasses
import re
from dataclasses import dataclass, field
from itertools import count
from typing import TYPE_CHECKING, Any

from beltrami_cli.jobs.job import peak_memory
from beltrami_cli.jobs.level import Levelling
from beltrami_cli.samples.reports import describe_settings
from beltrami_cli.samples.selection import require_geometry, require_scale
from beltrami_cli.samples.settings import LevelSettings

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from beltrami_cli.flow.beltrami_flow import FlowResult
    from beltrami_cli.formats.document import Document
    from beltrami_cli.jobs.job import Job
    from beltrami_cli.samples.reports import ImageReport, LevelReport, SamplesReport, SlotReport, VertexReport
    from beltrami_cli.samples.samples import Part, Repainted, Samples
    from beltrami_cli.samples.selection import OutputFormat, Selection
    from beltrami_cli.samples.settings import SmoothSettings


_USUAL_TICKS = 30  # while parameters are chosen


@dataclass(frozen=True)
class Smoothed:
    """What smoothing makes of samples: their part of the document, what was done, and what users should know."""

    part: Part
    repainted: Repainted
    report: SamplesReport
    result: FlowResult
    warnings: list[str]
    levelled: LevelReport | None = None  # what was done to exposure steps before


def smooth_samples(samples: Samples, job: Job, label: str | None = None) -> Smoothed:
    """Run the flow on samples, and put the colours back; `label`: their name in progress, if not their own."""
    label = label or samples.label
    flow = samples.flow(_ticks(job.progress_of(f"{label}: choosing parameters")))
    result = flow.run(job.progress_of(label))
    report, warnings = samples.report(flow, result), samples.warnings(result)
    new = flow.manifold.new_colours()
    del flow  # before images as large are made
    repainted = samples.repaint(new)
    report = dataclasses.replace(report, change=repainted.change.summary())
    return Smoothed(samples.part, repainted, report, result, warnings)


def _ticks(progress: Callable[[int, int], None] | None) -> Callable[[], None] | None:
    """Return what reports steps whose number is not known before: their share of it and of a usual number more."""
    if progress is None:
        return None
    done = count()

    def tick() -> None:
        progress(number := next(done), number + _USUAL_TICKS)

    return tick


class Smoothing:
    """A painter that smooths."""

    colours_only = False
    works_on_disk = True

    def __init__(self, settings: SmoothSettings) -> None:
        self._settings = settings
        self._levelling = Levelling(LevelSettings()) if settings.level_seams else None
        self.changes = settings.kernel.iterations != 0 or settings.level_seams
        self.done: list[Smoothed] = []

    def check(self, document: Document, selection: Selection, target: OutputFormat) -> None:
        if self.changes:
            require_geometry(document, selection, self._settings, target)
        require_scale(document, selection)
        if self._levelling is not None:
            self._levelling.check(document, selection, target)

    def paint(self, samples: Samples, job: Job) -> Repainted:
        levelled = None if self._levelling is None else self._levelling.level(samples)
        smoothed = dataclasses.replace(smooth_samples(samples, job), levelled=levelled)
        self.done.append(smoothed)
        return smoothed.repainted


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
        levelled=[each.levelled for each in done if each.levelled is not None],
    )


_HEAD = re.compile(rb'\{\n  "input": ".*",\n  "output": ".*",\n  "format": "\w+",\n  "parameters": \{')


@dataclass(frozen=True)
class SmoothReport:
    """What was done to a file; `dataclasses.asdict` gives JSON types.

    Attributes
    ----------
    input, output, format : str
        Paths of the input and output, and the format written.
    parameters : dict
        The parameters that were requested. Those named in "free" were chosen from the data; the chosen values are in
        the records below.
    vertices : VertexReport or None
        Statistics of vertex colours, if they were smoothed.
    textures : list of SlotReport
        Statistics of each texture slot that was smoothed.
    stages : dict
        "wall" and "cpu" seconds per stage.
    peak_memory : int or None
        Peak resident size of the process in bytes.
    written : list of str
        The files that were written; none on a dry run.
    warnings : list of str
        Messages for the user.
    image : ImageReport or None
        Statistics of an image, if it was smoothed.
    levelled : list of LevelReport
        What was done to exposure steps before, if that was asked for.
    """

    input: str
    output: str
    format: str
    parameters: dict[str, object]
    vertices: VertexReport | None
    textures: list[SlotReport]
    stages: dict[str, dict[str, float]]
    peak_memory: int | None
    written: list[str]
    warnings: list[str]
    image: ImageReport | None = None
    levelled: list[LevelReport] = field(default_factory=list)


def is_report(head: bytes) -> bool:
    """Return whether a file is a `SmoothReport` as JSON, by its first bytes."""
    return _HEAD.match(head) is not None
