"""The trials of a sweep, and its sheet: a table of their figures, or views of them in a picture or on a page."""

from __future__ import annotations

import contextlib
import csv
import dataclasses
import io
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from beltrami_cli.arrays import Uint8s
from beltrami_cli.errors import OutputError
from beltrami_cli.formats.changes import Written
from beltrami_cli.formats.document import Document
from beltrami_cli.jobs.progress import Progress
from beltrami_cli.jobs.writing.output import Output
from beltrami_cli.view.drawing.arranging import Panel, arranged
from beltrami_cli.view.drawing.panels import draw_panels, fixed_settings
from beltrami_cli.view.drawing.views import view_of
from beltrami_cli.view.pages.rendering import data_address, page_from
from beltrami_cli.view.settings import RenderSettings

FigureFormat = Literal["csv", "json"]
FIGURES = {
    "psnr": "PSNR, dB",
    "estimated_psnr": "estimated PSNR, dB",
    "estimated_gain": "estimated gain, dB",
    "psnr_near_seams": "PSNR near seams, dB",
    "ssim": "SSIM",
    "delta_e": "Delta E 2000",
}
_REWRITE_FACTOR = 10  # time between two writes of the page, in times that the last write took


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
    parameters = sorted({key for trial in trials for key in trial.parameters})
    return parameters, [key for key in FIGURES if any(key in trial.figures for trial in trials)]


def table_of(trials: Sequence[Trial], kind: FigureFormat | None) -> str:
    if kind == "json":
        return json.dumps([dataclasses.asdict(trial) for trial in trials], indent=2) + "\n"
    parameters, found = columns_of(trials)
    text = io.StringIO()
    writer = csv.DictWriter(text, [*parameters, *found], lineterminator="\n")
    writer.writeheader()
    writer.writerows({**trial.parameters, **trial.figures} for trial in trials)
    return text.getvalue()


class SweepSheet:
    """Views of the inputs and the results, drawn as they come: for a picture, or for a page.

    As a context it sees that all is on the page at its end, or what there is if it ends early.
    """

    def __init__(
        self, title: str, labels: Sequence[str], settings: RenderSettings, page: Output | None
    ) -> None:
        self._title, self._labels, self._settings, self._page = title, labels, settings, page
        self._trials: list[Trial] = []
        self._panels: list[Panel] = []  # the panels of trials are last
        self._pictures: list[tuple[int, int, str]] = []  # width, height and address of each panel on the page
        self._next = 0.0  # time of the next write of the page, so that writing takes little of the time

    def __enter__(self) -> SweepSheet:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None:
            self._write("")
        elif self._next:
            with contextlib.suppress(OutputError):  # the error that ended the sweep is reported
                self._write("not tried")

    def add(self, label: str, document: Document, progress: Progress | None = None) -> None:
        """Draw a document; the first one determines the places of details and the background."""
        (panel,) = draw_panels([view_of(document, self._settings)], [label], self._settings, progress)
        self._settings = fixed_settings(self._settings, panel)
        self._panels.append(panel)
        if self._page is not None:
            picture = arranged([[dataclasses.replace(panel, label="")]], self._settings.background_colour())
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
        return arranged(rows, self._settings.background_colour())

    def _write(self, state: str) -> None:
        """Write the page; `state`: of the trials without a result."""
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
