"""New textures from the textures of a model."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s, Int64s
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image.alpha import without_alpha
from beltrami_cli.formats.image.decoded_image import DecodedImage
from beltrami_cli.formats.image.reading import read_texture
from beltrami_cli.formats.image.sample_types import full_scale_one
from beltrami_cli.jobs.new_texture.texture import (
    Depth,
    NewTexture,
    as_srgb,
    quantised,
    unwrap_within_limit,
)
from beltrami_cli.jobs.progress import Progress
from beltrami_cli.jobs.settings import BakeSettings
from beltrami_cli.surface.baking import bake, interpolated
from beltrami_cli.surface.lookups import look_up
from beltrami_cli.surface.records import TexturedSurface


def texture_from_textures(
    document: Document, settings: BakeSettings, progress: Progress | None = None
) -> NewTexture:
    """Move all base colour textures to one new atlas."""
    old = document.textured("baseColor")
    images = [read_texture(texture) for texture in old.textures]
    texels = count_texels(old, np.array([image.pixels.shape[1::-1] for image in images]))
    unwrapped = unwrap_within_limit(
        document, old.positions, old.faces, old.space_of, texels, settings, progress
    )
    channels = 4 if any(image.alpha is not None for image in images) else 3
    depth: Depth = np.uint8 if all(image.stored == "uint8" for image in images) else np.uint16
    shade = partial(_shade, old, images, [as_rgba(image) for image in images], channels, depth)
    pixels = bake(unwrapped.uv, unwrapped.size, shade, channels, depth)
    notices = _notices(document, old, images)
    return NewTexture(
        positions=old.positions, faces=old.faces, uv=unwrapped.uv, space_of=old.space_of, pixels=pixels,
        charts=unwrapped.charts, notices=notices, frame=document.frame,
    )  # fmt: skip


def _shade(
    old: TexturedSurface, images: Sequence[DecodedImage], rgba: Sequence[Float32s], channels: int, depth: Depth,
    owners: Int64s, weights: Float64s,
) -> Array:  # fmt: skip
    """Return the pixels at points of the triangles `owners`, white where they have no texture."""
    colours = np.ones((len(owners), 4))
    # Points outside a triangle are moved into it, since its texture shows other things there.
    inside = np.clip(weights, 0, 1)
    uv = interpolated(old.uv, owners, inside / np.maximum(inside.sum(axis=1, keepdims=True), 1))
    for index, (image, texture) in enumerate(zip(images, old.textures, strict=True)):
        is_shown = old.texture_of[owners] == index
        values = look_up(rgba[index], uv[is_shown], texture.wrap, None if image.alpha is None else 3)
        colours[is_shown] = as_srgb(values, image.encoding)
    return quantised(colours[:, :channels], depth)


def _notices(document: Document, old: TexturedSurface, images: Sequence[DecodedImage]) -> tuple[str, ...]:
    what = f"{document.format.upper()} content other than triangles and the base colour"
    notices = [f"{what} is not in the new file.", *(f"Nor are {each}." for each in document.hidden_places())]
    if untextured := int((old.texture_of < 0).sum()):
        notices.append(f"{untextured} triangles have no texture, and are white in the new one.")
    if any(image.encoding == "linear" for image in images):
        notices.append("Float textures become 16-bit sRGB, clipped to 0..1.")
    return tuple(notices)


def count_texels(surface: TexturedSurface, sizes: Int64s) -> float:
    """Return the total number of texels of the textured triangles."""
    is_textured = surface.texture_of >= 0
    corners = surface.uv[is_textured] * sizes[surface.texture_of[is_textured]][:, None]
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return float(np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]).sum() / 2)


def as_rgba(image: DecodedImage) -> Float32s:
    """Convert an image to red, green, blue and opacity of full scale 1."""
    values = without_alpha(image, full_scale_one(image.pixels))
    colour = values[..., [*image.colour] * (3 // len(image.colour))]
    alpha = np.ones_like(values[..., :1]) if image.alpha is None else values[..., [image.alpha]]
    return np.concatenate([colour, alpha], axis=2)
