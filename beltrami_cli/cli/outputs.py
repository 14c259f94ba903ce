"""How commands write OUTPUT, with a report and a preview if they are asked for, and what they say of it."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from beltrami_cli.cli import options
from beltrami_cli.cli.command import complete_files
from beltrami_cli.cli.console import Messages
from beltrami_cli.cli.parameter_options import typed_parameters
from beltrami_cli.cli.phrases import counted, output_name
from beltrami_cli.errors import OutputError, UsageError
from beltrami_cli.jobs.job import Job
from beltrami_cli.layers.settings import DEFAULTS, SmoothSettings

if TYPE_CHECKING:
    from beltrami_cli.jobs.file_job import FileReport
    from beltrami_cli.jobs.writing.output import Output
    from beltrami_cli.layers.reports import LevelReport
    from beltrami_cli.view.before_after import Preview

Report = TypeVar("Report", bound="FileReport")

# The first lines of a report as JSON.
_REPORT_HEAD = re.compile(rb'\{\n  "input": ".*",\n  "output": ".*",\n  "format": "\w+",\n  "parameters": \{')
_LOSSY = {"jpeg", "webp", "avif", "ktx2"}  # which --jpeg-quality is for

_dry_run = click.option("--dry-run", is_flag=True, help="Compute and report, but write no OUTPUT.")
_report = click.option(
    "--report", "report_path", metavar="FILE.json", shell_complete=complete_files,
    help="Write parameters, counts and changes; - prints them.",
)  # fmt: skip
_preview = click.option(
    "--preview", "preview_path", metavar="FILE.png", shell_complete=complete_files,
    help="Draw INPUT and OUTPUT side by side, with a detail; `beltrami render` draws others.",
)  # fmt: skip


def result(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of a command that reads INPUT and writes OUTPUT and a report, for `run_and_write`."""
    return options.output_format(options.as_json(_report(options.writing(command))))


def previewed_result(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of `result`, --dry-run and --preview."""
    further = _dry_run(options.as_json(_report(_preview(options.messages(command)))))
    return options.output_format(options.reading(options.overwrite(further)))


def run_and_write(
    values: Mapping[str, Any], ends: tuple[str, str], messages: Messages, carry_out: Callable[[Job], Report],
    settings: SmoothSettings = DEFAULTS,
) -> Report:  # fmt: skip
    """Carry out a job from INPUT to OUTPUT, and put all that it writes in place together; `settings`: for a preview."""
    from beltrami_cli.formats.changes import Written
    from beltrami_cli.jobs.writing.file_set import FileSet

    with options.job_from(values, ends[0], messages) as job, FileSet(ends) as files:
        job = replace(job, dry_run=values.get("dry_run", False), files=files)
        named = dict.fromkeys([values["report_path"], "-" if values["as_json"] else None])
        report_files = [_open_report(path, ends[1], job) for path in named if path is not None]
        drawn = _open_preview(values.get("preview_path"), ends, settings, job)
        result = carry_out(job if drawn is None else replace(job, check=drawn.check))
        if drawn is not None:
            drawn.draw()
        for file in report_files:
            file.write(Written(main=[(json.dumps(asdict(result), indent=2) + "\n").encode()]))
        files.commit()
    if _is_lossless(result.written) and any(each.name == "jpeg_quality" for each in typed_parameters()):
        cause = "--jpeg-quality has no effect, as images are written without loss"
        messages.warn(f"{output_name(ends[1])}: {cause}")
    return result


def _is_lossless(paths: Sequence[str]) -> bool:
    """Whether there are image files, and none in a format with a quality."""
    from beltrami_cli.formats.image.file_formats import format_of_suffix

    images = {known for path in paths if (known := format_of_suffix(Path(path).suffix))}
    return bool(images) and images.isdisjoint(_LOSSY)


def _open_report(path: str, target: str, job: Job) -> Output:
    """Check that a report can be written, before anything is computed."""
    from beltrami_cli.jobs.writing.output import Output

    if path == target == "-":
        raise OutputError("<stdout>", "the report would mix with OUTPUT", "name a file for one of them")
    replaced = options.overwrite_at("report_path", overwrite=job.overwrite)
    return Output(path, overwrite=replaced, is_text=True, what="report", is_own=is_report, files=job.files)


def is_report(head: bytes) -> bool:
    """Whether a file is a report as JSON, by its first bytes."""
    return _REPORT_HEAD.match(head) is not None


def _open_preview(
    path: str | None, names: tuple[str, str], settings: SmoothSettings, job: Job
) -> Preview | None:
    """Check that a preview of INPUT and OUTPUT can be drawn, if one is wanted, before anything is computed."""
    if path is None:
        return None
    from beltrami_cli.view.before_after import Preview

    if job.dry_run:
        raise UsageError("--preview draws OUTPUT, which --dry-run does not write")
    assert job.files is not None
    replaced = options.overwrite_at("preview_path", overwrite=job.overwrite)
    return Preview(path, *names, settings, job.access, overwrite=replaced, files=job.files)


def show_levelled(messages: Messages, reports: Sequence[LevelReport], name: str) -> None:
    """Report for each slot what was done about exposure steps, or why nothing was done."""
    for each in reports:
        seams = f"{each.what}, {counted(each.charts, 'chart')}, {counted(each.seams, 'seam')} between them"
        if not each.levelled:
            step = f", median step {255 * each.before:.1f}/255" if each.seams else ""
            messages.say(f"{name}{seams}{step}: left as they are; {each.reason}")
            continue
        how = "gains that fall off over charts, and offsets" if each.tilted else "gains and offsets"
        mean = f", mean change {255 * each.change['mean']:.1f}/255" if each.change else ""
        steps = f"median step {255 * each.before:.1f}/255, now {255 * each.after:.1f}/255"
        messages.say(f"{name}{seams}, {steps}, by {how}{mean}")
        messages.detail(
            f"{each.stepped} of the seams had a step, {each.painted} of all are edges of colour; "
            f"one exposure per chart explains {100 * each.explained:.0f} % of the steps at seams that were held out"
        )
