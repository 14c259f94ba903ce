"""The command `beltrami render`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import click

from beltrami_cli.cli import options
from beltrami_cli.cli.commands import HelpfulCommand
from beltrami_cli.cli.console import Messages
from beltrami_cli.errors import UsageError
from beltrami_cli.view.settings import VIEWS, RenderSettings

EPILOG = """\b
Examples:
  beltrami render scan.ply scan.png                                   from the front
  beltrami render scan.ply scan.png --view three-quarter --lit        from above and the right, with light
  beltrami render noisy.glb clean.glb both.png --crop auto            side by side, with a detail
  beltrami render a.ply b.ply ab.png --label before --label after --crop 0.4,0.3,0.1 --crop 0.6,0.7
  beltrami render model.obj around.png --turntable 8 --size 300       eight views all around
  beltrami render model.obj turning.gif --turntable 24 --lit          one that turns; .webp and .mp4 likewise
  beltrami render room.ply room.png --up z --azimuth 120 --elevation 45
  beltrami render photo.png clean.png photos.png --crop auto,0.1      images, unchanged, with a detail
  beltrami render model.glb icon.png --size 128 --background transparent

\b
Needs no screen and no graphics card. For surfaces it needs a package: pip install 'beltrami-cli[render]'.
Models that lie in one place are seen by one camera. Colours are linear while they are lit and averaged, and
sRGB in OUT; factors of materials and reflections are not shown.
"""


view = click.option(
    "--view", type=click.Choice(list(VIEWS)), default="front", show_default=True,
    help="Where the eye is; y points up, and the front looks along z, unless --up says otherwise.",
)  # fmt: skip


def render_settings_from(values: Mapping[str, Any], **made: Any) -> RenderSettings:
    """Make the settings of pictures from the values of `view` and options of `RenderSettings`."""
    for name, angle in zip(("azimuth", "elevation"), VIEWS[values["view"]], strict=True):
        if values[name] is None:
            made[name] = angle
    return options.record_from(RenderSettings, values, **made)


@click.command("render", cls=HelpfulCommand, epilog=EPILOG)
@click.argument("sources", nargs=-1, required=True, metavar="FILE...")
@click.argument("target", metavar="OUT.png")
@view
@options.options_of(RenderSettings)
@click.option("--no-labels", is_flag=True, help="No words in the picture.")
@options.writing
def command(
    sources: tuple[str, ...], target: str, no_labels: bool, messages: Messages, **values: Any
) -> None:
    """Draw each FILE, a model, points or an image, and write all as one picture.

    Textures and vertex colours are shown as a viewer shows them, unlit unless --lit is given: it is the colours
    that are to be judged.
    """
    if values["labels"] and no_labels:
        raise UsageError("--label and --no-labels contradict each other")
    settings = render_settings_from(values, **({"labels": ()} if no_labels else {}))
    from beltrami_cli.view.render import render_file

    with options.job_from(values, sources[0], messages) as job:
        width, height = render_file(sources, target, settings, job)
    messages.say(f"{target}: {width} x {height} pixels")
