"""The command `beltrami noise`."""

from __future__ import annotations

from typing import Any

import click

from beltrami_cli.cli import options
from beltrami_cli.cli.commands import HelpfulCommand
from beltrami_cli.cli.console import Messages, counted
from beltrami_cli.jobs.settings import NoiseSettings
from beltrami_cli.layers.settings import SmoothSettings

EPILOG = """\b
Examples:
  beltrami noise clean.ply noisy.ply --sigma 20                     a standard deviation of 20/255
  beltrami noise clean.glb noisy.glb --sigma 8% --seed 7            textures, across their seams; other noise
  beltrami noise photo.png noisy.png --sigma 40 --kind poisson      the dark has less of it
  beltrami noise cloud.xyz noisy.xyz --sigma 5% --kind salt-pepper  one point in twenty black or white
  beltrami noise clean.glb noisy.glb --kind camera --shot 0.02      as a camera with a Bayer mosaic sees it
  beltrami noise clean.obj noisy.obj --kind grain --sigma 12 --size 3   grain that reaches over 3 texels
  beltrami noise photo.png coded.png --kind jpeg --quality 75       what JPEG leaves of it
  beltrami noise scan.ply noisy.ply --sigma 20 && beltrami smooth noisy.ply clean.ply && \\
    beltrami compare scan.ply clean.ply                             how much does smoothing restore?

\b
What --sigma S means:
  gaussian     the standard deviation of every channel, whatever the colour
  poisson      the same at full scale; it falls with the square root of the colour, as when photons are counted
  speckle      the same at full scale; it falls with the colour
  salt-pepper  the share of samples that turn black or white, half of them each
  grain        as gaussian (which white is another name of), but neighbours share it up to the distance --size

\b
What needs no --sigma:
  camera       the variance is --shot L + --read^2 of the light L, linear, from 0 to 1. In images and textures each
               pixel measures one colour, and demosaicing (bilinear, chart by chart) mixes them; vertices measure all.
  jpeg         each picture is coded and decoded at --quality with colour at half the resolution; textures as they
               lie flat. Vertex colours are no picture and are refused: bake them first.
"""


@click.command("noise", cls=HelpfulCommand, epilog=EPILOG)
@click.argument("source", metavar="INPUT")
@click.argument("target", metavar="OUTPUT")
@options.options_of(NoiseSettings)
@options.options_of(SmoothSettings, only=(*options.COLOURS, *options.ENCODING), changed=options.UNMIXED)
@options.output_format
@options.writing
def command(source: str, target: str, messages: Messages, **values: Any) -> None:
    """Add noise to the colours of INPUT, and write OUTPUT with nothing else changed: for tests and demonstrations.

    INPUT and OUTPUT are what `beltrami smooth` takes and writes. The noise is on the surface: vertices at one place get
    the same, and so do the texels around a chart and their counterparts beyond the seam. Format, type, alpha and
    metadata stay. Colours are cut off at 0 and at full scale, as in a camera, unless INPUT has some beyond.
    """
    settings = options.record_from(SmoothSettings, values)
    noise = options.record_from(NoiseSettings, values)
    from beltrami_cli.jobs.noise import noise_file

    with options.job_from(values, source, messages) as job:
        report = noise_file(source, target, noise, settings, job)
    messages.warn_of(source, report.warnings)
    for added in report.added:
        messages.say(
            f"{target}: {added.what}, {counted(added.samples, 'sample')}, "
            f"{_described(noise)}, "
            f"root mean square change {255 * added.rms:.1f}/255, seed {noise.seed}"
        )
    if not report.added:
        messages.say(f"{target}: no noise, so the colours are unchanged")


def _described(noise: NoiseSettings) -> str:
    if noise.kind == "jpeg":
        return f"coded as JPEG of quality {noise.quality}"
    if noise.kind == "camera":
        return f"camera noise of variance {noise.shot:g} L + {noise.read:g}^2"
    amount = f"{noise.kind} noise of {255 * noise.deviation:.4g}/255"
    return f"{amount}, {noise.size:g} samples wide" if noise.kind == "grain" else amount
