"""Every shared option once, with its help; those that make up the settings of a smoothing together."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from beltrami_cli.cli import colour_options as colour
from beltrami_cli.cli import kernel_options as kernel
from beltrami_cli.cli import surface_options as surface
from beltrami_cli.cli.access_options import (
    output_format,
    overwrite,
    overwrite_at,
    quiet,
    reading,
    reading_from,
    verbose,
)
from beltrami_cli.cli.colour_options import (
    gutter_width,
    jpeg_quality,
    materials,
    names_in,
    small_png,
    suffix_of,
    texture_format,
    texture_names,
)
from beltrami_cli.cli.embedding import GUIDING, MOVING, embedding_from
from beltrami_cli.cli.kernel_options import is_given, threads
from beltrami_cli.cli.surface_options import colours, inside, level, max_voxels
from beltrami_cli.cli.unwrap_options import (
    keep_uv,
    max_unwrap_faces,
    padding,
    size,
    unwrapping,
    unwrapping_from,
)
from beltrami_cli.samples.settings import DEFAULTS, ImageSettings, LevelSetSettings, SmoothSettings

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = [
    "colours",
    "gutter_width",
    "inside",
    "is_given",
    "jpeg_quality",
    "keep_uv",
    "level",
    "materials",
    "max_unwrap_faces",
    "max_voxels",
    "names_in",
    "output_format",
    "overwrite",
    "overwrite_at",
    "padding",
    "quiet",
    "reading",
    "reading_from",
    "settings_from",
    "size",
    "small_png",
    "smoothing",
    "studying",
    "suffix_of",
    "texture_format",
    "texture_names",
    "threads",
    "unwrapping",
    "unwrapping_from",
    "verbose",
]

_SMOOTHING = (
    kernel.iterations, kernel.time_step, kernel.beta, kernel.beta_growth, kernel.threshold, kernel.metric_scale,
    kernel.metric_steps, kernel.clipping, kernel.strength, kernel.fast, kernel.preset, colour.on, colour.space,
    colour.channels, kernel.units, kernel.weights, kernel.max_samples, kernel.window, surface.height,
    surface.height_scale, surface.positions, surface.mask, surface.level, surface.inside, surface.colours,
    surface.max_voxels, colour.slots, colour.materials, colour.texture_names, colour.alpha, colour.gutter,
    colour.texture_format, colour.jpeg_quality, colour.small_png, *GUIDING, *MOVING, kernel.solver, kernel.threads,
)  # fmt: skip

# Those of one kernel, which is not written back, and what the others are without being asked for.
_STUDYING = (
    kernel.time_step, kernel.beta, kernel.beta_growth, kernel.threshold, kernel.metric_scale, kernel.metric_steps,
    kernel.preset, colour.on, colour.space, colour.channels, kernel.units, kernel.weights, kernel.max_samples,
    kernel.window, surface.height, surface.height_scale, surface.positions, surface.mask, surface.level, surface.inside,
    surface.colours, surface.max_voxels, colour.slots, colour.materials, colour.texture_names, colour.alpha, *GUIDING,
    kernel.solver, kernel.threads,
)  # fmt: skip
_UNASKED = {
    "iterations": None,
    "clipping": DEFAULTS.kernel.clipping,
    "strength": DEFAULTS.kernel.strength,
    "fast": True,
    "gutter": str(DEFAULTS.textures.gutter),
    "texture_format": DEFAULTS.textures.image_suffix,
    "jpeg_quality": DEFAULTS.textures.jpeg_quality,
    "small": DEFAULTS.textures.small,
}

_LEVEL_SET_OPTIONS = ("level", "inside", "colours", "max_voxels")


def smoothing(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add all options that make up `SmoothSettings`."""
    for option in reversed(_SMOOTHING):
        command = option(command)
    return command


def studying(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of `smoothing` that bear on a single kernel."""
    for option in reversed(_STUDYING):
        command = option(command)
    return command


def settings_from(options: dict[str, Any]) -> SmoothSettings:
    """Make the settings from the values of the options that `smoothing` or `studying` adds.

    Raises
    ------
    UsageError
        If a value is out of its range.
    """
    options = {**_UNASKED, **options}
    return SmoothSettings(
        kernel=kernel.kernel_from(options),
        space=options["space"],
        channels=None if options["channels"] is None else colour.names_in(options["channels"], "--channels"),
        on=options["on"],
        textures=colour.textures_from(options),
        image=ImageSettings(
            height=options["height"],
            height_scale=options["height_scale"],
            positions=options["positions"],
            mask=options["mask"],
        ),
        embedding=embedding_from(options),
        level_set=LevelSetSettings(**{name: options[name] for name in _LEVEL_SET_OPTIONS}),
    )
