"""The options that say which surface an image or a level set is."""

from __future__ import annotations

from typing import get_args

import click

from beltrami_cli.samples.settings import DEFAULTS, MOST_VOXELS, Inside

_IMAGE, _LEVEL_SET = DEFAULTS.image, DEFAULTS.level_set

height = click.option(
    "--height", metavar="FILE",
    help="Of an image: an image of the same size with heights over its plane, which make it the surface (x, y, S h). "
    "Depth images (EXR, 16-bit PNG) do as well. Where a height is no finite number is a hole.",
)  # fmt: skip
height_scale = click.option(
    "--height-scale", type=float, default=_IMAGE.height_scale, show_default=True, metavar="S",
    help="Pixels per unit of --height. Floats are taken as they are, integers as 0 to 1.",
)  # fmt: skip
positions = click.option(
    "--positions", metavar="FILE",
    help="Of an image: an image of the same size with the place x, y, z of every pixel, as range scanners and bakers "
    "write them. Where one is not finite, or has an alpha of 0, is a hole.",
)  # fmt: skip
mask = click.option(
    "--mask", metavar="FILE",
    help="Of an image: an image of the same size that is 0 at holes. They stay as they are, and nothing crosses them.",
)  # fmt: skip
level = click.option(
    "--level", type=float, default=_LEVEL_SET.level, metavar="L",
    help="Of a level set: the value on its surface, such as 0.5 for occupancies.  [default: as INPUT says, or 0]",
)  # fmt: skip
inside = click.option(
    "--inside", type=click.Choice(get_args(Inside)), default=_LEVEL_SET.inside, show_default=True,
    help="Of a level set: which values are inside, below the level as signed distances, or above it as densities. "
    "Triangles face outwards.",
)  # fmt: skip
colours = click.option(
    "--colours", metavar="FILE",
    help="Of a level set: a file with its colours, which may be on a grid of their own (.nrrd, .npz), or at points or "
    "vertices near the surface (.npz, PLY and all other models).  [default: those in INPUT]",
)  # fmt: skip
max_voxels = click.option(
    "--max-voxels", type=click.IntRange(8, MOST_VOXELS), default=_LEVEL_SET.max_voxels, show_default=True,
    metavar="COUNT", help="Of a level set: the largest grid that is read.",
)  # fmt: skip
