"""Smooth a file with several sets of parameters, and show the results, on a page while they are computed."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

from beltrami_cli.errors import UsageError
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.changes import Written
from beltrami_cli.formats.document import Document
from beltrami_cli.jobs.compare.documents import compare_documents, open_both, require_samples
from beltrami_cli.jobs.job import PLAIN_JOB, Job
from beltrami_cli.jobs.opening import open_input
from beltrami_cli.jobs.progress import each_with_progress
from beltrami_cli.jobs.recolour import recolour_in_memory
from beltrami_cli.jobs.smoothing import Smoothed, Smoothing
from beltrami_cli.jobs.writing.output import Output
from beltrami_cli.layers.settings import LevelSetSettings, SmoothSettings
from beltrami_cli.view.drawing.views import require_memory_to_draw
from beltrami_cli.view.pages.rendering import PAGES
from beltrami_cli.view.render import encoded, picture_suffix
from beltrami_cli.view.settings import MAX_PIXELS, RenderSettings
from beltrami_cli.view.sheet import FigureFormat, SweepSheet, Trial, table_of

Variation = tuple[dict[str, float], SmoothSettings]  # the swept parameters, and all settings with them

MAX_TRIALS = 200


def sweep_file(
    source: str,
    target: str,
    variations: Sequence[Variation],
    render_settings: RenderSettings,
    *,
    columns: int,
    reference: str | None = None,
    kind: FigureFormat | None = None,
    job: Job = PLAIN_JOB,
) -> list[Trial]:
    """Smooth a file with several settings, and write a picture, a page, which grows as results come, or the figures."""
    _check(source, len(variations), render_settings if kind is None else None)
    is_page = Path(target).suffix.lower() in PAGES
    others = ", or .html for a page, or give --format csv"
    suffix = "" if is_page or kind else picture_suffix(target, render_settings, others)
    known = [name for name in (source, reference) if name is not None]
    output = Output(target, overwrite=job.overwrite, is_text=kind is not None, what="sheet", reads=known)
    job = Job(output.files.watching(job.access), job.progress)
    opened = _opened(source, reference, variations[0][1], job)
    sheet = None
    if kind is None:
        require_memory_to_draw([*opened.values()], render_settings, job.access)
        labels = [Trial(parameters, {}).label for parameters, _ in variations]
        title = f"Sweep of {Path(source).name}"
        sheet = SweepSheet(title, labels, render_settings, output if is_page else None)
    done: list[Trial] = []
    opened = {label: document.keeping_images() for label, document in opened.items()}
    with sheet or contextlib.nullcontext():
        if sheet is not None:
            for label, shown in opened.items():
                sheet.add(label, shown)
        for (parameters, settings), progress in each_with_progress(variations, "trials", job.progress):
            figures, result = _smoothed(opened, settings, Job(job.access, progress))
            done.append(Trial(parameters, figures))
            if sheet is not None:
                sheet.add_trial(done[-1], result, progress)
    if sheet is None:
        output.write(Written(main=[table_of(done, kind).encode()]))
    elif not is_page:
        output.write(encoded(sheet.picture(columns), target, suffix))
    return done


def _check(name: str, trials: int, settings: RenderSettings | None) -> None:
    if name == "-":
        raise UsageError("INPUT is shown with each trial, so it must be a file and not a pipe")
    pixels = 0 if settings is None else settings.size[0] * settings.size[1] * (trials + 2)
    if trials > MAX_TRIALS or pixels > MAX_PIXELS:
        cause = f"{trials} trials are too many for one sheet of {MAX_TRIALS} views"
        raise UsageError(f"{cause}; give fewer values, or lower --size")


def _opened(source: str, reference: str | None, settings: SmoothSettings, job: Job) -> dict[str, Document]:
    """Open the documents that are shown next to the trials, by label."""
    if reference is None:
        return {"before": open_input(source, settings, job.access)}
    truth, document = open_both((reference, source), settings, job)
    return {"reference": truth, "before": document}


def _smoothed(
    opened: Mapping[str, Document], settings: SmoothSettings, job: Job
) -> tuple[dict[str, float], Document]:
    """Smooth with some settings; return also the figures of the result."""
    result, results, _ = recolour_in_memory(opened["before"], settings, Smoothing.of(settings), job)
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
    near_seams, delta_e = overall["near_seams"], overall["delta_e"]
    found = {
        "psnr": overall["psnr"],
        "psnr_near_seams": None if near_seams is None else near_seams["psnr"],
        "ssim": overall["ssim"],
        "delta_e": None if delta_e is None else delta_e["mean"],
    }
    return {key: value for key, value in found.items() if value is not None}
