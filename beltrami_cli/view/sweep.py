"""Smooth a file with several sets of parameters, and show what each makes of it, on a page as results come."""

from __future__ import annotations

import contextlib
import csv
import dataclasses
import io
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from beltrami_cli.arrays import Uint8s
from beltrami_cli.errors import OutputError, UsageError
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.document import Document, Written
from beltrami_cli.formats.image.reading import pictures_kept
from beltrami_cli.jobs.compare.files import compare_documents, open_both, require_samples
from beltrami_cli.jobs.file_job import open_input
from beltrami_cli.jobs.job import PLAIN_JOB, Job, Progress
from beltrami_cli.jobs.output import Output
from beltrami_cli.jobs.progress import one_of
from beltrami_cli.jobs.recolour import recolour_in_memory
from beltrami_cli.jobs.smooth import Smoothing
from beltrami_cli.layers.settings import LevelSetSettings, SmoothSettings
from beltrami_cli.view.drawing import (
    Background,
    Panel,
    arranged,
    background_of,
    draw_panels,
    with_fixed_crops,
)
from beltrami_cli.view.pages import PAGES, data_address, page_from
from beltrami_cli.view.render import encoded, picture_suffix
from beltrami_cli.view.settings import MOST_PIXELS, RenderSettings
from beltrami_cli.view.views import Drawable, image_files, require_memory_to_draw, view_of

Tried = tuple[dict[str, float], SmoothSettings]

FigureFormat = Literal["csv", "json"]

MOST_TRIALS = 200
FIGURES = {
    "psnr": "PSNR, dB",
    "estimated_psnr": "estimated PSNR, dB",
    "estimated_gain": "estimated gain, dB",
    "psnr_near_seams": "PSNR near seams, dB",
    "ssim": "SSIM",
    "delta_e": "Delta E 2000",
}
_REST = 10  # times as long as writing the page took: until it is written again


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
    suffix = "" if is_page or kind else picture_suffix(target, ", or .html for a page")
    known = [name for name in (source, reference) if name is not None]
    output = Output(target, overwrite=job.overwrite, is_text=kind is not None, what="sheet", reads=known)
    job = Job(output.files.watching(job.access), job.progress)
    opened = _opened(source, reference, trials[0][1], job)
    document, truth = opened["before"], opened.get("reference")
    drawing = None if kind else _Drawing(looks)
    if drawing is not None:
        require_memory_to_draw([*opened.values()], looks, job.access)
    done: list[Trial] = []
    labels = [Trial(parameters, {}).label for parameters, _ in trials]
    page = SweepPage(source, output, labels, looks) if is_page and drawing is not None else None
    kept = [file for each in opened.values() for file in image_files(each)]
    with page or contextlib.nullcontext(), pictures_kept(kept):
        if drawing is not None:
            for label, shown in opened.items():
                drawing.add(label, shown)
        for (parameters, settings), progress in one_of(trials, "trials", job.progress):
            trial, result = _tried(document, truth, parameters, settings, Job(job.access, progress))
            done.append(trial)
            if drawing is not None:
                drawing.add(trial.label, result, progress)
            if page is not None and drawing is not None:
                page.show(done, drawing.panels)
    if drawing is None:
        output.write(Written(main=[_table(done, kind).encode()]))
    elif not is_page:
        output.write(encoded(_sheet(drawing.panels, len(done), columns, looks), target, suffix))
    return done


class _Drawing:
    """Draws documents that differ in colours one after the other, as they come, with one tracer."""

    def __init__(self, looks: RenderSettings) -> None:
        self.panels: list[Panel] = []
        self._looks = looks
        self._view: Drawable | None = None

    def add(self, label: str, document: Document, progress: Progress | None = None) -> None:
        """Draw a document; details lie where there is most to see in the first."""
        self._view = view_of(document, self._looks, self._view)
        if not self.panels:
            self._looks = with_fixed_crops(self._view, self._looks)
        self.panels += draw_panels([self._view], [label], self._looks, progress)


def _opened(source: str, reference: str | None, settings: SmoothSettings, job: Job) -> dict[str, Document]:
    """Return the documents that are shown besides the trials, by their labels."""
    if reference is None:
        return {"before": open_input(source, settings, job.access)}
    truth, document = open_both((reference, source), settings, job)
    return {"reference": truth, "before": document}


def _sheet(panels: Sequence[Panel], trials: int, columns: int, looks: RenderSettings) -> Uint8s:
    """Arrange panels in a picture, in which the trials after the default begin in a row of their own."""
    first = len(panels) - trials + 1
    placed = [*panels[:first], *[None] * (-first % columns), *panels[first:]]
    return arranged(placed, columns, background_of(looks, panels))


def _check(name: str, trials: int, looks: RenderSettings | None) -> None:
    if name == "-":
        raise UsageError("INPUT is shown with each trial, so it must be a file and not a pipe")
    pixels = 0 if looks is None else looks.size[0] * looks.size[1] * (trials + 2)
    if trials > MOST_TRIALS or pixels > MOST_PIXELS:
        cause = f"{trials} trials are too many for one sheet of {MOST_TRIALS} views"
        raise UsageError(f"{cause}; give fewer values, or lower --size")


def _tried(
    document: Document, truth: Document | None, parameters: dict[str, float], settings: SmoothSettings, job: Job
) -> tuple[Trial, Document]:  # fmt: skip
    result, painted = recolour_in_memory(document, settings, Smoothing.of(settings), job)
    found = {} if truth is None else _figures(truth, result, settings, job)
    for choice in [done.report.choice for done in painted][:1]:
        if choice is not None:
            found |= {"estimated_psnr": choice["psnr"], "estimated_gain": choice["gain"]}
    known = {key: float(value) for key, value in found.items() if isinstance(value, (int, float))}
    return Trial(parameters, known), result


def _figures(truth: Document, result: Document, settings: SmoothSettings, job: Job) -> dict[str, object]:
    chosen = dataclasses.replace(
        settings, level_set=LevelSetSettings(), kernel=KernelParameters(threads=settings.kernel.threads),
        space=settings.space if settings.space == "data" else "srgb",
    )  # fmt: skip
    compared = compare_documents((truth, result), chosen, "uniform", Job(job.access))
    require_samples(compared.parts, truth.name)
    overall = compared.overall()
    return {
        "psnr": overall["psnr"],
        "psnr_near_seams": (overall["near_seams"] or {}).get("psnr"),
        "ssim": overall["ssim"],
        "delta_e": (overall["delta_e"] or {}).get("mean"),
    }


def _table(trials: Sequence[Trial], kind: FigureFormat | None) -> str:
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
    """Return the number of the trial with the highest PSNR, or None without a reference."""
    known = [number for number, trial in enumerate(trials) if "psnr" in trial.figures]
    return max(known, key=lambda number: trials[number].figures["psnr"], default=None)


def columns_of(trials: Sequence[Trial]) -> tuple[list[str], list[str]]:
    """Return the parameters and figures that there are."""
    parameters = sorted({key for trial in trials for key in trial.parameters})
    return parameters, [key for key in FIGURES if any(key in trial.figures for trial in trials)]


class SweepPage:
    """The page of a sweep, as a context: at its end all is on it, or what there is if it ends early."""

    def __init__(self, name: str, output: Output, labels: Sequence[str], looks: RenderSettings) -> None:
        self._title = f"Sweep of {Path(name).name}"
        self._output, self._labels, self._looks = output, labels, looks
        self._trials: list[Trial] = []
        self._panels: list[Panel] = []
        self._pictures: dict[tuple[int, Background], tuple[int, int, str]] = {}
        self._next = 0.0  # when it is written again, so that writing takes little of the time

    def __enter__(self) -> SweepPage:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None:
            self._write("")
        elif self._next:
            with contextlib.suppress(OutputError):  # what ended it is said
                self._write("not tried")

    def show(self, trials: Sequence[Trial], panels: Sequence[Panel]) -> None:
        """Show the results so far; the panels of trials are the last."""
        self._trials, self._panels = list(trials), list(panels)
        if len(trials) < len(self._labels) and time.monotonic() >= self._next and not self._output.is_device:
            began = time.monotonic()
            self._write("pending")
            self._next = time.monotonic() + _REST * (time.monotonic() - began)

    def _write(self, others: str) -> None:
        """Write the page; `others` is the state of trials without a result."""
        trials, best = self._trials, best_of(self._trials)
        first, background = len(self._panels) - len(trials), background_of(self._looks, self._panels)
        views = []
        for number, panel in enumerate(self._panels):
            figures = trials[number - first].figures if number >= first else {}
            width, height, source = self._picture(number, background)
            views.append(
                {
                    "label": panel.label, "kept": panel.label if number < first else "", "size": (width, height),
                    "source": source, "is_best": number >= first and number - first == best,
                    "figures": {FIGURES[key]: figures[key] for key in FIGURES if key in figures},
                }
            )  # fmt: skip
        page = page_from(
            "sweep.html",
            ["sweep.js"],
            {"trials": [dataclasses.asdict(trial) for trial in trials]},
            title=self._title,
            state=others,
            summary=self._summary(others),
            sorts={key: FIGURES[key] for key in columns_of(trials)[1]},
            views=views,
            missing=self._labels[len(trials) :],
            rows=_rows(trials),
        )
        self._output.write(Written(main=[page]))

    def _summary(self, others: str) -> str:
        count, best = len(self._labels), best_of(self._trials)
        done = {"pending": "so far", "not tried": "before the sweep ended early"}.get(others, "")
        said = f"{len(self._trials)} of {count} trials {done}." if done else f"{count} trials."
        return said if best is None else f"{said} Best: {self._trials[best].label}."

    def _picture(self, number: int, background: Background) -> tuple[int, int, str]:
        """Return the width, height and address of a view, which is encoded once."""
        if (number, background) not in self._pictures:
            panel = self._panels[number]
            picture = arranged([dataclasses.replace(panel, label="")], 1, background)
            self._pictures[number, background] = picture.shape[1], picture.shape[0], data_address(picture)
        return self._pictures[number, background]


def _rows(trials: Sequence[Trial]) -> list[list[str]]:
    parameters, found = columns_of(trials)
    rows = [[*parameters, *(FIGURES[key] for key in found)]]
    for trial in trials:
        cells = [f"{trial.parameters[key]:g}" if key in trial.parameters else "default" for key in parameters]
        rows.append(cells + [f"{trial.figures[key]:.3f}" if key in trial.figures else "" for key in found])
    return rows
