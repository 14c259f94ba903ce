"""Colours as numbers in files: which number is full scale, and display values for formats that have only these."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import DTypeLike

from beltrami_cli.arrays import Array, Float32s, Float64s
from beltrami_cli.errors import InputError
from beltrami_cli.surface.records import (
    MeshContents,
    VertexColours,
    limits_of,
    linear_to_srgb,
    srgb_to_linear,
)

BYTE = 255.0
_GREY = "Grey is written as equal red, green and blue."
_BRIGHTEST = 16.0  # four stops above white: float colours beyond this are taken for 0..255

# Full scales of 8, 10, 12 and 16 bit, and of intensities of 14 bit, too. Colours up to 16383 may as well be those of a
# dark picture of 16 bit, which would be four times too bright in another format; colours up to 4095 would be black.
_COLOUR_SCALES = (BYTE, 1023.0, 4095.0, 65535.0)
_INTENSITY_SCALES = (BYTE, 1023.0, 4095.0, 16383.0, 65535.0)

# Quantile of the colours other than 0 that gives the range of float colours: larger ones may be spikes of a renderer.
_USUAL_SHARE = 0.99


def full_scale(colours: Float64s, name: str) -> tuple[float, str]:
    """Return the full scale of finite stored colours, shape (V, C), and a notice, "" where there is no doubt."""
    # 255 if numbers exceed 1 and all are integers, or if usual ones exceed 16: colours of high dynamic range may leave
    # [0, 1], but hardly so far. Otherwise 1.
    usual = _usual_largest(colours)
    if usual > BYTE:
        reach = f"from {colours.min():g} to {colours.max():g}"
        cause = f"vertex colours go {reach}, so that full scale is neither 1 nor 255"
        raise InputError(name, cause, "scale them to 0..1")
    largest = float(colours.max())
    if largest <= 1:
        return 1.0, ""
    if usual > _BRIGHTEST or (largest <= BYTE and bool((colours % 1 == 0).all())):
        return BYTE, f"Vertex colours go up to {largest:g} and are taken for numbers of 0..255."
    notice = f"Vertex colours go up to {largest:g} and are taken for numbers of 0..1 that leave this range."
    return 1.0, notice


def _usual_largest(values: Array) -> float:
    """Return the magnitude that few of the numbers other than 0 exceed."""
    seen = np.abs(values[values != 0])
    return float(np.quantile(seen, _USUAL_SHARE, method="higher")) if seen.size else 0.0


def integer_scale(largest: int, kind: DTypeLike, *, is_intensity: bool = False) -> tuple[float, str]:
    """Return the full scale of numbers of an integer type by the largest magnitude among them, and a notice or ""."""
    stored = np.dtype(kind)
    full = float(np.iinfo(stored).max)
    scales = _INTENSITY_SCALES if is_intensity else _COLOUR_SCALES
    scale = next((each for each in scales if largest <= each), full)
    if scale >= full:
        return full, ""
    what = "Intensities" if is_intensity else "Colours"
    notice = f"{what} are stored as {stored}, go up to {largest}, and are taken for numbers of 0..{scale:g}."
    return scale, notice


def point_colour_scale(colours: Float64s, name: str) -> tuple[float, str]:
    """Return what `full_scale` does, but up to 65535 for integers above 255: scanners write these too."""
    scale = _scale_of_whole(colours, _COLOUR_SCALES)
    if scale is None:
        return full_scale(colours, name)
    notice = f"Colours go up to {colours.max():g} and are taken for numbers of 0..{scale:g}."
    return scale, notice if scale > BYTE else ""


def intensity_scale(values: Float64s) -> tuple[float, str]:
    """Return the full scale of finite intensities, shape (P, 1), and a notice or ""."""
    # 1 or that of a number of bits, else the largest magnitude: it only affects reported noise and changes.
    low, high = float(values.min()), float(values.max())
    largest = max(-low, high)
    if largest <= 1:
        return 1.0, ""
    scale = _scale_of_whole(values, _INTENSITY_SCALES)
    if scale is not None:
        return scale, ""
    return largest, f"Intensities go from {low:g} to {high:g}; {largest:g} is taken as full scale."


def _scale_of_whole(values: Float64s, scales: Sequence[float]) -> float | None:
    """Return the least scale that holds integers; None for other numbers, for signed ones, and for numbers up to 1."""
    largest = float(np.abs(values).max())
    if largest <= 1 or (values % 1 != 0).any() or limits_of(values)[0] < 0:
        return None
    return next((scale for scale in scales if largest <= scale), None)


def opacity(alpha: Array, scale: float) -> Float32s:
    """Return opacity in [0, 1]; with colours of 0..255 it may still be of 0..1."""
    values: Float64s = np.nan_to_num(alpha.astype(np.float64))
    values /= scale if _usual_largest(values) > 1 else 1
    return np.clip(values, 0, 1).astype(np.float32)


def quantised(values: Float32s, kind: DTypeLike, scale: float | None = None) -> Array:
    """Return colours of full scale 1 in a type whose full scale is `scale` (None: 1, of integers their largest).

    Integers are rounded once, to the nearest, and clipped to what the type holds up to full scale.
    """
    stored = np.dtype(kind)
    if stored.kind == "f":
        return (values.astype(np.float64) * (scale or 1)).astype(stored)
    limits = np.iinfo(stored)
    full = limits.max if scale is None else scale
    return np.rint(np.clip(values.astype(np.float64) * full, limits.min, min(limits.max, full))).astype(
        stored
    )


def display_colours(contents: MeshContents | VertexColours) -> tuple[Float32s, list[str]]:
    """Return sRGB values of full scale 1, shape (V, 3), and a notice for each thing that was changed."""
    colours, notices = contents.colours, []
    if contents.encoding == "linear":
        colours = linear_to_srgb(colours).astype(np.float32)
        notices.append("Linear colours are written as sRGB, which the format's colours are by custom.")
    return _three_channels(colours, notices, _GREY), notices


def display_colour(linear: Sequence[float]) -> tuple[float, ...]:
    """Return the colour of a material, which is linear light in a file, as display values of full scale 1."""
    return tuple(linear_to_srgb(np.clip(np.array(linear, np.float64), 0, 1)).tolist())


def linear_colours(
    contents: MeshContents | VertexColours, notices: list[str], reason: str, grey: str = _GREY
) -> Float32s:
    """Return colours in linear light, shape (V, 3), which a format has for a reason; add to the notices."""
    colours = contents.colours
    if contents.encoding == "srgb":
        colours = srgb_to_linear(colours).astype(np.float32)
        notices.append(f"Colours are turned from sRGB into linear light, as {reason}.")
    return _three_channels(colours, notices, grey)


def _three_channels(colours: Float32s, notices: list[str], grey: str) -> Float32s:
    if colours.shape[1] > 1:
        return colours
    notices.append(grey)
    return np.repeat(colours, 3, axis=1)
