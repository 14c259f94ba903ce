"""The command `beltrami level`."""

from __future__ import annotations

from functools import partial
from typing import Any

from beltrami_cli.cli import options, outputs
from beltrami_cli.cli.command import command
from beltrami_cli.cli.console import Messages
from beltrami_cli.cli.parameter_options import options_of, record_from
from beltrami_cli.cli.phrases import head_of_result
from beltrami_cli.layers.settings import LevelSettings, SmoothSettings


@command("level", source="INPUT", target="OUTPUT")
@options_of(LevelSettings)
@options_of(
    SmoothSettings, only=(*options.TEXTURES, *options.ENCODING, "alpha"), changed=options.SPACE_WITHOUT_OKLAB
)
@outputs.previewed_result
def level(source: str, target: str, messages: Messages, **values: Any) -> None:
    """Remove the exposure steps between the charts of the textures of INPUT, and write OUTPUT."""
    levelling = record_from(LevelSettings, values)
    settings = record_from(SmoothSettings, values)
    from beltrami_cli.jobs.level import level_file

    carry_out = partial(level_file, source, target, levelling, settings)
    report = outputs.run_and_write(values, (source, target), messages, carry_out, settings)
    messages.warn_of(source, report.warnings)
    outputs.show_levelled(messages, report.levelled, head_of_result(target, dry_run=values["dry_run"]))
