"""The command `beltrami render`."""

from __future__ import annotations

from typing import Any

import click

from beltrami_cli.cli import options
from beltrami_cli.cli.command import command
from beltrami_cli.cli.console import Messages
from beltrami_cli.cli.parameter_options import options_of, record_from
from beltrami_cli.cli.phrases import output_name
from beltrami_cli.errors import UsageError
from beltrami_cli.view.settings import RenderSettings


@command("render", sources="FILE...", target="OUT.png")
@options_of(RenderSettings)
@click.option("--no-labels", is_flag=True, help="No words in the picture.")
@options.writing
def render(sources: tuple[str, ...], target: str, no_labels: bool, messages: Messages, **values: Any) -> None:
    """Draw each FILE, a model, points or an image, and write all as one picture."""
    if values["labels"] and no_labels:
        raise UsageError("--label and --no-labels contradict each other")
    settings = record_from(RenderSettings, values, **({"labels": ()} if no_labels else {}))
    from beltrami_cli.view.render import render_file

    with options.job_from(values, sources[0], messages) as job:
        width, height = render_file(sources, target, settings, job)
    messages.say(f"{output_name(target)}: {width} x {height} pixels")
