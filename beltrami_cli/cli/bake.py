"""The command `beltrami bake`."""

from __future__ import annotations

from typing import Any, get_args

import click

from beltrami_cli.cli import options
from beltrami_cli.cli.commands import HelpfulCommand
from beltrami_cli.cli.console import Messages, counted
from beltrami_cli.jobs.settings import BakeSettings
from beltrami_cli.layers.settings import BakeTo

EPILOG = """\b
Examples:
  beltrami bake scan.ply scan.glb --to texture              vertex colours into a new texture
  beltrami bake scan.ply scan.obj --to texture --size 2048
  beltrami bake model.glb model.ply --to vertices           a texture into vertex colours

\b
The output is a new file: the triangles, and their colours. What else INPUT holds is not in it, and said.
"""


@click.command("bake", cls=HelpfulCommand, epilog=EPILOG)
@click.argument("source", metavar="INPUT")
@click.argument("target", metavar="OUTPUT")
@click.option("--to", type=click.Choice(get_args(BakeTo)), required=True, help="Where the colours go.")
@options.options_of(BakeSettings)
@options.output_format
@options.writing
def command(source: str, target: str, to: BakeTo, messages: Messages, **values: Any) -> None:
    """Move the colours of INPUT from its vertices to a texture, or from its textures to the vertices.

    A new texture gets a new atlas. Vertices take what a renderer would show where they are; those on a seam take the
    mean of its sides, or stay split where a seam is a real colour edge.
    """
    settings = options.record_from(BakeSettings, values)
    from beltrami_cli.jobs.bake import bake_file

    with options.job_from(values, source, messages) as job:
        report = bake_file(source, target, to, settings, job)
    messages.warn_of(report.input, report.warnings)
    for path in report.written[1:]:
        messages.detail(f"written with it: {path}")
    made = ", ".join(counted(number, noun) for noun, number in report.counts.items())
    messages.say(f"{report.output}: {made}" + (f", {report.texture}" if report.texture else ""))
