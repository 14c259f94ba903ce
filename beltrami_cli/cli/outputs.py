"""What `smooth` and `level` write besides OUTPUT, a report and a preview, and what they say of exposure steps."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any, TypeVar

import click
from click.core import ParameterSource

from beltrami_cli.cli import options
from beltrami_cli.cli.console import counted
from beltrami_cli.errors import OutputError, UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from beltrami_cli.cli.console import Messages
    from beltrami_cli.jobs.job import Job
    from beltrami_cli.jobs.level import LevelFileReport
    from beltrami_cli.jobs.output import Output, Overwrite
    from beltrami_cli.jobs.smoothing import SmoothReport
    from beltrami_cli.samples.reports import LevelReport
    from beltrami_cli.samples.settings import SmoothSettings
    from beltrami_cli.view.render import Preview

Report = TypeVar("Report", "SmoothReport", "LevelFileReport")

_dry_run = click.option("--dry-run", is_flag=True, help="Compute and report, but write no OUTPUT.")
_report = click.option(
    "--report", "report_path", metavar="FILE.json",
    help="Write parameters, counts, timings and changes. --overwrite replaces what is no report only if this option is "
    "on the command line, too.",
)  # fmt: skip
_preview = click.option(
    "--preview", "preview_path", metavar="FILE.png",
    help="Draw INPUT and OUTPUT side by side, with a detail; `beltrami render` draws others. It replaces files as "
    "--report does.",
)  # fmt: skip


def besides(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of a dry run, a report and a preview."""
    return _dry_run(_report(_preview(command)))


def written(
    values: Mapping[str, Any], ends: tuple[str, str], settings: SmoothSettings, messages: Messages,
    carry_out: Callable[[Job], Report],
) -> Report:  # fmt: skip
    """Carry out a job from INPUT to OUTPUT, and put all that it writes in place together; return its report."""
    from beltrami_cli.formats.document import Written
    from beltrami_cli.jobs.output import FileSet

    with (
        options.job_from(values, ends[0], messages) as job,
        messages.work_shown(wanted=messages.verbose > 0 or values["dry_run"]),
        FileSet(ends) as files,
    ):
        job = replace(job, dry_run=values["dry_run"], files=files)
        report_file = _open_report(values["report_path"], job)
        preview = _open_preview(values["preview_path"], ends, settings, job)
        report = carry_out(job)
        if preview is not None:
            preview.draw()
        if report_file is not None:
            report_file.write(Written(main=[(json.dumps(asdict(report), indent=2) + "\n").encode()]))
        files.put_in_place()
    return report


def overwrite_at(option: str, *, overwrite: bool) -> Overwrite:
    """Whether the file that an option names may be replaced.

    One that this program did not write may be only if the command line itself names it and says --overwrite.
    """
    sources = [click.get_current_context().get_parameter_source(name) for name in (option, "overwrite")]
    is_direct = all(source is ParameterSource.COMMANDLINE for source in sources)
    return "own" if overwrite and not is_direct else overwrite


def _open_report(path: str | None, job: Job) -> Output | None:
    """Check that a report can be written, if one is wanted, before anything is computed."""
    from beltrami_cli.jobs.output import Output
    from beltrami_cli.jobs.smoothing import is_report

    if path is None:
        return None
    if path == "-":
        raise OutputError(path, "the report is a file; standard output is for OUTPUT", "name a file")
    replaced = overwrite_at("report_path", overwrite=job.overwrite)
    return Output(path, overwrite=replaced, what="report", is_own=is_report, files=job.files)


def _open_preview(
    path: str | None, names: tuple[str, str], settings: SmoothSettings, job: Job
) -> Preview | None:
    """Check that a preview of INPUT and OUTPUT can be drawn, if one is wanted, before anything is computed."""
    if path is None:
        return None
    from beltrami_cli.view.render import Preview

    if job.dry_run:
        raise UsageError("--preview draws OUTPUT, which --dry-run does not write")
    assert job.files is not None
    replaced = overwrite_at("preview_path", overwrite=job.overwrite)
    return Preview(path, *names, settings, job.access, overwrite=replaced, files=job.files)


def show_levelled(messages: Messages, reports: Sequence[LevelReport], name: str) -> None:
    """Say of each slot what was done about exposure steps, and why nothing where nothing was."""
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
            f"{each.stepped} of the seams had a step, {each.painted} of all are taken for paint; fits to other seams "
            f"foretell {100 * each.foretold:.0f} % of the steps"
        )
