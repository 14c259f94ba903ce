"""The command `beltrami check`."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from typing import Any

import click

from beltrami_cli.cli import options
from beltrami_cli.cli.command import command
from beltrami_cli.cli.console import printable
from beltrami_cli.cli.parameter_options import options_of, record_from
from beltrami_cli.cli.phrases import counted
from beltrami_cli.layers.settings import SmoothSettings

_ONE_SCALAR = {
    "channels": {"help": "The scalar of the vertices of PLY files that was smoothed, such as quality."}
}
# Differences that are listed without -v, those besides colours first: more are of two files that are not a pair.
_LISTED = 10


@command("check", before="BEFORE", after="AFTER")
@options.as_json
@options_of(SmoothSettings, only=("channels",), changed=_ONE_SCALAR)
@options.reading
@options.quiet
@options.verbose
def check(before: str, after: str, as_json: bool, quiet: bool, verbose: int, **reading: Any) -> int:
    """List what differs between two files of a format, to prove that AFTER is BEFORE with other colours."""
    from beltrami_cli.jobs.check import check_files
    from beltrami_cli.jobs.job import Job

    with options.reading_from(reading, before) as access:
        channels = record_from(SmoothSettings, reading).channels or ()
        report = check_files(before, after, Job(replace(access, channels=channels)))
    if as_json:
        click.echo(json.dumps({**asdict(report), "faithful": report.faithful}, indent=2))
    elif not quiet:
        listed = report.differences
        if not verbose and len(listed) > _LISTED:
            listed = sorted(listed, key=lambda each: each.of_colour)[:_LISTED]
        for difference in listed:
            mark = "colour" if difference.of_colour else "OTHER"
            click.echo(printable(f"{mark:>6}  {difference.what}: {difference.detail}"))
        if more := len(report.differences) - len(listed):
            click.echo(f"{more:>6}  more; -v lists all")
        click.echo(_summary(sum(not each.of_colour for each in report.differences), len(report.differences)))
    return 0 if report.faithful else 1


def _summary(others: int, differences: int) -> str:
    if others:
        verb = "differs" if others == 1 else "differ"
        return f"{counted(others, 'thing')} besides colours {verb}"
    return "nothing else differs" if differences else "nothing differs"
