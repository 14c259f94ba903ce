"""The command `beltrami level`."""

from __future__ import annotations

from functools import partial
from typing import Any

import click

from beltrami_cli.cli import options
from beltrami_cli.cli.commands import HelpfulCommand
from beltrami_cli.cli.console import Messages
from beltrami_cli.cli.smooth import besides, show_levelled, written
from beltrami_cli.layers.settings import LevelSettings, SmoothSettings

EPILOG = """\b
Examples:
  beltrami level photoscan.obj level.obj                     visible patches gone, if exposure made them
  beltrami level photoscan.obj level.obj --preview look.png  before and after in a picture
  beltrami level scan.glb level.glb --strength 0.5           half of the way
  beltrami level scan.glb level.glb --report run.json        exposures of all charts, with their numbers
  beltrami level scan.glb level.glb --reference 12           chart 12 stays, and the others are matched to it
  beltrami level model.obj level.obj --reference "front*"    so do all on textures or materials of such names
  beltrami level cloud.ply level.ply --photographs camera    vertex colours, by an attribute
  beltrami smooth photoscan.obj clean.obj --level            level, and then smooth across the seams
  beltrami batch scans --out-dir clean --level -n 0          level many files, and do not smooth them

\b
Each chart gets one gain and one offset a channel, or a gain that changes linearly over it. A step at a seam is taken
for exposure if charts explain it: gains fitted to some seams must predict the steps at the others. Else it is paint,
and stays; if all of them are, OUTPUT is INPUT. See docs/levelling.md.
"""


@click.command("level", cls=HelpfulCommand, epilog=EPILOG)
@click.argument("source", metavar="INPUT")
@click.argument("target", metavar="OUTPUT")
@options.options_of(LevelSettings)
@options.options_of(
    SmoothSettings, only=(*options.TEXTURES, *options.ENCODING, "alpha"), changed=options.UNMIXED
)
@options.output_format
@options.reading
@options.overwrite
@besides
@options.messages
def command(source: str, target: str, messages: Messages, **values: Any) -> None:
    """Take the exposure steps between the charts of INPUT out of its textures, and write OUTPUT.

    Charts from photographs of differing exposure meet in steps. Gains and offsets, which may change smoothly over a
    chart, make colours agree across seams; where a step is painted it stays, and with it all of a model that has no
    exposure steps. The mean colour stays. INPUT and OUTPUT are what `beltrami smooth` takes and writes, and nothing but
    colours changes. Vertex colours are levelled where an attribute says which photograph each is from.
    """
    wanted = options.record_from(LevelSettings, values)
    del values["strength"]  # which is another parameter where colours are smoothed
    settings = options.record_from(SmoothSettings, values)
    from beltrami_cli.jobs.level import level_file

    carry_out = partial(level_file, source, target, wanted, settings)
    report = written(values, (source, target), settings, messages, carry_out)
    messages.warn_of(source, report.warnings)
    unwritten = "not written (dry run), " if values["dry_run"] else ""
    show_levelled(messages, report.levelled, f"{target}: {unwritten}")
