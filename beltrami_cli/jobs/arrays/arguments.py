"""Checks of the arrays and keywords that users give."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, get_args

import numpy as np
from numpy.typing import ArrayLike

from beltrami_cli.arrays import Array, Float32s, Float64s, Int32s
from beltrami_cli.errors import UsageError
from beltrami_cli.fields import override
from beltrami_cli.flow.manifolds.guides import Guide, centred
from beltrami_cli.formats.colours import quantised
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.surface.precision import require_single
from beltrami_cli.surface.records import Encoding

ARRAYS = "the arrays"  # as messages call them


def settings_for(
    settings: SmoothSettings, guide: ArrayLike | None, channels: Sequence[str], shape: tuple[int, ...],
    overrides: dict[str, Any],
) -> tuple[SmoothSettings, list[Guide], Float32s | None]:  # fmt: skip
    """Return the settings with overrides, guides, and deviations of noise: a row for each vertex or pixel."""
    values, deviations = dict(overrides), None
    if values.get("noise") is not None and not isinstance(values["noise"], str):
        deviations = _deviations(values.pop("noise"), shape)
    if values.get("metric_channels") is not None:
        values["metric_channels"] = tuple(_channel(each, channels) for each in values["metric_channels"])
    if guide is not None:
        values["guides"] = ("guide",)
    settings = override(settings, **values)
    if settings.space == "oklab" and len(channels) != 3:
        raise UsageError("the space oklab needs three channels")
    if guide is None:
        return settings, [], deviations
    (_, beta), *_ = settings.embedding.weighted_guides
    return settings, [Guide("guide", centred(guide_table(guide, shape)), beta)], deviations


def _deviations(noise: ArrayLike, shape: tuple[int, ...]) -> Float32s:
    table = guide_table(noise, shape, "noise")
    if table.min(initial=0) < 0 or table.max(initial=0) > 1:
        raise UsageError("the noise must be standard deviations from 0 to a full scale of 1")
    return table.astype(np.float32)


def _channel(channel: object, names: Sequence[str]) -> str:
    if isinstance(channel, str) and channel in names:
        return channel
    if not isinstance(channel, (int, np.integer)) or not 0 <= channel < len(names):
        raise UsageError(f"metric_channels names {channel!r}, but the {len(names)} channels count from 0")
    return names[int(channel)]


def require_choice(name: str, value: str, choices: Sequence[str] = get_args(Encoding)) -> None:
    """Raise UsageError if an argument is none of its choices; by default it is an encoding."""
    if value not in choices:
        raise UsageError(f"{name} is {value}, but must be {' or '.join(choices)}")


def position_table(positions: ArrayLike) -> Float64s:
    """Take positions of any numeric type, shape (V, M); an empty list has M = 3."""
    table = array_of(positions, "positions")
    table = numbers_of(table.reshape(0, 3) if table.shape == (0,) else table, "positions", ("V", "M"))
    with np.errstate(over="ignore"):  # too large numbers become infinite, which is refused
        return np.ascontiguousarray(table, np.float64)


def face_table(faces: ArrayLike, count: int) -> Int32s:
    """Take triangles of any integer type, shape (F, 3), indices in [0, count); nothing wraps or is cut off."""
    table = array_of(faces, "faces")
    if table.shape in ((0,), (0, 3)):
        return np.empty((0, 3), np.int32)
    if numbers_of(table, "faces", ("F", 3), "buifO").dtype.kind not in "ui":
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
    if numbers_of(table, "colours", ("V", "C")).dtype.kind == "f":
        require_single(table, ARRAYS, "the colour of sample", holes=True)
        return np.ascontiguousarray(table, np.float32)
    # The full scale of other integers is unknown: a list of 0 to 255 becomes int64.
    if table.dtype not in (np.uint8, np.uint16, np.uint32):
        remedy = "give uint8, as 0 to 255, or floats, as 0 to 1"
        raise UsageError(f"colours of type {table.dtype} have no full scale; {remedy}")
    return np.ascontiguousarray(table / np.iinfo(table.dtype).max, np.float32)


def in_type_of(given: Array, before: Array, after: Array) -> Array:
    """Return new colours in the type of the given ones, rounded as in files; what did not change keeps its bits.

    `before` and `after`: floats of full scale 1, or of the type of the given ones already.
    """
    if after.dtype == given.dtype:
        return after
    result = given.reshape(after.shape).copy()
    is_new = (after != before) & ~np.isnan(before)
    result[is_new] = quantised(after[is_new], given.dtype)
    return result


def image_array(image: Any, name: str) -> Array:
    """Make an array of an image; one of Pillow whose numbers are not grey, red, green and blue is converted."""
    mode = getattr(image, "mode", None)
    if mode is not None and mode not in ("L", "LA", "RGB", "RGBA", "I;16", "F"):
        has_alpha = mode == "PA" or "transparency" in image.info
        image = image.convert("RGBA" if has_alpha else "RGB")
    return array_of(image, name)


def guide_table(values: ArrayLike, shape: tuple[int, ...], name: str = "guide") -> Float64s:
    """Take a guide: any finite numbers of `shape`, or with channels behind it; a row a vertex or pixel."""
    table = array_of(values, name)
    table = numbers_of(
        table[..., None] if table.shape == shape else table, f"the {name}", (*shape, "G"), "buif"
    )
    rows = table.reshape(-1, table.shape[-1]).astype(np.float64)
    require_single(rows, ARRAYS, f"the {name} of sample")
    return rows


def array_of(values: ArrayLike, name: str) -> Array:
    """Make an array of anything like one; UsageError, with the name, if its rows are of several lengths."""
    try:
        return np.asarray(values)
    except (TypeError, ValueError, OverflowError) as error:
        raise UsageError(f"{name} must be a table whose rows have the same length") from error


def numbers_of(values: ArrayLike, name: str, shape: tuple[int | str, ...], kinds: str = "uif") -> Array:
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
