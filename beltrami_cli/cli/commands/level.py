"""The command `beltrami level`."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from beltrami_cli.cli import options, outputs
from beltrami_cli.cli.command import command
from beltrami_cli.cli.console import Messages
from beltrami_cli.cli.parameter_options import options_of, record_from
from beltrami_cli.cli.phrases import counted, head_of_result
from beltrami_cli.layers.settings import LevelSettings, SmoothSettings

if TYPE_CHECKING:
    from beltrami_cli.layers.reports import LevelReport


@command("level", source="INPUT", target="OUTPUT")
@options_of(LevelSettings)
@options_of(
    SmoothSettings, only=(*options.TEXTURES, *options.ENCODING, "alpha"), changed=options.SPACE_WITHOUT_OKLAB
)
@options.output_format
@options.reading
@options.overwrite
@outputs.dry_run
@outputs.report
@outputs.preview
@options.messages
def level(source: str, target: str, messages: Messages, **values: Any) -> None:
    """Remove the exposure steps between the charts of the textures of INPUT, and write OUTPUT."""
    levelling = record_from(LevelSettings, values)
    settings = record_from(SmoothSettings, values)
    from beltrami_cli.jobs.level import level_file

    carry_out = partial(level_file, source, target, levelling, settings)
    report = outputs.run_and_write(values, (source, target), messages, carry_out, settings)
    messages.warn_of(source, report.warnings)
    show_levelled(messages, report.levelled, head_of_result(target, dry_run=values["dry_run"]))


def show_levelled(messages: Messages, reports: Sequence[LevelReport], name: str) -> None:
    """Report for each slot what was done about exposure steps, or why nothing was done."""
    for each in reports:
        seams = f"{each.what}, {counted(each.charts, 'chart')}, {counted(each.seams, 'seam')} between them"
        if not each.levelled:
            step = f", median step {255 * each.before:.1f}/255" if each.seams else ""
            messages.say(f"{name}{seams}{step}: left as they are; {each.reason}")
            continue
        how = "gains that fall off over charts, and offsets" if each.tilted else "gains and offsets"
        mean = f", mean change {255 * each.change['mean']:.1f}/255" if each.change else ""
        steps = f"median step {255 * each.before:.1f}/255, now {255 * each.after:.1f}/255"
        messages.say(f"{name}{seams}, {steps}, by {how}{mean}")
        messages.detail(
            f"{each.stepped} of the seams had a step, {each.painted} of all are edges of colour; "
            f"one exposure per chart explains {100 * each.explained:.0f} % of the steps at seams that were held out"
        )
