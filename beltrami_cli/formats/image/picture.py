"""An image as its pixels, and all that is needed to write it back as it was."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.surface.large_arrays import blocks

if TYPE_CHECKING:
    from beltrami_cli.arrays import Array, Bools, Float32s
    from beltrami_cli.surface.records import Encoding

_ROWS = 64  # compared at a time
_LEAST_OPACITY = 1 / 1024  # that colours are divided by
_LEAST_STEPS = 16  # of opacity, for colours of 4 bits


@dataclass(frozen=True)
class Picture:
    """A decoded image file."""

    name: str
    # Shape (H, W, C), row 0 is the upper one, values as in the file: alpha is not multiplied into colours that are
    # stored without it, orientation tags are ignored, palettes are resolved, and half floats are float32.
    pixels: Array
    channels: tuple[str, ...]  # names of the C channels
    colour: tuple[int, ...]  # the channels that are grey, or red, green and blue
    alpha: int | None  # the channel that is the opacity
    encoding: Encoding  # display values in integer types, linear light in floats
    stored: str  # type of the colours in the file: uint8, uint16, float16 or float32
    format: str  # a key of `recognition.FORMATS`
    suffix: str  # with the dot: the source's own if it fits the format
    notices: tuple[str, ...]  # for the user, one sentence each, with the image's name
    kinds: tuple[str, ...]  # type of every channel in the file; they differ in some EXR files only
    source: bytes = field(repr=False)  # the file, whose metadata are carried over
    spec: Any = field(repr=False)  # OpenImageIO.ImageSpec of the file


def new_picture(pixels: Array, name: str) -> Picture:
    """Describe new sRGB pixels of uint8 or uint16, RGB or RGBA with unassociated alpha, as a PNG without metadata."""
    import OpenImageIO

    height, width, channels = pixels.shape
    stored = "uint8" if pixels.dtype == "uint8" else "uint16"
    return Picture(
        name=name,
        pixels=pixels,
        channels=("R", "G", "B", "A")[:channels],
        colour=(0, 1, 2),
        alpha=3 if channels == 4 else None,
        encoding="srgb",
        stored=stored,
        kinds=(stored,) * channels,
        format="png",
        suffix=".png",
        notices=(),
        source=b"",
        spec=OpenImageIO.ImageSpec(width, height, channels, str(pixels.dtype)),
    )


def to_float(picture: Picture) -> Float32s:
    """Return all channels, shape (H, W, C), as `full_scale_one` does."""
    return full_scale_one(picture.pixels)


def is_associated(picture: Picture) -> bool:
    """Whether alpha is multiplied into the stored colours, as it is in EXR files and may be in TIFF files."""
    if picture.alpha is None or picture.format not in ("openexr", "tiff"):
        return False
    return not (picture.format == "tiff" and picture.spec.get_int_attribute("oiio:UnassociatedAlpha"))


def without_alpha(picture: Picture, values: Float32s) -> Float32s:
    """Return channels of full scale 1, shape (..., C), with colours divided by alpha, except where it is nearly 0."""
    if not is_associated(picture):
        return values
    straight = values.copy()
    opacity = values[..., picture.alpha]
    for channel in picture.colour:
        np.divide(values[..., channel], opacity, out=straight[..., channel], where=opacity >= _LEAST_OPACITY)
    return straight


def supplies_colour(picture: Picture, opacity: Array) -> Bools:
    """Return from their stored opacity which pixels have a colour: not those that are transparent."""
    if not is_associated(picture):
        return np.asarray(opacity != 0)
    steps = np.inf if opacity.dtype.kind == "f" else np.iinfo(opacity.dtype).max
    share = full_scale_one(opacity)
    return np.asarray((share >= max(_LEAST_OPACITY, _LEAST_STEPS / steps)) & np.isfinite(share))


def is_unchanged(picture: Picture, pixels: Array) -> bool:
    """Whether pixels, shape (H, W, C), are all as in the picture."""
    # Some rows at a time: most differ in the first ones, and a whole table of booleans is large.
    return all(np.array_equal(pixels[rows], picture.pixels[rows]) for rows in blocks(len(pixels), _ROWS))


def full_scale_one(pixels: Array) -> Float32s:
    """Return a copy of pixels in which the largest integer of their type is 1; floats stay as they are."""
    values = pixels.astype(np.float32)
    if pixels.dtype.kind != "f":
        values /= np.float32(np.iinfo(pixels.dtype).max)
    return values


def as_stored(values: Float32s, kind: str) -> Array:
    """Round values of full scale 1 to a type, clipped to its range; NaN becomes 0 in integers, halves are float32."""
    if kind == "float32":
        return values
    if kind == "float16":
        largest = np.finfo(np.float16).max
        return np.clip(values, -largest, largest).astype(np.float16).astype(np.float32)
    whole = np.clip(values, 0, 1).astype(np.float64)
    whole *= np.iinfo(kind).max
    np.rint(whole, out=whole)
    whole[np.isnan(whole)] = 0
    return whole.astype(kind)
