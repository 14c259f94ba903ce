"""The options of pictures, each once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, get_args

import click

from beltrami_cli.samples.settings import SLOTS
from beltrami_cli.view.settings import DEFAULT_RENDER, VIEWS, Axis, Crop, RenderSettings

if TYPE_CHECKING:
    from collections.abc import Callable


def _size(context: click.Context, parameter: click.Parameter, text: str) -> tuple[int, int]:
    words = text.lower().split("x")
    if len(words) > 2 or not all(word.isascii() and word.isdigit() and len(word) < 6 for word in words):
        raise click.BadParameter(f"{text!r} is no size such as 800 or 1280x720")
    return int(words[0]), int(words[-1])


def _crops(context: click.Context, parameter: click.Parameter, texts: tuple[str, ...]) -> tuple[Crop, ...]:
    try:
        return tuple(Crop.parse(text) for text in texts)
    except ValueError as error:
        raise click.BadParameter(str(error)) from None


view = click.option(
    "--view", type=click.Choice(list(VIEWS)), default="front", show_default=True,
    help="Where the eye is; y points up, and the front looks along z, unless --up says otherwise.",
)  # fmt: skip
azimuth = click.option(
    "--azimuth", type=float, metavar="DEGREES",
    help="Around the model, to the right of its front.  [default: of --view]",
)  # fmt: skip
elevation = click.option(
    "--elevation", type=float, metavar="DEGREES", help="Upwards; negative: from below.  [default: of --view]"
)
up = click.option(
    "--up", type=click.Choice(get_args(Axis)), default=DEFAULT_RENDER.up, show_default=True,
    help="Which axis of the models points up: z in many scans and in CAD.",
)  # fmt: skip
fov = click.option(
    "--fov", type=float, default=DEFAULT_RENDER.fov, show_default=True, metavar="DEGREES",
    help="Field of view along the shorter side; 0: parallel rays.",
)  # fmt: skip
zoom = click.option(
    "--zoom", type=float, default=DEFAULT_RENDER.zoom, show_default=True, metavar="FACTOR",
    help="Larger than what fits the view.",
)  # fmt: skip
size = click.option(
    "--size", callback=_size, default="x".join(map(str, DEFAULT_RENDER.size)), show_default=True, metavar="N|WxH",
    help="Pixels of each view.",
)  # fmt: skip
lit = click.option(
    "--lit/--unlit", default=DEFAULT_RENDER.lit, show_default=True,
    help="Let a lamp show the shape, or show colours as they are. Points have no shape, and are never lit.",
)  # fmt: skip
background = click.option(
    "--background", default=DEFAULT_RENDER.background, show_default=True, metavar="COLOUR",
    help="white, grey, black, #rrggbb, or transparent; auto: white, or grey behind what is white.",
)  # fmt: skip
crops = click.option(
    "--crop", "crops", callback=_crops, multiple=True, metavar="X,Y[,SIDE]|auto[,SIDE]",
    help="Show a square detail enlarged below each view, drawn anew: its middle in shares of the view from the upper "
    "left, and its side in shares of the shorter side (0.2); auto: where the last file has most to see. Up to 5 times.",
)  # fmt: skip
shown = click.option(
    "--show", "on", type=click.Choice(["auto", "vertices", "texture"]), default=DEFAULT_RENDER.on, show_default=True,
    help="Of models that have both: the texture or the vertex colours; auto: the texture.",
)  # fmt: skip
slot = click.option(
    "--slot", type=click.Choice(SLOTS), default=DEFAULT_RENDER.slot, show_default=True,
    help="Textures of which material slot. All but baseColor and emissive are shown as their plain numbers.",
)  # fmt: skip

_LOOKING = (view, azimuth, elevation, up, fov, zoom, size, lit, background, crops)
LOOKS = ("view", "azimuth", "elevation", "up", "fov", "zoom", "size", "lit", "background", "crops")


def looking(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of the camera, the light and the details, whose values have the names in `LOOKS`."""
    for option in reversed(_LOOKING):
        command = option(command)
    return command


def render_settings_from(options: dict[str, Any]) -> RenderSettings:
    """Make the settings from the values of the options that `looking` adds, and others of the same names.

    Raises
    ------
    UsageError
        If a value is out of its range.
    """
    preset = VIEWS[options.pop("view")]
    for name, angle in zip(("azimuth", "elevation"), preset, strict=True):
        if options[name] is None:
            options[name] = angle
    return RenderSettings(**options)
