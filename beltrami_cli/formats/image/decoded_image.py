"""A decoded image, as a file holds it or as it is made of pixels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array
from beltrami_cli.errors import InputError
from beltrami_cli.formats.image.channels import (
    channel_names,
    colour_layer,
    coloured_layers,
    colours_and_alpha,
    layers_of,
    named_colours,
)
from beltrami_cli.formats.image.file_formats import suffix_for
from beltrami_cli.formats.image.sample_types import STORED, TYPES
from beltrami_cli.surface.large_arrays import blocks
from beltrami_cli.surface.records import Encoding

ROWS = 64  # of an image that are looked at together, since copies of the whole are large


@dataclass(frozen=True)
class DecodedImage:
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
    format: str  # a key of `file_formats.FORMATS`, or "array" if no file holds it
    suffix: str  # with the dot: the source's own if it fits the format
    notices: tuple[str, ...]  # for the user, one sentence each, with the image's name
    kinds: tuple[str, ...]  # type of every channel in the file; they differ in some EXR files only
    content: bytes | Callable[[], bytes] = field(repr=False)  # the file, or what reads it, as of `Texture`
    spec: Any = field(repr=False)  # OpenImageIO.ImageSpec of the file
    # Layer of an EXR file that holds the colours: "" outside of layers, None if it is ambiguous.
    layer: str | None = ""
    parts: tuple[str, ...] = ()  # names of the parts of an EXR file, which are images of their own
    part: int | None = 0  # the one with the colours; None if it is ambiguous, and the pixels are of the first
    is_alpha_empty: bool = False  # an alpha of 0 everywhere in the file, and of full scale in the pixels

    @property
    def source(self) -> bytes:
        """The file, whose metadata are carried over."""
        return self.content if isinstance(self.content, bytes) else self.content()

    @property
    def is_layered(self) -> bool:
        return layers_of(self.channels).keys() != {""}

    @property
    def names_colours(self) -> bool:
        """Whether other channels are data by their names, such as the depth Z next to R, G and B in an EXR file."""
        is_named = named_colours(channel_names(self.channels)) is not None
        return self.is_layered or (self.format == "openexr" and is_named)


def image_from(
    data: bytes, name: str, file_format: str, spec: Any, pixels: Array, notices: tuple[str, ...] = ()
) -> DecodedImage:
    """Return pixels and their OpenImageIO.ImageSpec as the image in a file (data) of a format (file_format)."""
    kinds = tuple(STORED[str(kind)] for kind in (spec.channelformats or [spec.format] * spec.nchannels))
    channels = tuple(spec.channelnames)
    if file_format == "targa" and len(channels) == 2:  # OpenImageIO calls grey and alpha red and green there.
        channels = ("Y", "A")
    layer = colour_layer(channels)
    colour, alpha = colours_and_alpha(channels, layer)
    return DecodedImage(
        name=name,
        pixels=pixels,
        channels=channels,
        colour=colour,
        alpha=alpha,
        encoding="linear" if pixels.dtype.kind == "f" else "srgb",
        stored=kinds[colour[0]],
        kinds=kinds,
        format=file_format,
        suffix=suffix_for(data, name),
        notices=notices,
        content=data,
        spec=spec,
        layer=layer,
    )


def with_colours_of(image: DecodedImage, layer: str) -> DecodedImage:
    """Return an image with the colours and the alpha of another layer of its file."""
    colour, alpha = colours_and_alpha(image.channels, layer)
    return replace(image, layer=layer, colour=colour, alpha=alpha, stored=image.kinds[colour[0]])


def require_colours(image: DecodedImage, remedy: str) -> None:
    """Raise InputError if it is ambiguous which layer or part of an EXR file holds the colours."""
    if image.part is None:
        cause = f"it has the parts {', '.join(image.parts)}, and several could be the colours"
        raise InputError(image.name, cause, "save the one to be smoothed as a file of its own")
    if image.layer is not None:
        return
    coloured = coloured_layers(image.channels)
    if coloured:
        cause = f"its colours could be the layers {' or '.join(coloured)}"
    else:
        named = [layer for layer in layers_of(image.channels) if layer]
        cause = f"none of its layers {', '.join(named)} has red, green and blue"
    raise InputError(image.name, cause, remedy)


def new_image(pixels: Array, name: str) -> DecodedImage:
    """Describe new sRGB pixels of uint8 or uint16, RGB or RGBA with unassociated alpha, as a PNG without metadata."""
    return replace(array_image(pixels, name, "srgb", str(pixels.dtype)), format="png", suffix=".png")


def array_image(pixels: Array, name: str, encoding: Encoding, stored: str) -> DecodedImage:
    """Describe pixels that no file holds, grey or RGB, with unassociated alpha or without."""
    import OpenImageIO

    height, width, channels = pixels.shape
    spec = OpenImageIO.ImageSpec(width, height, channels, TYPES[stored])
    if channels == 2:  # which OpenImageIO calls red and green
        spec.channelnames = ("Y", "A")
    return replace(image_from(b"", name, "array", spec, pixels), encoding=encoding)


def is_unchanged(image: DecodedImage, pixels: Array) -> bool:
    """Whether pixels, shape (H, W, C), are all as in the image."""
    # Some rows at a time: most differ in the first ones, and a whole table of booleans is large.
    return all(np.array_equal(pixels[rows], image.pixels[rows]) for rows in blocks(len(pixels), ROWS))
