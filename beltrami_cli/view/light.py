"""Colours of images and vertices as linear light, which is drawn, and as display values, which pages show."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Float32s, Float64s, Uint8s
from beltrami_cli.formats.image.alpha import is_associated, without_alpha
from beltrami_cli.formats.image.decoded_image import DecodedImage
from beltrami_cli.formats.image.sample_types import full_scale_one
from beltrami_cli.surface.colour_map import as_bytes
from beltrami_cli.surface.colour_values import linear_to_srgb, srgb_to_linear
from beltrami_cli.surface.records import ColouredVertices

LinearPixels = Float32s
"""An image in linear light with opacity, shape (H, W, 4); colours are not multiplied by it."""

_RGB = ("red", "green", "blue")


def linear_pixels(image: DecodedImage, *, is_data: bool = False) -> Float32s:
    """Return an image in linear light with opacity, (H, W, 4); data are shown as if they were display values."""
    channels = image.colour if len(image.colour) == 3 else image.colour[:1] * 3
    pixels = image.pixels
    if pixels.dtype.kind == "u" and not is_associated(image):
        # Each level of integers is turned into linear light once.
        levels = full_scale_one(np.arange(np.iinfo(pixels.dtype).max + 1, dtype=pixels.dtype))
        light = srgb_to_linear(levels).astype(np.float32)
        linear = np.ones((*pixels.shape[:2], 4), np.float32)
        for number, channel in enumerate(channels):
            linear[..., number] = light.take(pixels[..., channel])
        if image.alpha is not None:
            linear[..., 3] = levels.take(pixels[..., image.alpha])
        return linear
    # Floats are clipped to the visible range, and transparent if not finite.
    values = full_scale_one(image.pixels) if is_data else without_alpha(image, full_scale_one(image.pixels))
    colours = values[..., channels]
    seen = np.isfinite(colours).all(axis=2, keepdims=True)
    colours = np.clip(np.where(seen, colours, 0), 0, 1)
    light = srgb_to_linear(colours) if image.encoding == "srgb" or is_data else colours
    opacity = np.clip(values[..., image.alpha], 0, 1)[..., None] if image.alpha is not None else 1.0
    opacity = np.where(seen, opacity, 0).astype(np.float32)
    return np.concatenate([light, np.nan_to_num(opacity)], axis=2).astype(np.float32)


def linear_colours(vertices: ColouredVertices) -> Float64s:
    """Return vertex colours in linear light, (V, 3); channels other than red, green and blue are shown as grey."""
    is_rgb = set(_RGB) <= set(vertices.channels)
    chosen = [vertices.channels.index(name) for name in _RGB] if is_rgb else [0, 0, 0]
    colours = np.clip(vertices.colours[:, chosen].astype(np.float64), 0, 1)
    return np.asarray(srgb_to_linear(colours) if vertices.encoding == "srgb" else colours, np.float64)


def displayed_pixels(image: DecodedImage, *, is_data: bool = False) -> Uint8s:
    """Return an image as display values with opacity, (H, W, 4), see `linear_pixels`."""
    pixels = image.pixels
    if pixels.dtype != np.uint8 or is_associated(image):
        linear = linear_pixels(image, is_data=is_data)
        return as_bytes(np.concatenate([linear_to_srgb(linear[..., :3]), linear[..., 3:]], axis=2))
    shown = np.full((*pixels.shape[:2], 4), 255, np.uint8)
    shown[..., :3] = pixels[..., image.colour if len(image.colour) == 3 else image.colour[:1] * 3]
    if image.alpha is not None:
        shown[..., 3] = pixels[..., image.alpha]
    return shown


def displayed_colours(vertices: ColouredVertices) -> NDArray[np.uint16]:
    """Return vertex colours as display values of 16 bits, (V, 3)."""
    return np.asarray(np.rint(np.iinfo(np.uint16).max * linear_to_srgb(linear_colours(vertices))), np.uint16)
