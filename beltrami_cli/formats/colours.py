"""Colours in the types of files, and as display values or linear light, whichever a format has."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import DTypeLike

from beltrami_cli.arrays import Array, Float32s
from beltrami_cli.surface.colour_values import linear_to_srgb, srgb_to_linear
from beltrami_cli.surface.records import ColouredVertices, MeshContents

_GREY = "Grey is written as equal red, green and blue."
_BRIGHTEST = float(np.finfo(np.float32).max)


def quantised(values: Float32s, kind: DTypeLike, scale: float | None = None) -> Array:
    """Return colours of full scale 1 in a stored type.

    `scale`: full scale of the type; None: 1 for floats, the largest value for integers, which are rounded to the
    nearest and clipped.
    """
    stored = np.dtype(kind)
    if stored.kind == "f":
        return (values.astype(np.float64) * (scale or 1)).astype(stored)
    limits = np.iinfo(stored)
    full = limits.max if scale is None else scale
    return np.rint(np.clip(values.astype(np.float64) * full, limits.min, min(limits.max, full))).astype(
        stored
    )


def as_in_file(vertices: ColouredVertices, colours: Float32s) -> Float32s:
    """Return new colours of coloured vertices, rounded to what their file holds of them."""
    if not vertices.stored.startswith(("uint", "int")):
        return colours
    full = vertices.full_scale
    return (quantised(colours, vertices.stored, full) / full).astype(np.float32)


def display_colours(contents: MeshContents) -> tuple[Float32s, list[str]]:
    """Return sRGB values of full scale 1, shape (V, 3), and a notice for each conversion."""
    if contents.encoding == "srgb":
        return _three_channels(contents.colours, [], _GREY)
    notices = ["Linear colours are written as sRGB, which the format's colours are by custom."]
    return _three_channels(linear_to_srgb(contents.colours).astype(np.float32), notices, _GREY)


def display_colour(linear: Sequence[float]) -> tuple[float, ...]:
    """Convert the colour of a material from linear light to display values of full scale 1."""
    return tuple(linear_to_srgb(np.array(linear, np.float64)).tolist())


def emission_and_strength(light: Sequence[float]) -> tuple[list[float], float]:
    """Return emitted light as a colour whose channels are at most 1, and its strength, which is at least 1."""
    # A finite factor times a finite strength may be infinite, which files cannot hold.
    finite = [min(channel, _BRIGHTEST) for channel in light]
    strength = max(1.0, *finite)
    return [channel / strength for channel in finite], strength


def linear_colour(display: Sequence[float]) -> list[float]:
    """Convert the colour of a material from display values of full scale 1 to linear light."""
    values: list[float] = srgb_to_linear(np.array(display, np.float64)).tolist()
    return values


def clipped_factor(value: float) -> float:
    """Return a factor of a material in [0, 1]; some exporters leave this range."""
    return min(max(value, 0.0), 1.0)


def linear_colours(contents: MeshContents, reason: str, grey: str = _GREY) -> tuple[Float32s, list[str]]:
    """Return colours in linear light, shape (V, 3), and notices as above; `reason`: why the format needs them."""
    if contents.encoding == "linear":
        return _three_channels(contents.colours, [], grey)
    notices = [f"Colours are turned from sRGB into linear light, as {reason}."]
    return _three_channels(srgb_to_linear(contents.colours).astype(np.float32), notices, grey)


def _three_channels(colours: Float32s, notices: list[str], grey: str) -> tuple[Float32s, list[str]]:
    return (colours, notices) if colours.shape[1] > 1 else (np.repeat(colours, 3, axis=1), [*notices, grey])
