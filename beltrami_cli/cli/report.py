"""The command `beltrami report`."""

from __future__ import annotations

from typing import Any

import click

from beltrami_cli.cli import options
from beltrami_cli.cli.commands import HelpfulCommand
from beltrami_cli.cli.console import Messages, counted
from beltrami_cli.layers.settings import SmoothSettings

EPILOG = """\b
Examples:
  beltrami report scan.ply clean.ply what-changed.html
  beltrami smooth model.glb clean.glb --report run.json && \\
    beltrami report model.glb clean.glb page.html --parameters run.json
  beltrami report photo.png clean.png photo.html               an image, with a swipe
  beltrami report model.glb clean.glb page.html --slots emissive

\b
The page holds everything that it needs, so it can be mailed or kept as an artefact of CI, and opens without a
network. The models are drawn with WebGL by three.js (MIT licence, in the package).
"""


@click.command("report", cls=HelpfulCommand, epilog=EPILOG)
@click.argument("before", metavar="BEFORE")
@click.argument("after", metavar="AFTER")
@click.argument("target", metavar="OUT.html")
@click.option(
    "--parameters", metavar="FILE.json",
    help="Also show the parameters, from what `beltrami smooth --report` wrote.",
)  # fmt: skip
@click.option(
    "--full-size", is_flag=True,
    help="Keep pictures at full size, to zoom as far as single texels, however large the page becomes.  "
    "[default: at most 8 MB]",
)  # fmt: skip
@options.options_of(SmoothSettings, only=("on", "slots", "space"), changed=options.COMPARED)
@options.writing
def command(
    before: str,
    after: str,
    target: str,
    parameters: str | None,
    full_size: bool,
    messages: Messages,
    **values: Any,
) -> None:
    """Write a page that shows what changed from BEFORE to AFTER, two models or two images that differ in colours only.

    It has both models under one camera with a swipe between them, textures with a swipe, figures, a histogram of the
    change, and a map of the seams.
    """
    from beltrami_cli.view.report import report_file

    settings = options.compared_from(values)
    with options.job_from(values, before, messages) as job:
        found = report_file(
            before, after, target, settings, parameters=parameters, full_size=full_size, job=job
        )
    for notice in found["notices"]:
        messages.warn(notice)
    messages.say(f"{target}: {counted(found['samples'], 'sample')}, {_result(found)}")


def _result(found: dict[str, Any]) -> str:
    if not found["samples"]:
        return "so no colours are compared"
    if found["psnr"] is None:
        return "whose colours are equal" if found["notices"] else "nothing differs"
    return f"{found['psnr']:.2f} dB from one to the other"
