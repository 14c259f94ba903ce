"""A new texture from the textures that a model has."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.formats.image import read_image, to_float, without_alpha
from beltrami_cli.jobs.bake.new_texture import NewTexture, as_srgb, rounded, unwrapped
from beltrami_cli.surface.baking import bake, interpolated
from beltrami_cli.surface.lookup import look_up

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from beltrami_cli.formats.document import Document
    from beltrami_cli.jobs.bake.new_texture import Progress
    from beltrami_cli.jobs.bake.settings import BakeSettings
    from beltrami_cli.surface.records import ImageFile, TexturedSurface


def texture_from_textures(
    document: Document,
    wanted: BakeSettings,
    progress: Progress = None,
    smoothed: Mapping[str, ImageFile] | None = None,
) -> NewTexture:
    """Move all base colour textures to one new atlas.

    `smoothed`, by the keys of the textures, stand in for those of the document where they are given.

    Raises
    ------
    InputError
        If there is no texture, or it cannot be decoded.
    ProcessingError
        If it cannot be unwrapped.
    """
    old = document.textured("baseColor")
    new = [(smoothed or {}).get(texture.key) for texture in old.textures]
    pictures = [
        read_image(texture.data if file is None else file.data, texture.name)
        for texture, file in zip(old.textures, new, strict=True)
    ]
    sizes = np.array([picture.pixels.shape[1::-1] for picture in pictures])
    made = unwrapped(
        document, old.positions, old.faces, old.space_of, texels_of(old, sizes), wanted, progress
    )
    channels = 4 if any(picture.alpha is not None for picture in pictures) else 3
    images = []
    for picture in pictures:
        values = without_alpha(picture, to_float(picture))
        colour = values[..., [*picture.colour] * (3 // len(picture.colour))]
        alpha = np.ones_like(values[..., :1]) if picture.alpha is None else values[..., [picture.alpha]]
        images.append(np.concatenate([colour, alpha], axis=2))
    dtype = np.uint8 if all(picture.stored == "uint8" for picture in pictures) else np.uint16

    def shade(owners: NDArray[np.int64], weights: NDArray[np.float64]) -> NDArray[Any]:
        seen = np.ones((len(owners), 4))
        uv = interpolated(old.uv, owners, _within(weights))
        for index, (picture, texture) in enumerate(zip(pictures, old.textures, strict=True)):
            mine = old.texture_of[owners] == index
            values = look_up(images[index], uv[mine], texture.wrap, None if picture.alpha is None else 3)
            seen[mine] = as_srgb(values, picture.encoding)
        return rounded(seen[:, :channels], dtype)

    pixels = bake(made.uv, made.size, shade, channels, dtype)
    notices = [
        f"{document.format.upper()} content other than triangles and the base colour is not in the new file."
    ]
    bare = int((old.texture_of < 0).sum())
    notices += [f"{bare} triangles have no texture, and are white in the new one."] if bare else []
    if any(picture.encoding == "linear" for picture in pictures):
        notices.append("Float textures become 16-bit sRGB, clipped to 0..1.")
    return NewTexture(old.positions, old.faces, made.uv, old.space_of, pixels, made.charts, tuple(notices))


def texels_of(surface: TexturedSurface, sizes: NDArray[np.int64]) -> float:
    """Return how many texels the textured triangles have together."""
    painted = surface.texture_of >= 0
    corners = surface.uv[painted] * sizes[surface.texture_of[painted]][:, None]
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return float(np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]).sum() / 2)


def _within(weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Move places beside a triangle into it: what its texture shows there belongs to something else."""
    inside: NDArray[np.float64] = np.clip(weights, 0, 1)
    inside /= np.maximum(inside.sum(axis=1, keepdims=True), 1)
    return inside
