"""Smooth a file with several sets of parameters, and show the results, on a page while they are computed."""

from __future__ import annotations

import contextlib
import csv
import dataclasses
import io
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from beltrami_cli.arrays import Uint8s
from beltrami_cli.errors import OutputError, UsageError
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.changes import Written
from beltrami_cli.formats.document import Document
from beltrami_cli.jobs.compare.files import compare_documents, open_both, require_samples
from beltrami_cli.jobs.file_job import open_input
from beltrami_cli.jobs.job import PLAIN_JOB, Job
from beltrami_cli.jobs.progress import Progress, each_with_progress
from beltrami_cli.jobs.recolour import recolour_in_memory
from beltrami_cli.jobs.smoothing import Smoothed, Smoothing
from beltrami_cli.jobs.writing.output import Output
from beltrami_cli.layers.settings import LevelSetSettings, SmoothSettings
from beltrami_cli.view.pages import PAGES, data_address, page_from
from beltrami_cli.view.panels import Panel, arranged, draw_panels, fixed_looks
from beltrami_cli.view.render import encoded, picture_suffix
from beltrami_cli.view.settings import MAX_PIXELS, RenderSettings
from beltrami_cli.view.views import require_memory_to_draw, view_of

Tried = tuple[dict[str, float], SmoothSettings]

FigureFormat = Literal["csv", "json"]

MAX_TRIALS = 200
FIGURES = {
    "psnr": "PSNR, dB",
    "estimated_psnr": "estimated PSNR, dB",
    "estimated_gain": "estimated gain, dB",
    "psnr_near_seams": "PSNR near seams, dB",
    "ssim": "SSIM",
    "delta_e": "Delta E 2000",
}
_REWRITE_FACTOR = 10  # time between two writes of the page, in times that the last write took


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
    """Smooth a file with several settings, and write a picture, a page, which grows as results come, or the figures."""
    _check(source, len(trials), looks if kind is None else None)
    is_page = Path(target).suffix.lower() in PAGES
    others = ", or .html for a page, or give --format csv"
    suffix = "" if is_page or kind else picture_suffix(target, looks, others)
    known = [name for name in (source, reference) if name is not None]
    output = Output(target, overwrite=job.overwrite, is_text=kind is not None, what="sheet", reads=known)
    job = Job(output.files.watching(job.access), job.progress)
    opened = _opened(source, reference, trials[0][1], job)
    sheet = None
    if kind is None:
        require_memory_to_draw([*opened.values()], looks, job.access)
        labels = [Trial(parameters, {}).label for parameters, _ in trials]
        sheet = _Sheet(f"Sweep of {Path(source).name}", labels, looks, output if is_page else None)
    done: list[Trial] = []
    opened = {label: document.keeping_images() for label, document in opened.items()}
    with sheet or contextlib.nullcontext():
        if sheet is not None:
            for label, shown in opened.items():
                sheet.add(label, shown)
        for (parameters, settings), progress in each_with_progress(trials, "trials", job.progress):
            figures, result = _tried(opened, settings, Job(job.access, progress))
            done.append(Trial(parameters, figures))
            if sheet is not None:
                sheet.add_trial(done[-1], result, progress)
    if sheet is None:
        output.write(Written(main=[_table(done, kind).encode()]))
    elif not is_page:
        output.write(encoded(sheet.picture(columns), target, suffix))
    return done


def _check(name: str, trials: int, looks: RenderSettings | None) -> None:
    if name == "-":
        raise UsageError("INPUT is shown with each trial, so it must be a file and not a pipe")
    pixels = 0 if looks is None else looks.size[0] * looks.size[1] * (trials + 2)
    if trials > MAX_TRIALS or pixels > MAX_PIXELS:
        cause = f"{trials} trials are too many for one sheet of {MAX_TRIALS} views"
        raise UsageError(f"{cause}; give fewer values, or lower --size")


def _opened(source: str, reference: str | None, settings: SmoothSettings, job: Job) -> dict[str, Document]:
    """Open the documents that are shown beside the trials, by label."""
    if reference is None:
        return {"before": open_input(source, settings, job.access)}
    truth, document = open_both((reference, source), settings, job)
    return {"reference": truth, "before": document}


def _tried(
    opened: Mapping[str, Document], settings: SmoothSettings, job: Job
) -> tuple[dict[str, float], Document]:
    """Smooth with some settings; return also the figures of the result."""
    result, results = recolour_in_memory(opened["before"], settings, Smoothing.of(settings), job)
    figures = _estimates(results)
    if "reference" in opened:
        figures = _figures(opened["reference"], result, settings, job) | figures
    return figures, result


def _estimates(results: Sequence[Smoothed]) -> dict[str, float]:
    choice = results[0].report.choice if results else None
    found = {} if choice is None else {"estimated_psnr": choice["psnr"], "estimated_gain": choice["gain"]}
    return {key: float(value) for key, value in found.items() if value is not None}  # type: ignore[arg-type]


def _figures(truth: Document, result: Document, settings: SmoothSettings, job: Job) -> dict[str, float]:
    chosen = dataclasses.replace(
        settings, level_set=LevelSetSettings(), kernel=KernelParameters(threads=settings.kernel.threads),
        space=settings.space if settings.space == "data" else "srgb",
    )  # fmt: skip
    compared = compare_documents((truth, result), chosen, "uniform", Job(job.access))
    require_samples(compared.parts, truth.name)
    overall = compared.overall()
    found = {
        "psnr": overall["psnr"],
        "psnr_near_seams": (overall["near_seams"] or {}).get("psnr"),
        "ssim": overall["ssim"],
        "delta_e": (overall["delta_e"] or {}).get("mean"),
    }
    return {key: value for key, value in found.items() if value is not None}


def _table(trials: Sequence[Trial], kind: FigureFormat | None) -> str:
    if kind == "json":
        return json.dumps([dataclasses.asdict(trial) for trial in trials], indent=2) + "\n"
    parameters, found = columns_of(trials)
    text = io.StringIO()
    writer = csv.DictWriter(text, [*parameters, *found], lineterminator="\n")
    writer.writeheader()
    writer.writerows({**trial.parameters, **trial.figures} for trial in trials)
    return text.getvalue()


@dataclass(frozen=True)
class Trial:
    """The result of one set of the swept parameters: figures against a reference if there is one, and estimates."""

    parameters: dict[str, float]
    figures: dict[str, float]

    @property
    def label(self) -> str:
        words = [f"{name} {value:g}" for name, value in self.parameters.items()] or ["default"]
        return ", ".join(words) + (f": {self.figures['psnr']:.2f} dB" if "psnr" in self.figures else "")


def best_of(trials: Sequence[Trial]) -> int | None:
    """Return the index of the trial with the highest PSNR; None without a reference."""
    known = [number for number, trial in enumerate(trials) if "psnr" in trial.figures]
    return max(known, key=lambda number: trials[number].figures["psnr"], default=None)


def columns_of(trials: Sequence[Trial]) -> tuple[list[str], list[str]]:
    """Return the parameters and the known figures."""
    parameters = sorted({key for trial in trials for key in trial.parameters})
    return parameters, [key for key in FIGURES if any(key in trial.figures for trial in trials)]


class _Sheet:
    """Views of the inputs and the results, drawn as they come: for a picture, or for a page.

    As a context it sees that all is on the page at its end, or what there is if it ends early.
    """

    def __init__(self, title: str, labels: Sequence[str], looks: RenderSettings, page: Output | None) -> None:
        self._title, self._labels, self._looks, self._page = title, labels, looks, page
        self._trials: list[Trial] = []
        self._panels: list[Panel] = []  # the panels of trials are last
        self._pictures: list[tuple[int, int, str]] = []  # width, height and address of each panel on the page
        self._next = 0.0  # time of the next write of the page, so that writing takes little of the time

    def __enter__(self) -> _Sheet:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None:
            self._write("")
        elif self._next:
            with contextlib.suppress(OutputError):  # the error that ended the sweep is reported
                self._write("not tried")

    def add(self, label: str, document: Document, progress: Progress | None = None) -> None:
        """Draw a document; the first one determines the places of details and the background."""
        (panel,) = draw_panels([view_of(document, self._looks)], [label], self._looks, progress)
        self._looks = fixed_looks(self._looks, panel)
        self._panels.append(panel)
        if self._page is not None:
            picture = arranged([[dataclasses.replace(panel, label="")]], self._looks.background_colour())
            self._pictures.append((picture.shape[1], picture.shape[0], data_address(picture)))

    def add_trial(self, trial: Trial, result: Document, progress: Progress | None) -> None:
        self.add(trial.label, result, progress)
        self._trials.append(trial)
        is_due = len(self._trials) < len(self._labels) and time.monotonic() >= self._next
        if is_due and self._page is not None and not self._page.is_device:
            began = time.monotonic()
            self._write("pending")
            self._next = time.monotonic() + _REWRITE_FACTOR * (time.monotonic() - began)

    def picture(self, columns: int) -> Uint8s:
        """Arrange the views in a picture; trials after the default begin a new row."""
        first = len(self._panels) - len(self._trials) + 1
        placed = [*self._panels[:first], *[None] * (-first % columns), *self._panels[first:]]
        placed += [None] * (-len(placed) % columns)
        rows = [placed[at : at + columns] for at in range(0, len(placed), columns)]
        return arranged(rows, self._looks.background_colour())

    def _write(self, state: str) -> None:
        """Write the page; `others`: state of the trials without a result."""
        if self._page is None:
            return
        parameters, found = columns_of(self._trials)
        trials, best = self._trials, best_of(self._trials)
        first = len(self._panels) - len(trials)
        labels = [panel.label for panel in self._panels[:first]]
        page = page_from(
            "sweep.html",
            ["sweep.js"],
            {"trials": [dataclasses.asdict(trial) for trial in trials]},
            title=self._title,
            state=state,
            count=len(self._labels),
            swept=parameters,
            sorts={key: FIGURES[key] for key in found},
            best=None if best is None else trials[best],
            inputs=zip(labels, self._pictures, strict=False),
            results=[*zip(trials, self._pictures[first:], strict=True)],
            missing=self._labels[len(trials) :],
        )
        self._page.write(Written(main=[page]))
