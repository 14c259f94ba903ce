"""The command `beltrami bake`."""

from __future__ import annotations

from functools import partial
from typing import Any, get_args

import click

from beltrami_cli.cli import outputs
from beltrami_cli.cli.command import command
from beltrami_cli.cli.console import Messages
from beltrami_cli.cli.parameter_options import options_of, record_from, refuse_typed
from beltrami_cli.cli.phrases import counted, output_name
from beltrami_cli.jobs.settings import BakeSettings, BakeTo


@command("bake", source="INPUT", target="OUTPUT")
@click.option("--to", type=click.Choice(get_args(BakeTo)), required=True, help="Where the colours go.")
@options_of(BakeSettings)
@outputs.result
def bake(source: str, target: str, to: BakeTo, messages: Messages, **values: Any) -> None:
    """Move the colours of INPUT from its vertices to a texture, or from its textures to the vertices."""
    settings = record_from(BakeSettings, values)
    if to == "vertices":
        refuse_typed(BakeSettings, "of the new texture that --to texture makes; leave it out")
    from beltrami_cli.jobs.bake import bake_file

    report = outputs.run_and_write(
        values, (source, target), messages, partial(bake_file, source, target, to, settings)
    )
    messages.warn_of(report.input, report.warnings)
    for path in report.written[1:]:
        messages.detail(f"written with it: {path}")
    made = ", ".join(counted(number, noun) for noun, number in report.counts.items())
    messages.say(f"{output_name(report.output)}: {made}" + (f", {report.texture}" if report.texture else ""))
