"""Smooth a file with several sets of parameters, and show what each makes of it."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from beltrami_cli.errors import UsageError
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.access import read_source
from beltrami_cli.formats.document import Written
from beltrami_cli.formats.image.reading import pictures_kept
from beltrami_cli.jobs.compare.figures import figures
from beltrami_cli.jobs.compare.files import compare_documents, open_both, require_samples
from beltrami_cli.jobs.documents import open_input
from beltrami_cli.jobs.job import PLAIN_JOB, Job, tracked
from beltrami_cli.jobs.output import Output
from beltrami_cli.jobs.recolour import recolour_in_memory
from beltrami_cli.jobs.smoothing import Smoothing
from beltrami_cli.samples.settings import LevelSetSettings
from beltrami_cli.view.drawing import background_of, draw_panels, with_fixed_crops
from beltrami_cli.view.pages import PAGES
from beltrami_cli.view.render import encoded, picture_suffix
from beltrami_cli.view.settings import MOST_PIXELS, RenderSettings
from beltrami_cli.view.sheet import arranged
from beltrami_cli.view.trials import SweepPage, Trial, columns_of
from beltrami_cli.view.views import image_files, view_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from beltrami_cli.arrays import Uint8s
    from beltrami_cli.formats.document import Document
    from beltrami_cli.samples.settings import SmoothSettings
    from beltrami_cli.view.drawing import Progress
    from beltrami_cli.view.sheet import Panel
    from beltrami_cli.view.views import Drawable

    Tried = tuple[dict[str, float], SmoothSettings]

FigureFormat = Literal["csv", "json"]

MOST_TRIALS = 200


def sweep_file(
    source: str,
    target: str,
    trials: Sequence[Tried],
    looks: RenderSettings,
    *,
    columns: int,
    reference: str | None = None,
    kind: FigureFormat | None = None,
    job: Job = PLAIN_JOB,
) -> list[Trial]:
    """Smooth a file with several settings, and write a picture, a page (.html), or only the figures of all results.

    The page is written anew as results come, and stays if an error or Ctrl-C ends the sweep after the first.
    """
    _check(source, len(trials), looks if kind is None else None)
    is_page = Path(target).suffix.lower() in PAGES
    suffix = "" if is_page or kind else picture_suffix(target, ", or .html for a page")
    known = [name for name in (source, reference) if name is not None]
    output = Output(target, overwrite=job.overwrite, is_text=kind is not None, what="sheet", reads=known)
    job = Job(output.files.watching(job.access), job.progress)
    document, truth = _opened(source, reference, trials[0][1], job)
    drawing = None if kind else _Drawing(looks, job.progress)
    done: list[Trial] = []
    labels = [Trial(parameters, {}).label for parameters, _ in trials]
    page = SweepPage(source, output, labels, looks) if is_page and drawing is not None else None
    with (
        page or nullcontext(),
        pictures_kept([*image_files(document), *([] if truth is None else image_files(truth))]),
    ):
        if drawing is not None:
            drawing.add_all({"reference": truth, "before": document})
        for parameters, settings in tracked(trials, "trials", job.progress):
            trial, result = _tried(document, truth, parameters, settings, job)
            done.append(trial)
            if drawing is not None:
                drawing.add(trial.label, result)
            if page is not None and drawing is not None:
                page.show(done, drawing.panels)
    if drawing is None:
        output.write(Written(main=[_table(done, kind).encode()]))
    elif not is_page:
        output.write(encoded(_sheet(drawing.panels, len(done), columns, looks), target, suffix))
    return done


class _Drawing:
    """Draws documents that differ in colours one after the other, as they come, with one tracer."""

    def __init__(self, looks: RenderSettings, progress: Progress | None) -> None:
        self.panels: list[Panel] = []
        self._looks, self._progress = looks, progress
        self._view: Drawable | None = None

    def add_all(self, documents: Mapping[str, Document | None]) -> None:
        """Draw the documents that there are, under their labels."""
        for label, document in documents.items():
            if document is not None:
                self.add(label, document)

    def add(self, label: str, document: Document) -> None:
        """Draw a document; details lie where there is most to see in the first."""
        self._view = view_of(document, self._looks, self._view)
        if not self.panels:
            self._looks = with_fixed_crops(self._view, self._looks)
        self.panels += draw_panels([self._view], [label], self._looks, self._progress)


def _opened(
    source: str, reference: str | None, settings: SmoothSettings, job: Job
) -> tuple[Document, Document | None]:
    if reference is None:
        return open_input(source, settings, job.access), None
    data = read_source(reference, job.access), read_source(source, job.access)
    truth, document = open_both((reference, source), data, settings, job)
    return document, truth


def _sheet(panels: Sequence[Panel], trials: int, columns: int, looks: RenderSettings) -> Uint8s:
    """Arrange panels in a picture, in which the trials, which are the last, begin in a row of their own."""
    first = len(panels) - trials
    empty = [None] * (-first % columns)
    placed = [*panels[:first], *empty, *panels[first:]]
    return arranged(placed, columns, background_of(looks, panels))


def _check(name: str, trials: int, looks: RenderSettings | None) -> None:
    if name == "-":
        raise UsageError("INPUT is shown beside each trial, so it must be a file and not a pipe")
    pixels = 0 if looks is None else looks.size[0] * looks.size[1] * (trials + 2)
    if trials > MOST_TRIALS or pixels > MOST_PIXELS:
        raise UsageError(
            f"{trials} trials are too many for one sheet of {MOST_TRIALS} views; give fewer values, or lower --size"
        )


def _tried(
    document: Document,
    truth: Document | None,
    parameters: dict[str, float],
    settings: SmoothSettings,
    job: Job,
) -> tuple[Trial, Document]:
    """Smooth a document once, and measure the result."""
    painter = Smoothing(settings)
    result = recolour_in_memory(document, settings, painter, job)
    found = {} if truth is None else _figures(truth, result, settings, job)
    for choice in [done.report.choice for done in painter.done][:1]:
        if choice is not None:
            found |= {"estimated_psnr": choice["psnr"], "estimated_gain": choice["gain"]}
    known = {key: float(value) for key, value in found.items() if isinstance(value, (int, float))}
    return Trial(parameters, known), result


def _figures(truth: Document, result: Document, settings: SmoothSettings, job: Job) -> dict[str, object]:
    space = settings.space if settings.space == "data" else "srgb"
    chosen = dataclasses.replace(
        settings,
        level_set=LevelSetSettings(),
        kernel=KernelParameters(threads=settings.kernel.threads),
        space=space,
    )
    compared = compare_documents((truth, result), chosen, "uniform", Job(job.access))
    require_samples(compared.parts, truth.name)
    overall = figures(compared.measured())
    near, delta_e = overall["near_seams"], overall["delta_e"]
    return {
        "psnr": overall["psnr"],
        "psnr_near_seams": near["psnr"] if isinstance(near, dict) else None,
        "ssim": overall["ssim"],
        "delta_e": delta_e["mean"] if isinstance(delta_e, dict) else None,
    }


def _table(trials: Sequence[Trial], kind: FigureFormat | None) -> str:
    """Return parameters and figures as text."""
    if kind == "json":
        return json.dumps([dataclasses.asdict(trial) for trial in trials], indent=2) + "\n"
    parameters, found = columns_of(trials)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*parameters, *found])
    for trial in trials:
        values = [trial.parameters.get(key) for key in parameters]
        writer.writerow([*values, *(trial.figures.get(key) for key in found)])
    return text.getvalue()
