"""Smooth a file with several sets of parameters, and show what each makes of it."""

from __future__ import annotations

import dataclasses
import html
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.access import Access, read_source
from beltrami_cli.formats.document import Written
from beltrami_cli.formats.image.recognition import FORMATS, format_of_suffix
from beltrami_cli.formats.registry import OUTPUT_FORMATS, kind_of
from beltrami_cli.jobs.compare.files import compare_files
from beltrami_cli.jobs.job import PLAIN_JOB, Job, tracked
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.jobs.writing.output import Output
from beltrami_cli.samples.settings import DEFAULTS, LevelSetSettings
from beltrami_cli.view.drawing import background_of, draw_panels, with_fixed_crops
from beltrami_cli.view.pages import PAGES, asset, page_from, picture_tag, script_json, table
from beltrami_cli.view.render import encoded, picture_suffix
from beltrami_cli.view.settings import MOST_PIXELS, RenderSettings
from beltrami_cli.view.sheet import Panel, arranged
from beltrami_cli.view.views import open_view

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from beltrami_cli.samples.settings import SmoothSettings
    from beltrami_cli.view.sheet import Background

_FIGURES = {
    "psnr": "PSNR, dB",
    "psnr_near_seams": "PSNR near seams, dB",
    "ssim": "SSIM",
    "delta_e": "Delta E 2000",
}
MOST_TRIALS = 200


@dataclass(frozen=True)
class Trial:
    """The result of one set of the swept parameters, and its figures against a reference, if there is one."""

    parameters: dict[str, float]
    figures: dict[str, float]

    @property
    def label(self) -> str:
        """The parameters and the first figure, in short."""
        words = [f"{name} {value:g}" for name, value in self.parameters.items()] or ["smoothed"]
        return ", ".join(words) + (f": {self.figures['psnr']:.2f} dB" if "psnr" in self.figures else "")


def sweep_file(
    source: str,
    target: str,
    trials: Sequence[tuple[dict[str, float], SmoothSettings]],
    looks: RenderSettings,
    *,
    columns: int,
    reference: str | None = None,
    job: Job = PLAIN_JOB,
) -> list[Trial]:
    """Smooth a file with several settings, and write a picture, or a page (.html), of all results."""
    _check(source, len(trials), looks)
    is_page = Path(target).suffix.lower() in PAGES
    suffix = "" if is_page else picture_suffix(target, ", or .html for a page")
    known = [source] if reference is None else [source, reference]
    output = Output(target, overwrite=job.overwrite, what="sheet", reads=known)
    access = output.files.watching(job.access)
    shown = [] if reference is None else [("reference", reference, DEFAULTS)]
    shown.append(("before", source, trials[0][1]))
    panels: list[Panel] = []
    for label, path, reading in shown:
        view = open_view(path, looks, access, reading)
        if not panels:
            looks = with_fixed_crops(view, looks)
        panels += draw_panels([view], [label], looks, job.progress)
    done = []
    inner = Job(access, job.progress)
    for parameters, settings in tracked(trials, "trials", job.progress):
        trial, panel = _tried(source, parameters, settings, looks, reference, inner)
        done.append(trial)
        panels.append(panel)
    if is_page:
        output.write(Written(main=[_page(source, done, panels, looks)]))
    else:
        output.write(encoded(_sheet(panels, len(shown), columns, looks), target, suffix))
    return done


def _sheet(panels: Sequence[Panel], first: int, columns: int, looks: RenderSettings) -> NDArray[np.uint8]:
    """Arrange panels in a picture, in which those from `first` on begin in a row of their own."""
    empty = [None] * (-first % columns)
    placed = [*panels[:first], *empty, *panels[first:]]
    return arranged(placed, columns, background_of(looks, panels))


def _check(name: str, trials: int, looks: RenderSettings) -> None:
    if name == "-":
        raise UsageError("INPUT is read for each trial, so it must be a file and not a pipe")
    pixels = looks.size[0] * looks.size[1] * (trials + 2)
    if trials > MOST_TRIALS or pixels > MOST_PIXELS:
        raise UsageError(
            f"{trials} trials are too many for one sheet of {MOST_TRIALS} views; give fewer values, or lower --size"
        )


def _tried(
    source: str,
    parameters: dict[str, float],
    settings: SmoothSettings,
    looks: RenderSettings,
    reference: str | None,
    job: Job,
) -> tuple[Trial, Panel]:
    """Smooth the file once, measure and draw the result, and throw it away."""
    access = job.access
    with tempfile.TemporaryDirectory(prefix="beltrami-") as folder:
        result = str(Path(folder) / f"result{_suffix(source, access)}")
        smooth_file(source, result, settings, job=job)
        try:
            figures = {} if reference is None else _figures(reference, result, settings, access)
        except InputError as error:
            # The user knows of no result: it is unlike the reference as the source is.
            name = source if error.name == result else error.name
            raise InputError(name, error.cause, error.remedy) from error
        trial = Trial(parameters, figures)
        view = open_view(result, looks, access)
    return trial, draw_panels([view], [trial.label], looks, job.progress)[0]


def _suffix(source: str, access: Access) -> str:
    """Return the extension of results: that of the source, if its format can be written."""
    suffix = Path(source).suffix.lower()
    if kind_of(read_source(source, access), source) == "volume":
        return ".ply"
    image = format_of_suffix(suffix)
    if image is not None:
        return suffix if FORMATS[image].writable else ".png"
    return suffix if suffix.lstrip(".") in OUTPUT_FORMATS else ""


def _figures(reference: str, result: str, settings: SmoothSettings, access: Access) -> dict[str, float]:
    space = settings.space if settings.space == "data" else "srgb"
    chosen = dataclasses.replace(
        settings,
        level_set=LevelSetSettings(),
        kernel=KernelParameters(threads=settings.kernel.threads),
        space=space,
    )
    overall = compare_files(reference, result, settings=chosen, job=Job(access)).overall
    found = {
        "psnr": overall["psnr"],
        "psnr_near_seams": (overall["near_seams"] or {}).get("psnr"),
        "ssim": overall["ssim"],
        "delta_e": (overall["delta_e"] or {}).get("mean"),
    }
    return {key: float(value) for key, value in found.items() if value is not None}


def best_of(trials: Sequence[Trial]) -> int | None:
    """Return the number of the trial with the highest PSNR, or None without a reference."""
    known = [
        (trial.figures["psnr"], -number) for number, trial in enumerate(trials) if "psnr" in trial.figures
    ]
    return -max(known)[1] if known else None


def _page(name: str, trials: Sequence[Trial], panels: Sequence[Panel], looks: RenderSettings) -> bytes:
    best = best_of(trials)
    marked = None if best is None else len(panels) - len(trials) + best
    background = background_of(looks, panels)
    views = [_view(panel, background, is_best=number == marked) for number, panel in enumerate(panels)]
    summary = f"{len(trials)} trials."
    if best is not None:
        summary += f" Best: {html.escape(trials[best].label)}."
    return page_from(
        "sweep.html",
        title=html.escape(f"Sweep of {Path(name).name}"),
        style=asset("style.css"),
        summary=summary,
        figures="\n".join(views),
        table=table(_rows(trials)),
        json=script_json([dataclasses.asdict(trial) for trial in trials]),
    )


def _view(panel: Panel, background: Background, *, is_best: bool) -> str:
    """Return a view as an element of a page, with its label as text."""
    picture = arranged([dataclasses.replace(panel, label="")], 1, background)
    mark = ' class="best"' if is_best else ""
    caption = f"<figcaption>{html.escape(panel.label)}</figcaption>"
    return f"<figure{mark}>{picture_tag(picture, panel.label)}{caption}</figure>"


def _rows(trials: Sequence[Trial]) -> list[list[str]]:
    """Return the parameters and figures of all trials, below their names."""
    parameters = sorted({key for trial in trials for key in trial.parameters})
    figures = [key for key in _FIGURES if any(key in trial.figures for trial in trials)]
    rows = [[*parameters, *(_FIGURES[key] for key in figures)]]
    for trial in trials:
        cells = [f"{trial.parameters[key]:g}" for key in parameters]
        rows.append(cells + [f"{trial.figures[key]:.3f}" if key in trial.figures else "" for key in figures])
    return rows
