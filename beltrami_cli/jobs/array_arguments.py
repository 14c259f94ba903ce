"""Arrays and keywords that users give, checked and as the records that smoothing takes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, get_args

import numpy as np
from numpy.typing import ArrayLike

from beltrami_cli.arrays import Array, Float32s, Float64s, Int32s
from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.fields import override
from beltrami_cli.flow.embedding import Guide, centred
from beltrami_cli.layers.image_surface import ImageSurface
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.surface.records import Encoding, PaintedVertices, check_scale

_ARRAYS = "the arrays"  # as messages call them


def settings_for(
    parameters: SmoothSettings, guide: ArrayLike | None, channels: Sequence[str], shape: tuple[int, ...],
    overrides: dict[str, Any],
) -> tuple[SmoothSettings, list[Guide], Float32s | None]:  # fmt: skip
    """Return the parameters with overrides, guides, and deviations of noise: a row for each vertex or pixel."""
    noise = _deviations_in(overrides, shape)
    wanted = overrides.get("metric_channels")
    if wanted is not None:
        overrides["metric_channels"] = tuple(_channel(each, channels) for each in wanted)
    if guide is not None:
        overrides["guides"] = ("guide",)
    settings = override(parameters, **overrides)
    if settings.space == "oklab" and len(channels) != 3:
        raise UsageError("the space oklab needs three channels")
    if guide is None:
        return settings, [], noise
    (_, beta), *_ = settings.embedding.weighted_guides
    return settings, [Guide("guide", centred(guide_table(guide, shape)), beta)], noise


def _deviations_in(overrides: dict[str, Any], shape: tuple[int, ...]) -> Float32s | None:
    """Take the noise out of overrides if it is an array of standard deviations."""
    if overrides.get("noise") is None or isinstance(overrides["noise"], str):
        return None
    table = guide_table(overrides.pop("noise"), shape, "noise")
    if table.min(initial=0) < 0 or table.max(initial=0) > 1:
        raise UsageError("the noise must be standard deviations from 0 to a full scale of 1")
    return table.astype(np.float32)


def _channel(channel: object, names: Sequence[str]) -> str:
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
    if len(places) != len(shades):
        raise InputError(_ARRAYS, f"there are {len(places)} positions but {len(shades)} colours")
    for what, table in (("position", places), ("colour", shades)):
        finite = np.isfinite(table).all(axis=1)
        if not finite.all():
            cause = f"the {what} of vertex {int(np.argmin(finite))} is not finite"
            raise InputError(_ARRAYS, cause, "repair the file")
    check_scale(places, triangles, _ARRAYS)
    return PaintedVertices(places, triangles, shades, names, encoding, stored)


def checked_surface(surface: ImageSurface | None, table: Float32s, shape: tuple[int, int]) -> ImageSurface:
    """Check where pixels lie; where a colour, height or position is not finite is a hole, too."""
    valid = np.asarray(np.isfinite(table.reshape(*shape, -1)).all(axis=2))
    if surface is None:
        return ImageSurface(valid=valid)
    if surface.positions is not None and surface.heights is not None:
        raise UsageError("positions and heights are two surfaces for one image; give one of them")
    positions, heights = surface.positions, surface.heights
    if positions is not None:
        positions = _numbers(positions, "positions", (*shape, "M")).astype(np.float64)
        valid &= np.isfinite(positions).all(axis=2)
    if heights is not None:
        heights = _numbers(heights, "heights", shape).astype(np.float64)
        valid &= np.isfinite(heights)
    if surface.valid is not None:
        valid &= _numbers(surface.valid, "valid", shape, "bui").astype(bool)
    return ImageSurface(heights, positions, valid)


def pixel_colours(colours: ArrayLike) -> tuple[Float32s, tuple[int, int]]:
    """Return the colours of all pixels, shape (H * W, C), and the shape (H, W)."""
    image = array_of(colours, "colours")
    if image.ndim not in (2, 3) or image.size == 0:
        raise UsageError(f"colours must be of shape (H, W) or (H, W, C), not {image.shape}")
    rows, columns = image.shape[:2]
    return colour_table(image.reshape(rows * columns, -1)), (rows, columns)


def position_table(positions: ArrayLike) -> Float64s:
    """Take positions of any numeric type, shape (V, M); an empty list has M = 3."""
    table = array_of(positions, "positions")
    table = _numbers(table.reshape(0, 3) if table.shape == (0,) else table, "positions", ("V", "M"))
    with np.errstate(over="ignore"):  # too large numbers become infinite, which is refused
        return np.ascontiguousarray(table, np.float64)


def face_table(faces: ArrayLike, count: int) -> Int32s:
    """Take triangles of any integer type, shape (F, 3), indices in [0, count); nothing wraps or is cut off."""
    table = array_of(faces, "faces")
    if table.shape in ((0,), (0, 3)):
        return np.empty((0, 3), np.int32)
    if _numbers(table, "faces", ("F", 3), "buifO").dtype.kind not in "ui":
        raise UsageError(f"faces must be whole numbers, not {table.dtype}")
    wrong = ((table < 0) | (table >= count)).any(axis=1)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise UsageError(f"face {row} is {table[row].tolist()}, but there are {count} vertices, from 0 on")
    return np.ascontiguousarray(table, np.int32)


def colour_table(colours: ArrayLike) -> Float32s:
    """Take colours, shape (V, C) or (V,): floats as they are, unsigned integers by their full scale."""
    table = array_of(colours, "colours")
    if table.ndim == 1:
        table = table[:, None] if len(table) else table.reshape(0, 3)
    if _numbers(table, "colours", ("V", "C")).dtype.kind == "f":
        with np.errstate(over="ignore"):
            return np.ascontiguousarray(table, np.float32)
    # The full scale of other integers is unknown: a list of 0 to 255 becomes int64.
    if table.dtype not in (np.uint8, np.uint16, np.uint32):
        remedy = "give uint8, as 0 to 255, or floats, as 0 to 1"
        raise UsageError(f"colours of type {table.dtype} have no full scale; {remedy}")
    return np.ascontiguousarray(table / np.iinfo(table.dtype).max, np.float32)


def guide_table(values: ArrayLike, shape: tuple[int, ...], name: str = "guide") -> Float64s:
    """Take a guide: any finite numbers of `shape`, or with channels behind it; a row a vertex or pixel."""
    table = array_of(values, name)
    table = _numbers(
        table[..., None] if table.shape == shape else table, f"the {name}", (*shape, "G"), "buif"
    )
    rows = table.reshape(-1, table.shape[-1]).astype(np.float64)
    if not np.isfinite(rows).all():
        raise UsageError(f"row {int(np.argmin(np.isfinite(rows).all(axis=1)))} of the {name} is not finite")
    return rows


def array_of(values: ArrayLike, name: str) -> Array:
    """Make an array of anything like one; UsageError, with the name, if its rows are of several lengths."""
    try:
        return np.asarray(values)
    except (TypeError, ValueError, OverflowError) as error:
        raise UsageError(f"{name} must be a table whose rows have the same length") from error


def _numbers(values: ArrayLike, name: str, shape: tuple[int | str, ...], kinds: str = "uif") -> Array:
    """Take numbers of a shape, in which a letter is any length; only the first axis may be empty."""
    array = array_of(values, name)
    fits = array.ndim == len(shape) and 0 not in array.shape[1:]
    fits = fits and all(isinstance(b, str) or a == b for a, b in zip(array.shape, shape, strict=True))
    if not fits or array.dtype.kind not in kinds:
        wanted = ", ".join(map(str, shape))
        raise UsageError(
            f"{name} must be numbers of shape ({wanted}), not {array.dtype} of shape {array.shape}"
        )
    return array
