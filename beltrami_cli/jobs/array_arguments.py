"""Arrays and keywords that users give, checked and as the records that smoothing takes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from beltrami_cli.errors import UsageError
from beltrami_cli.fields import override
from beltrami_cli.samples.image_surface import ImageSurface
from beltrami_cli.surface.records import Encoding, PaintedVertices
from beltrami_cli.surface.validation import (
    array_of,
    check_mesh,
    colour_table,
    face_table,
    guide_table,
    position_table,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from beltrami_cli.arrays import Array, Float32s
    from beltrami_cli.samples.settings import SmoothSettings


def settings_for(
    parameters: SmoothSettings, guide: ArrayLike | None, channels: Sequence[str], overrides: dict[str, Any]
) -> SmoothSettings:
    """Return the parameters with overrides; the channels of the metric by their names, and the guide by one."""
    wanted = overrides.get("metric_channels")
    if wanted is not None:
        overrides["metric_channels"] = tuple(_channel(each, channels) for each in wanted)
    if guide is not None:
        overrides["guides"] = ("guide",)
    settings = override(parameters, **overrides)
    if settings.space == "oklab" and len(channels) != 3:
        raise UsageError("the space oklab needs three channels")
    return settings


def deviations_in(overrides: dict[str, Any], shape: tuple[int, ...]) -> Float32s | None:
    """Take the noise out of overrides if it is an array of standard deviations, with a row a vertex or pixel."""
    if overrides.get("noise") is None or isinstance(overrides["noise"], str):
        return None
    table = guide_table(overrides.pop("noise"), shape, "noise")
    if table.min(initial=0) < 0 or table.max(initial=0) > 1:
        raise UsageError("the noise must be standard deviations from 0 to a full scale of 1")
    return table.astype(np.float32)


def _channel(channel: object, names: Sequence[str]) -> str:
    """Return the name of a channel that is given by its number or name."""
    if isinstance(channel, str) and channel in names:
        return channel
    if not isinstance(channel, (int, np.integer)) or not 0 <= channel < len(names):
        raise UsageError(f"metric_channels names {channel!r}, but the {len(names)} channels count from 0")
    return names[int(channel)]


def require_encoding(encoding: str) -> None:
    """Raise UsageError if there is no such encoding."""
    if encoding not in get_args(Encoding):
        raise UsageError(f"encoding is {encoding}, but must be {' or '.join(get_args(Encoding))}")


def painted_arrays(
    positions: ArrayLike, faces: ArrayLike | None, colours: ArrayLike, encoding: Encoding
) -> PaintedVertices:
    """Check the arrays of a mesh, or of points; channels have names, or else their numbers."""
    require_encoding(encoding)
    places, shades = position_table(positions), colour_table(colours)
    names = ("red", "green", "blue") if shades.shape[1] == 3 else tuple(map(str, range(shades.shape[1])))
    stored = str(np.asarray(colours).dtype)
    triangles = face_table([] if faces is None else faces, len(places))
    painted = PaintedVertices(places, triangles, shades, names, encoding, stored)
    check_mesh(painted, "the arrays")
    return painted


def checked_surface(surface: ImageSurface | None, table: Float32s, shape: tuple[int, int]) -> ImageSurface:
    """Check where pixels lie; those whose colours are not finite are holes, too."""
    valid = np.asarray(np.isfinite(table.reshape(*shape, -1)).all(axis=2))
    if surface is None:
        return ImageSurface(valid=valid)
    if surface.positions is not None and surface.heights is not None:
        raise UsageError("positions and heights are two surfaces for one image; give one of them")
    positions, heights = surface.positions, surface.heights
    if positions is not None:
        positions = _pixel_array(positions, "positions", (*shape, None), "uif").astype(np.float64)
    if heights is not None:
        heights = _pixel_array(heights, "heights", shape, "uif").astype(np.float64)
    if surface.valid is not None:
        valid &= _pixel_array(surface.valid, "valid", shape, "bui").astype(bool)
    return ImageSurface(heights, positions, valid)


def pixel_colours(colours: ArrayLike) -> tuple[Float32s, tuple[int, int]]:
    """Return the colours of all pixels, shape (H * W, C), and the shape (H, W)."""
    image = array_of(colours, "colours")
    if image.ndim not in (2, 3) or image.size == 0:
        raise UsageError(f"colours must be of shape (H, W) or (H, W, C), not {image.shape}")
    rows, columns = image.shape[:2]
    return colour_table(image.reshape(rows * columns, -1)), (rows, columns)


def _pixel_array(values: ArrayLike, name: str, shape: tuple[int | None, ...], kinds: str) -> Array:
    """Take an array with a number for each pixel, or M numbers where the last of the shape is None."""
    array = array_of(values, name)
    fits = array.ndim == len(shape) and all(
        b is None or a == b for a, b in zip(array.shape, shape, strict=True)
    )
    if not fits or array.dtype.kind not in kinds or 0 in array.shape:
        wanted = ", ".join("M" if size is None else str(size) for size in shape)
        raise UsageError(
            f"{name} must be numbers of shape ({wanted}), not {array.dtype} of shape {array.shape}"
        )
    return array
