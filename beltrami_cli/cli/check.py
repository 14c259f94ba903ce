"""The command `beltrami check`."""

from __future__ import annotations

import json
from typing import Any

import click

from beltrami_cli.cli import options
from beltrami_cli.cli.commands import HelpfulCommand
from beltrami_cli.cli.console import counted, printable

EPILOG = """\b
Examples:
  beltrami check scan.ply clean.ply
  beltrami check scan.glb clean.glb --json | jq .differences
  beltrami check scan.obj clean.obj -q && echo nothing but colours differs

\b
Exit codes: 0 nothing but colours and images differs; 1 something else does; otherwise as `beltrami`.
"""


@click.command("check", cls=HelpfulCommand, epilog=EPILOG)
@click.argument("before", metavar="BEFORE")
@click.argument("after", metavar="AFTER")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@options.reading
@options.quiet
@options.verbose
def command(before: str, after: str, as_json: bool, quiet: bool, verbose: int, **reading: Any) -> int:
    """List what differs between two files of a format, to prove that AFTER is BEFORE with other colours.

    Colours and the pixels of images may differ. Anything else is an error: positions, faces, materials, names,
    comments, whatever the format holds. So is an image whose colours under an alpha of 0 were cleared.
    """
    from beltrami_cli.jobs.check import check_files

    with options.reading_from(reading, before) as access:
        report = check_files(before, after, access)
    if as_json:
        from dataclasses import asdict

        click.echo(json.dumps({**asdict(report), "faithful": report.faithful}, indent=2))
    elif not quiet:
        for difference in report.differences:
            mark = "colour" if difference.of_colour else "OTHER"
            click.echo(printable(f"{mark:>6}  {difference.what}: {difference.detail}"))
        click.echo(_summary(sum(not each.of_colour for each in report.differences), len(report.differences)))
    return 0 if report.faithful else 1


def _summary(others: int, differences: int) -> str:
    if others:
        verb = "differs" if others == 1 else "differ"
        return f"{counted(others, 'thing')} besides colours {verb}"
    return "nothing else differs" if differences else "nothing differs"
