"""The command `beltrami report`."""

from __future__ import annotations

from typing import Any

import click

from beltrami_cli.cli import options
from beltrami_cli.cli.command import command, complete_files
from beltrami_cli.cli.console import Messages
from beltrami_cli.cli.parameter_options import options_of
from beltrami_cli.cli.phrases import counted, output_name
from beltrami_cli.layers.settings import SmoothSettings


@command("report", before="BEFORE", after="AFTER", target="OUT.html")
@click.option(
    "--parameters", metavar="FILE.json", shell_complete=complete_files,
    help="Also show the parameters, from what `beltrami smooth --report` wrote.",
)  # fmt: skip
@click.option(
    "--full-size", is_flag=True,
    help="Keep pictures at full size, to zoom as far as single texels, however large the page becomes.  "
    "[default: at most 8 MB]",
)  # fmt: skip
@options_of(SmoothSettings, only=("on", "slots", "space"), changed=options.COMPARED)
@options.writing
def report(
    before: str,
    after: str,
    target: str,
    parameters: str | None,
    full_size: bool,
    messages: Messages,
    **values: Any,
) -> None:
    """Write a page that shows what changed from BEFORE to AFTER, two models or images that differ in colours only."""
    from beltrami_cli.view.report import report_file

    settings = options.compared_from(values)
    with options.job_from(values, before, messages) as job:
        found = report_file(
            before, after, target, settings, parameters=parameters, full_size=full_size, job=job
        )
    for notice in found["notices"]:
        messages.warn(notice)
    messages.say(f"{output_name(target)}: {counted(found['samples'], 'sample')}, {_result(found)}")


def _result(found: dict[str, Any]) -> str:
    if not found["samples"]:
        return "so no colours are compared"
    if found["psnr"] is None:
        return "whose colours are equal" if found["notices"] else "nothing differs"
    return f"{found['psnr']:.2f} dB from one to the other"
