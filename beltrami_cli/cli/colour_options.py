"""The options that say which colours are smoothed, and how textures are written, and settings from their values."""

from __future__ import annotations

from typing import Any, get_args

import click

from beltrami_cli.errors import UsageError
from beltrami_cli.flow.parameters import Space
from beltrami_cli.samples.settings import DEFAULTS, SLOTS, AlphaMode, Target, TextureSettings

_TEXTURES = DEFAULTS.textures

space = click.option(
    "--space", type=click.Choice(get_args(Space)), default=DEFAULTS.space, show_default=True,
    help="What colour distances and averages are taken in. 'data' takes the stored numbers as they are, for colours "
    "that stand for something else.",
)  # fmt: skip
channels = click.option(
    "--channels", metavar="LIST",
    help="Smooth only these channels, such as r,g; the others stay and do not count. Channels of images have the names "
    "that `beltrami info` shows.",
)  # fmt: skip
on = click.option(
    "--on", type=click.Choice(get_args(Target)), default=DEFAULTS.on, show_default=True,
    help="Smooth the vertex colours, the texture, or both; auto takes the texture where there is one.",
)  # fmt: skip
slots = click.option(
    "--slots", default=",".join(_TEXTURES.slots), show_default=True, metavar="LIST",
    help=f"Textures of which material slots: {', '.join(SLOTS)}. All but the first two are taken as data.",
)  # fmt: skip
materials = click.option(
    "--material", "materials", multiple=True, metavar="GLOB",
    help="Only textures of materials with such a name; may be repeated.",
)  # fmt: skip
texture_names = click.option(
    "--texture", "texture_names", multiple=True, metavar="GLOB",
    help="Only textures with such a file name; may be repeated.",
)  # fmt: skip
alpha = click.option(
    "--alpha", type=click.Choice(get_args(AlphaMode)), default=_TEXTURES.alpha, show_default=True,
    help="Keep the opacity of textures and images, or smooth it with the colours. Invisible texels lend no colour "
    "unless it is smoothed.",
)  # fmt: skip
gutter = click.option(
    "--gutter", default=str(_TEXTURES.gutter), show_default=True, metavar="N|keep",
    help="Refill N texels around every chart, so that lookups across its border see no old noise; or keep them.",
)  # fmt: skip
texture_format = click.option(
    "--texture-format", metavar="EXT",
    help="Write textures as png, jpg, webp, tif, exr ...  [default: each as it was]",
)  # fmt: skip
jpeg_quality = click.option(
    "--jpeg-quality", type=click.IntRange(1, 100), default=_TEXTURES.jpeg_quality, show_default=True,
    help="Quality of JPEG and lossy WebP textures and images; the subsampling stays that of the source.",
)  # fmt: skip
small_png = click.option("--small", is_flag=True, help="Compress PNG files well, which takes longer.")


def textures_from(options: dict[str, Any]) -> TextureSettings:
    """Make the settings of textures from the values of their options; UsageError if one has no meaning."""
    return TextureSettings(
        slots=names_in(options["slots"], "--slots"),
        materials=options["materials"],
        names=options["texture_names"],
        alpha=options["alpha"],
        gutter=gutter_width(options["gutter"]),
        image_suffix=suffix_of(options["texture_format"]),
        jpeg_quality=options["jpeg_quality"],
        small=options["small"],
    )


def names_in(text: str, option: str) -> tuple[str, ...]:
    """Return the names of a list with commas; UsageError if there are none."""
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    if not names:
        raise UsageError(f"{option} names nothing; give names, with commas between them, or leave it out")
    return names


def suffix_of(text: str | None) -> str | None:
    """Return an extension in lower case and with its dot."""
    return None if text is None else "." + text.lower().lstrip(".")


def gutter_width(text: str) -> int | None:
    """Return a number of texels, None for "keep"; UsageError if it is neither."""
    if text == "keep":
        return None
    # Alone, isdigit would let other scripts and ² pass, which int does not take.
    if not (text.isascii() and text.isdigit() and len(text) <= 5):
        raise UsageError(f"gutter is {text}, but must be a number of texels from 0 to 99999, or keep")
    return int(text)
