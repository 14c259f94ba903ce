"""The trials of a sweep, and the page that shows them: it is written anew as results come."""

from __future__ import annotations

import contextlib
import dataclasses
import html
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.errors import OutputError
from beltrami_cli.formats.document import Written
from beltrami_cli.view.drawing import background_of
from beltrami_cli.view.pages import page_from, picture_tag, table
from beltrami_cli.view.sheet import arranged

if TYPE_CHECKING:
    from collections.abc import Sequence

    from beltrami_cli.jobs.output import Output
    from beltrami_cli.view.settings import RenderSettings
    from beltrami_cli.view.sheet import Background, Panel

FIGURES = {
    "psnr": "PSNR, dB",
    "estimated_psnr": "estimated PSNR, dB",
    "estimated_gain": "estimated gain, dB",
    "psnr_near_seams": "PSNR near seams, dB",
    "ssim": "SSIM",
    "delta_e": "Delta E 2000",
}
_REST = 10  # times as long as writing the page took: until it is written again


@dataclass(frozen=True)
class Trial:
    """The result of one set of the swept parameters: figures against a reference if there is one, and estimates."""

    parameters: dict[str, float]
    figures: dict[str, float]

    @property
    def label(self) -> str:
        """The parameters and the first figure, in short."""
        words = [f"{name} {value:g}" for name, value in self.parameters.items()] or ["smoothed"]
        return ", ".join(words) + (f": {self.figures['psnr']:.2f} dB" if "psnr" in self.figures else "")


def best_of(trials: Sequence[Trial]) -> int | None:
    """Return the number of the trial with the highest PSNR, or None without a reference."""
    known = [
        (trial.figures["psnr"], -number) for number, trial in enumerate(trials) if "psnr" in trial.figures
    ]
    return -max(known)[1] if known else None


def columns_of(trials: Sequence[Trial]) -> tuple[list[str], list[str]]:
    """Return the parameters and figures that there are."""
    parameters = sorted({key for trial in trials for key in trial.parameters})
    return parameters, [key for key in FIGURES if any(key in trial.figures for trial in trials)]


class SweepPage:
    """The page of a sweep, as a context: at its end all is on it, or what there is if it ends early."""

    def __init__(self, name: str, output: Output, labels: Sequence[str], looks: RenderSettings) -> None:
        self._title, self._output, self._labels, self._looks = (
            f"Sweep of {Path(name).name}",
            output,
            labels,
            looks,
        )
        self._trials: list[Trial] = []
        self._panels: list[Panel] = []
        self._pictures: dict[tuple[int, Background], str] = {}
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
        """Write the page; `others` says what is with the trials that have no result."""
        trials, best = self._trials, best_of(self._trials)
        first, background = len(self._panels) - len(trials), background_of(self._looks, self._panels)
        views = []
        for number, panel in enumerate(self._panels):
            trial = trials[number - first] if number >= first else None
            is_best = trial is not None and number - first == best
            views.append(_view(panel, self._picture(number, background), trial, is_best=is_best))
        views += [_missing(label, others) for label in self._labels[len(trials) :]]
        sorts = "".join(
            f'<option value="{key}">{html.escape(FIGURES[key])}</option>' for key in columns_of(trials)[1]
        )
        page = page_from(
            "sweep.html",
            ["sweep.js"],
            {"trials": [dataclasses.asdict(trial) for trial in trials]},
            title=html.escape(self._title),
            state=others,
            summary=self._summary(others),
            sorts=sorts,
            views="\n".join(views),
            table=table(_rows(trials), "figures of all trials"),
        )
        self._output.write(Written(main=[page]))

    def _summary(self, others: str) -> str:
        count, best = len(self._labels), best_of(self._trials)
        done = {"pending": "so far", "not tried": "before the sweep ended early"}.get(others, "")
        said = f"{len(self._trials)} of {count} trials {done}." if done else f"{count} trials."
        return said if best is None else f"{said} Best: {html.escape(self._trials[best].label)}."

    def _picture(self, number: int, background: Background) -> str:
        """Return a view as an image element, which is made once."""
        if (number, background) not in self._pictures:
            panel = self._panels[number]
            picture = arranged([dataclasses.replace(panel, label="")], 1, background)
            self._pictures[number, background] = picture_tag(picture, panel.label)
        return self._pictures[number, background]


def _view(panel: Panel, picture: str, trial: Trial | None, *, is_best: bool) -> str:
    """Return a view as an element of a page, with its label and figures as text."""
    label = html.escape(panel.label)
    mark = ' class="best"' if is_best else ""
    kept = "" if trial is not None else f" data-kept={'before' if panel.label == 'before' else 'reference'}"
    shown = {} if trial is None else trial.figures
    rows = [f"<dt>{FIGURES[key]}</dt><dd>{shown[key]:.3f}</dd>" for key in FIGURES if key in shown]
    figures_shown = f"<dl>{''.join(rows)}</dl>" if rows else ""
    best = "<strong>best</strong> " if is_best else ""
    return (
        f'<li{mark}{kept}><button type="button">{picture}</button>'
        f"<p>{best}<span>{label}</span></p>{figures_shown}</li>"
    )


def _missing(label: str, state: str) -> str:
    return f'<li class="missing"><p><span>{html.escape(label)}</span>: {state}</p></li>'


def _rows(trials: Sequence[Trial]) -> list[list[str]]:
    """Return the parameters and figures of all trials, below their names."""
    parameters, found = columns_of(trials)
    rows = [[*parameters, *(FIGURES[key] for key in found)]]
    for trial in trials:
        cells = [f"{trial.parameters[key]:g}" for key in parameters]
        rows.append(cells + [f"{trial.figures[key]:.3f}" if key in trial.figures else "" for key in found])
    return rows
