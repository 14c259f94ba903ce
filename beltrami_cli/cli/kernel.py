"""The command `beltrami kernel`."""

from __future__ import annotations

from typing import Any

import click

from beltrami_cli.cli import options
from beltrami_cli.cli.commands import HelpfulCommand
from beltrami_cli.cli.console import Messages, counted
from beltrami_cli.layers.settings import SmoothSettings

EPILOG = """\b
Examples:
  beltrami kernel scan.ply kernel.ply --at 1234               of a vertex, as a mesh to look at
  beltrami kernel scan.ply kernel.ply --at 0.1,0.2,0.3        of the vertex nearest to a position
  beltrami kernel model.glb kernel.png --at 0.31,0.62         of a texel, by its texture coordinates
  beltrami kernel model.obj kernel.png --at skin*:0.31,0.62   in one of several textures
  beltrami kernel photo.jpg kernel.png --at 640,360           of a pixel of an image, by column and row
  beltrami kernel scan.ply gauss.ply --at 1234 --beta 0       the linear kernel, for comparison
  beltrami kernel scan.ply - --at 1234 --preset paper         the paper's kernel, as a table
  beltrami kernel scan.ply later.ply --at 1234 --iteration 5  of the fifth iteration

\b
OUTPUT by its extension:
  .ply                the mesh: bright is near, dark is where the kernel ends, grey beyond; its vertices
                      have the properties distance (NaN beyond) and weight
  .png and the like   three squares: the colours, the distances, the weights
  .csv                the samples of the kernel: which, distance, weight, colour. The sum of weight times
                      colour over the sum of the weights is the colour that the iteration gives the sample
                      (before `smooth` restores what was clipped).
"""


# Parameters that concern the averages, while this command looks at the kernel only.
_OF_WRITING = (
    "clipping", "gutter", "image_suffix", "jpeg_quality", "small", "smooth_geometry", "normal_beta", "level_seams",
)  # fmt: skip


@click.command("kernel", cls=HelpfulCommand, epilog=EPILOG)
@click.argument("source", metavar="FILE")
@click.argument("target", metavar="OUTPUT")
@click.option(
    "--at", required=True, metavar="INDEX|X,Y,Z|[GLOB:]U,V|X,Y",
    help="Which sample: a vertex by its index or a position near it, a texel by texture coordinates, or a pixel of an "
    "image by column and row. Indices, columns and rows count from 0.",
)  # fmt: skip
@click.option(
    "--iteration", type=click.IntRange(1), default=1, show_default=True, metavar="K",
    help="Kernel of this iteration; the iterations before it are run.",
)  # fmt: skip
@options.options_of(SmoothSettings, without=_OF_WRITING)
@options.preset
@options.writing
def command(source: str, target: str, at: str, iteration: int, messages: Messages, **smoothing: Any) -> None:
    """Write the geodesic distances and the weights of one kernel of FILE, to be looked at.

    Distances are on the image manifold, so they go through space and colour together. Parameters are the ones that
    `beltrami smooth` takes with the same options.
    """
    settings = options.settings_from(smoothing)
    from beltrami_cli.jobs.kernel import kernel_file

    with options.job_from(smoothing, source, messages) as job:
        shown = kernel_file(source, target, at, settings, iteration=iteration, job=job)
    held = len(shown.table["distance"])
    furthest = f"{shown.table['distance'].max():.3g} of {shown.radius:.3g}"
    messages.say(
        f"{target}: kernel of the {shown.at} in iteration {iteration} of {shown.iterations}, "
        f"{counted(held, 'sample')} up to {furthest} away, beta {shown.beta:.3g}"
    )
    if shown.cut_short:
        messages.warn(
            f"{source}: the kernel was cut short at {held} samples; lower -t, or raise --max-samples"
        )
