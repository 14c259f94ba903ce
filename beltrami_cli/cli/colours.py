"""The commands that change colours and do not smooth them: `beltrami level`, `bake` and `noise`."""

from __future__ import annotations

from functools import partial
from typing import Any, get_args

import click

from beltrami_cli.cli import options
from beltrami_cli.cli.commands import command
from beltrami_cli.cli.console import Messages, counted
from beltrami_cli.cli.smooth import besides, show_levelled, written
from beltrami_cli.jobs.job import BakeSettings, NoiseSettings
from beltrami_cli.layers.settings import BakeTo, LevelSettings, SmoothSettings


@command("level", source="INPUT", target="OUTPUT")
@options.options_of(LevelSettings)
@options.options_of(
    SmoothSettings, only=(*options.TEXTURES, *options.ENCODING, "alpha"), changed=options.UNMIXED
)
@options.output_format
@options.reading
@options.overwrite
@besides
@options.messages
def level(source: str, target: str, messages: Messages, **values: Any) -> None:
    """Remove the exposure steps between the charts of the textures of INPUT, and write OUTPUT."""
    wanted = options.record_from(LevelSettings, values)
    del values["strength"]  # which is another parameter where colours are smoothed
    settings = options.record_from(SmoothSettings, values)
    from beltrami_cli.jobs.level import level_file

    carry_out = partial(level_file, source, target, wanted, settings)
    report = written(values, (source, target), settings, messages, carry_out)
    messages.warn_of(source, report.warnings)
    unwritten = "not written (dry run), " if values["dry_run"] else ""
    show_levelled(messages, report.levelled, f"{target}: {unwritten}")


@command("bake", source="INPUT", target="OUTPUT")
@click.option("--to", type=click.Choice(get_args(BakeTo)), required=True, help="Where the colours go.")
@options.options_of(BakeSettings)
@options.output_format
@options.writing
def bake(source: str, target: str, to: BakeTo, messages: Messages, **values: Any) -> None:
    """Move the colours of INPUT from its vertices to a texture, or from its textures to the vertices."""
    settings = options.record_from(BakeSettings, values)
    from beltrami_cli.jobs.new_texture import bake_file

    with options.job_from(values, source, messages) as job:
        report = bake_file(source, target, to, settings, job)
    messages.warn_of(report.input, report.warnings)
    for path in report.written[1:]:
        messages.detail(f"written with it: {path}")
    made = ", ".join(counted(number, noun) for noun, number in report.counts.items())
    messages.say(f"{report.output}: {made}" + (f", {report.texture}" if report.texture else ""))


@command("noise", source="INPUT", target="OUTPUT")
@options.options_of(NoiseSettings)
@options.options_of(SmoothSettings, only=(*options.COLOURS, *options.ENCODING), changed=options.UNMIXED)
@options.output_format
@options.writing
def noise(source: str, target: str, messages: Messages, **values: Any) -> None:
    """Add noise to the colours of INPUT, and write OUTPUT with nothing else changed: for tests and demonstrations."""
    settings = options.record_from(SmoothSettings, values)
    noise = options.record_from(NoiseSettings, values)
    from beltrami_cli.jobs.noise import noise_file

    with options.job_from(values, source, messages) as job:
        report = noise_file(source, target, noise, settings, job)
    messages.warn_of(source, report.warnings)
    for added in report.added:
        messages.say(
            f"{target}: {added.what}, {counted(added.samples, 'sample')}, {noise.kind} noise, "
            f"root mean square change {255 * added.rms:.1f}/255, seed {noise.seed}"
        )
    if not report.added:
        messages.say(f"{target}: no noise, so the colours are unchanged")
