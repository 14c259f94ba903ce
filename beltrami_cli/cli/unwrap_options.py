"""The options of new textures, and their settings."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from beltrami_cli.errors import UsageError
from beltrami_cli.samples.settings import DEFAULT_BAKE, BakeSettings

if TYPE_CHECKING:
    from collections.abc import Callable

texture_size = click.option(
    "--texture-size", type=int, default=DEFAULT_BAKE.size, metavar="N",
    help="Longest side of the new texture in texels.  [default: from the triangles, or the old texture]",
)  # fmt: skip
size = click.option(
    "--size", type=int, default=DEFAULT_BAKE.size, metavar="N",
    help="Longest side of a new texture in texels.  [default: two texels along an edge, 256 to 8192]",
)  # fmt: skip
padding = click.option(
    "--padding", type=int, default=DEFAULT_BAKE.padding, show_default=True, metavar="N",
    help="Texels between the charts of a new texture.",
)  # fmt: skip
keep_uv = click.option(
    "--keep-uv", is_flag=True, help="Use the texture coordinates of INPUT rather than make new ones."
)
unwrap = click.option(
    "--unwrap", is_flag=True,
    help="Lay the mesh out on a new texture, and put its smoothed colours there: for meshes without texture "
    "coordinates, or with hopeless ones. OUTPUT is then a new file with the triangles and the texture.",
)  # fmt: skip
max_unwrap_faces = click.option(
    "--max-unwrap-faces", type=int, default=DEFAULT_BAKE.max_unwrap_faces, show_default=True, metavar="COUNT",
    help="The largest mesh to unwrap. 16 thousand triangles take some 7 s, 82 thousand 2 minutes, and so on.",
)  # fmt: skip


def unwrapping(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add all options that `unwrapping_from` takes."""
    for option in (max_unwrap_faces, texture_size, unwrap):
        command = option(command)
    return command


def unwrapping_from(options: dict[str, Any]) -> BakeSettings | None:
    """Make the settings of a new texture from the values of the options that `unwrapping` adds; None: none is wanted.

    Raises
    ------
    UsageError
        If a value is out of its range, or a size is given and no new texture is wanted.
    """
    if options["unwrap"]:
        return BakeSettings(size=options["texture_size"], max_unwrap_faces=options["max_unwrap_faces"])
    if options["texture_size"] is not None:
        raise UsageError("--texture-size is of the new texture that --unwrap makes; add --unwrap")
    return None
