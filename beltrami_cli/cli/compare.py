"""The command `beltrami compare`."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import click

from beltrami_cli.cli import options
from beltrami_cli.cli.amounts import amount
from beltrami_cli.cli.console import Messages, printable
from beltrami_cli.cli.painting import choosing, painting_from

if TYPE_CHECKING:
    from beltrami_cli.flow.parameters import Weights

EPILOG = """\b
Examples:
  beltrami compare truth.ply clean.ply                                   a table
  beltrami compare truth.glb clean.glb --min-psnr 35 --max-delta-e 2     exit code 1 if a limit is broken
  beltrami compare golden.obj new.obj --max-seam-jump 1 --weights area   seams may not be seen more than before
  beltrami compare truth.png clean.png --json | jq .overall.psnr
  beltrami compare truth.glb clean.glb --map differences.png             dark is equal, bright differs
  beltrami compare truth.ply clean.ply --map differences.ply

\b
What is told, for each texture and for the vertices, and for all together:
  PSNR       10 log10 (1 / mean squared error) over samples and channels, full scale 1
  SSIM       structural similarity of images, and of textures where the surface covers the whole window
  dE         Delta E 2000 from colour to colour: mean, 95th percentile, worst. 1 can hardly be seen
  seams      PSNR and mean dE within 4 texels of seams; of vertices, where the file splits them
  jump       the mean step of colours over seams, extrapolated from three texels on either side (of vertices,
             between those at one place), in TEST minus in REFERENCE. Noise makes steps too
A limit holds for each texture alone. SSIM is of Wang et al. 2004, Delta E of CIE 142-2001 (Sharma et al. 2005).

\b
Exit codes: 0 all limits are kept, or none given; 1 a limit is broken; 3 one cannot be measured, such as SSIM of
vertices (only steps over seams are kept where there is no seam); otherwise as `beltrami`.
See docs/ci.md for GitHub Actions and Makefiles.
"""


@click.command("compare", epilog=EPILOG)
@click.argument("reference", metavar="REFERENCE")
@click.argument("test", metavar="TEST")
@click.option("--min-psnr", type=float, metavar="DB", help="Lowest PSNR allowed, in dB.")
@click.option("--min-ssim", type=float, metavar="S", help="Lowest structural similarity allowed; 1 is equal.")
@click.option("--max-delta-e", type=float, metavar="E", help="Largest mean Delta E 2000 allowed.")
@click.option(
    "--max-seam-jump", callback=amount, metavar="X",
    help="How much larger the mean colour step over seams may be than in REFERENCE: 1 is 1/255; or as 1/255 or 0.4%.",
)  # fmt: skip
@click.option(
    "--weights", type=click.Choice(("uniform", "area")), default="uniform", show_default=True,
    help="Count each sample once, or by the surface area that it stands for.",
)  # fmt: skip
@choosing
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.option(
    "--map",
    "map_to",
    metavar="OUT.png|OUT.ply",
    help="Draw where colours differ: a picture, or a mesh of vertices.",
)
@click.option("--overwrite", is_flag=True, help="Replace the map if it exists.")
@options.reading
@options.quiet
@options.verbose
def command(
    reference: str,
    test: str,
    min_psnr: float | None,
    min_ssim: float | None,
    max_delta_e: float | None,
    max_seam_jump: float | None,
    weights: Weights,
    as_json: bool,
    map_to: str | None,
    overwrite: bool,
    quiet: bool,
    verbose: int,
    **painting: Any,
) -> int:
    """Tell how far the colours of TEST are from those of REFERENCE, and fail if they are further than allowed.

    Both are files of one model, with the same triangles, vertices and sizes of textures, or two images of one size;
    formats and types may differ. Of textures the texels count that the surface covers.
    """
    settings = painting_from(painting)
    messages = Messages(quiet=quiet, verbose=verbose)
    from beltrami_cli.jobs.compare.files import compare_files
    from beltrami_cli.jobs.compare.limits import Limits

    limits = Limits(min_psnr, min_ssim, max_delta_e, max_seam_jump)
    with options.reading_from(painting, reference) as access:
        comparison = compare_files(
            reference,
            test,
            limits,
            settings,
            weights=weights,
            map_to=map_to,
            overwrite=overwrite,
            access=access,
        )
    from beltrami_cli.cli.comparison import describe, show

    if as_json:
        from dataclasses import asdict

        click.echo(json.dumps(asdict(comparison), indent=2))
    elif not quiet:
        show(comparison)
    for notice in comparison.notices:
        messages.warn(notice)
    if map_to is not None:
        messages.say(
            f"{map_to}: bright yellow is a Delta E of {comparison.map_scale:.3g}, grey is not compared"
        )
    for verdict in comparison.limits:
        if not verdict.kept:
            click.echo(printable(f"beltrami: {test}: {describe(verdict)}"), err=True)
    return 0 if comparison.passed else 1
