"""The options that say which colours of a file are meant, for the commands that do not smooth them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from beltrami_cli.cli import options
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.samples.settings import (
    DEFAULTS,
    SLOTS,
    ImageSettings,
    LevelSetSettings,
    SmoothSettings,
    TextureSettings,
)

if TYPE_CHECKING:
    from collections.abc import Callable

space = click.option(
    "--space", type=click.Choice(("srgb", "linear", "data")), default=DEFAULTS.space, show_default=True,
    help="What the colours are taken as: display values, linear light, or the stored numbers as they are.",
)  # fmt: skip
channels = click.option(
    "--channels", metavar="LIST",
    help="Only these channels, such as r,g. Channels of images have the names that `beltrami info` shows.  "
    "[default: the colours]",
)  # fmt: skip
on = click.option(
    "--on", type=click.Choice(("auto", "vertices", "texture", "both")), default=DEFAULTS.on, show_default=True,
    help="The vertex colours, the textures, or both; auto takes the textures where there are any.",
)  # fmt: skip
slots = click.option(
    "--slots", default=",".join(DEFAULTS.textures.slots), show_default=True, metavar="LIST",
    help=f"Textures of which material slots: {', '.join(SLOTS)}. All but the first two are taken as data.",
)  # fmt: skip
mask = click.option(
    "--mask",
    metavar="FILE",
    help="Of an image: an image of the same size that is 0 at holes, which do not count.",
)

gutter = click.option(
    "--gutter", default=str(DEFAULTS.textures.gutter), show_default=True, metavar="N|keep",
    help="Change N texels around every chart too, as lookups across its border see them; or keep them.",
)  # fmt: skip

_CHOOSING = (
    on, slots, options.materials, options.texture_names, channels, space, mask, options.level, options.inside,
    options.colours, options.max_voxels, options.threads,
)  # fmt: skip
_WRITING = (gutter, options.texture_format, options.jpeg_quality, options.small_png)
_USUAL = DEFAULTS.textures


def choosing(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that say which colours are meant, of those that `painting_from` takes."""
    for option in reversed(_CHOOSING):
        command = option(command)
    return command


def writing(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that say how textures and images are written, of those that `painting_from` takes."""
    for option in reversed(_WRITING):
        command = option(command)
    return command


def painting_from(given: dict[str, Any]) -> SmoothSettings:
    """Make settings from the values of the options that `choosing`, and perhaps `writing`, adds.

    Raises
    ------
    UsageError
        If a value is out of its range.
    """
    named = given["channels"]
    return SmoothSettings(
        kernel=KernelParameters(threads=given["threads"]),
        space=given["space"],
        channels=None if named is None else options.names_in(named, "--channels"),
        on=given["on"],
        textures=TextureSettings(
            slots=options.names_in(given["slots"], "--slots"),
            materials=given["materials"],
            names=given["texture_names"],
            gutter=options.gutter_width(given.get("gutter", str(_USUAL.gutter))),
            image_suffix=options.suffix_of(given.get("texture_format")),
            jpeg_quality=given.get("jpeg_quality", _USUAL.jpeg_quality),
            small=given.get("small", _USUAL.small),
        ),
        image=ImageSettings(mask=given["mask"]),
        level_set=LevelSetSettings(
            **{name: given[name] for name in ("level", "inside", "colours", "max_voxels")}
        ),
    )
