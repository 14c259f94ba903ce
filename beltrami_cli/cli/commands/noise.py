"""The command `beltrami noise`."""

from __future__ import annotations

from functools import partial
from typing import Any

from beltrami_cli.cli import options, outputs
from beltrami_cli.cli.command import command
from beltrami_cli.cli.console import Messages
from beltrami_cli.cli.parameter_options import options_of, record_from
from beltrami_cli.cli.phrases import counted, output_name
from beltrami_cli.jobs.settings import NoiseSettings
from beltrami_cli.layers.settings import SmoothSettings


@command("noise", source="INPUT", target="OUTPUT")
@options_of(NoiseSettings)
@options_of(SmoothSettings, only=(*options.COLOURS, *options.ENCODING), changed=options.SPACE_WITHOUT_OKLAB)
@outputs.result
def noise(source: str, target: str, messages: Messages, **values: Any) -> None:
    """Add noise to the colours of INPUT, and write OUTPUT with nothing else changed: for tests and demonstrations."""
    settings = record_from(SmoothSettings, values)
    noise = record_from(NoiseSettings, values)
    from beltrami_cli.jobs.noise.file import noise_file

    report = outputs.run_and_write(
        values, (source, target), messages, partial(noise_file, source, target, noise, settings)
    )
    messages.warn_of(source, report.warnings)
    for added in report.added:
        messages.say(
            f"{output_name(target)}: {added.what}, {counted(added.samples, 'sample')}, {noise.kind} noise, "
            f"root mean square change {255 * added.rms:.1f}/255, seed {noise.seed}"
        )
    if not report.added:
        messages.say(f"{output_name(target)}: no noise, so the colours are unchanged")
