"""The command `beltrami kernel`."""

from __future__ import annotations

from typing import Any

import click

from beltrami_cli.cli import options
from beltrami_cli.cli.command import command
from beltrami_cli.cli.console import Messages
from beltrami_cli.cli.parameter_options import options_of
from beltrami_cli.cli.phrases import counted, output_name
from beltrami_cli.layers.settings import SmoothSettings

# Parameters that concern the averages, while this command looks at the kernel only.
_OF_WRITING = (
    "clipping", "gutter", "image_suffix", "jpeg_quality", "small", "smooth_geometry", "normal_beta", "level_seams",
)  # fmt: skip


@command("kernel", source="FILE", target="OUTPUT")
@click.option(
    "--at", required=True, metavar="INDEX|X,Y,Z|[GLOB:]U,V|X,Y",
    help="Which sample: a vertex by its index or a position near it, a texel by texture coordinates, or a pixel of an "
    "image by column and row. Indices, columns and rows count from 0.",
)  # fmt: skip
@click.option(
    "--iteration", type=click.IntRange(1), default=1, show_default=True, metavar="K",
    help="Kernel of this iteration; the iterations before it are run.",
)  # fmt: skip
@options_of(SmoothSettings, without=_OF_WRITING)
@options.preset
@options.writing
def kernel(source: str, target: str, at: str, iteration: int, messages: Messages, **smoothing: Any) -> None:
    """Write the geodesic distances and the weights of one kernel of FILE as a mesh, an image or a table."""
    settings = options.settings_from(smoothing)
    from beltrami_cli.jobs.kernel.file import kernel_file

    with options.job_from(smoothing, source, messages) as job:
        shown = kernel_file(source, target, at, settings, iteration=iteration, job=job)
    sample_count = len(shown.table["distance"])
    furthest = f"{shown.table['distance'].max():.3g} of {shown.radius:.3g}"
    messages.say(
        f"{output_name(target)}: kernel of the {shown.at} in iteration {iteration} of {shown.iterations}, "
        f"{counted(sample_count, 'sample')} up to {furthest} away, beta {shown.beta:.3g}"
    )
    if shown.cut_short:
        messages.warn(
            f"{source}: the kernel was cut short at {sample_count} samples; lower -t, or raise --max-samples"
        )
