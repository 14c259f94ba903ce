"""New textures of meshes, from vertex colours or from their textures."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s, Int32s, Int64s
from beltrami_cli.errors import InputError
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image.alpha import without_alpha
from beltrami_cli.formats.image.decoded_image import DecodedImage, new_image
from beltrami_cli.formats.image.reading import read_texture
from beltrami_cli.formats.image.sample_types import full_scale_one
from beltrami_cli.formats.image.sizes import measure_image
from beltrami_cli.formats.image.writing import write_image
from beltrami_cli.jobs.progress import Progress
from beltrami_cli.jobs.settings import BakeSettings
from beltrami_cli.surface.baking import bake, interpolated, texels_for_vertices
from beltrami_cli.surface.colour_values import linear_to_srgb
from beltrami_cli.surface.coverage import overlap
from beltrami_cli.surface.lookups import look_up
from beltrami_cli.surface.polygons import triangulate
from beltrami_cli.surface.records import (
    Encoding,
    Frame,
    ImageFile,
    Material,
    MaterialMap,
    MeshContents,
    MeshImage,
    Texture,
    TexturedSurface,
)
from beltrami_cli.surface.unwrap import Unwrapped, require_few_faces, unwrap

Depth = type[np.uint8] | type[np.uint16]
_LEVEL_TOLERANCE = 0.05  # of an 8-bit step: numbers this close to levels are taken for 8-bit values
_MAX_OVERLAP = 0.01  # share of texels at several places that rounding at chart boundaries may cause


@dataclass(frozen=True)
class NewTexture:
    """A mesh with its new texture."""

    positions: Float64s
    faces: Int32s
    uv: Float64s  # (F, 3, 2), as in `TexturedSurface`
    space_of: Int32s | None  # as in `ColouredVertices`
    pixels: Array  # uint8 or uint16, (H, W, 3) or (H, W, 4): the texture, sRGB
    charts: int | None  # number of charts, if it was unwrapped
    notices: tuple[str, ...]
    frame: Frame

    def encoded(self, suffix: str | None = None, jpeg_quality: int = 98, *, small: bool = False) -> ImageFile:
        """Return the texture as a file, PNG by default; options as for `write_image`."""
        image = new_image(self.pixels, "the new texture")
        return write_image(image, self.pixels, suffix=suffix, jpeg_quality=jpeg_quality, small=small)

    def surface(self) -> TexturedSurface:
        texture = Texture("new", "the new texture", self.encoded().data, wrap=("clamp", "clamp"))
        texture_of = np.zeros(len(self.faces), np.int32)
        return TexturedSurface(self.positions, self.faces, self.uv, texture_of, (texture,), self.space_of)

    def mesh(self, image: ImageFile) -> MeshContents:
        """Return the mesh with the texture as an image file, for the writers."""
        alpha = self.pixels[..., 3:]
        transparent = bool(alpha.size and (alpha < alpha.max()).any())
        shown = MaterialMap(MeshImage(image), ("clamp", "clamp"))
        material = Material(maps={"baseColor": shown}, alpha="blend" if transparent else "opaque")
        return MeshContents(
            positions=self.positions,
            corners=self.faces.ravel(),
            offsets=3 * np.arange(len(self.faces) + 1),
            colours=np.empty((len(self.positions), 0), np.float32),
            frame=self.frame,
            uv=self.uv.reshape(-1, 2),
            materials=(material,),
        )


def texture_description(file: ImageFile) -> str:
    """Describe a new texture as its file holds it, which may have fewer bits than the colours."""
    size = measure_image(file.data, f"texture{file.suffix}")
    assert size is not None
    bits = 8 * size.sample
    return f"{'an' if bits == 8 else 'a'} {bits}-bit texture of {size.width} x {size.height}"


def texture_from_vertices(
    document: Document,
    settings: BakeSettings,
    progress: Progress | None = None,
    colours: Float32s | None = None,
) -> NewTexture:
    """Interpolate vertex colours, or the given ones, shape (V, C), at the texels of a new texture."""
    # The stored numbers (in glTF linear light) are interpolated, and rounded once.
    contents = document.vertex_mesh(colours)
    faces = triangulate(contents.positions, contents.corners, contents.offsets)
    if not len(faces):
        remedy = "a texture needs a surface; mesh the points first"
        raise InputError(document.name, "it has no triangles", remedy)
    space_of = document.coloured_vertices().space_of
    charts = None
    if settings.keep_uv:
        uv, size = _kept_uv(document, contents.positions[faces], settings.size)
    else:
        texels = texels_for_vertices(contents.positions, faces)
        unwrapped = _unwrapped(document, contents.positions, faces, space_of, texels, settings, progress)
        uv, size, charts = unwrapped.uv, unwrapped.size, unwrapped.charts
    dtype = _depth(contents)
    values = _vertex_values(contents)
    corners = values[faces]

    def shade(owners: Int64s, weights: Float64s) -> Array:
        return _rounded(_as_srgb(interpolated(corners, owners, weights), contents.encoding), dtype)

    pixels = bake(uv, size, shade, values.shape[1], dtype)
    notices = (*contents.notices, *_notices_on_vertices(contents))
    return NewTexture(
        positions=contents.positions, faces=faces, uv=uv, space_of=space_of, pixels=pixels,
        charts=charts, notices=notices, frame=contents.frame,
    )  # fmt: skip


def texture_from_textures(
    document: Document, settings: BakeSettings, progress: Progress | None = None
) -> NewTexture:
    """Move all base colour textures to one new atlas."""
    old = document.textured("baseColor")
    images = [read_texture(texture) for texture in old.textures]
    texels = count_texels(old, np.array([image.pixels.shape[1::-1] for image in images]))
    unwrapped = _unwrapped(document, old.positions, old.faces, old.space_of, texels, settings, progress)
    channels = 4 if any(image.alpha is not None for image in images) else 3
    rgba = [as_rgba(image) for image in images]
    dtype = np.uint8 if all(image.stored == "uint8" for image in images) else np.uint16

    def shade(owners: Int64s, weights: Float64s) -> Array:
        colours = np.ones((len(owners), 4))
        # Points outside a triangle are moved into it, since its texture shows other things there.
        inside = np.clip(weights, 0, 1)
        uv = interpolated(old.uv, owners, inside / np.maximum(inside.sum(axis=1, keepdims=True), 1))
        for index, (image, texture) in enumerate(zip(images, old.textures, strict=True)):
            is_shown = old.texture_of[owners] == index
            values = look_up(rgba[index], uv[is_shown], texture.wrap, None if image.alpha is None else 3)
            colours[is_shown] = _as_srgb(values, image.encoding)
        return _rounded(colours[:, :channels], dtype)

    pixels = bake(unwrapped.uv, unwrapped.size, shade, channels, dtype)
    notices = _notices_on_textures(document, old, images)
    return NewTexture(
        positions=old.positions, faces=old.faces, uv=unwrapped.uv, space_of=old.space_of, pixels=pixels,
        charts=unwrapped.charts, notices=notices, frame=document.frame,
    )  # fmt: skip


def _unwrapped(
    document: Document, positions: Float64s, faces: Int32s, space_of: Int32s | None, texels: float,
    settings: BakeSettings, progress: Progress | None,
) -> Unwrapped:  # fmt: skip
    require_few_faces(len(faces), settings.max_unwrap_faces, document.name)
    return unwrap(
        positions, faces, settings.size, settings.padding, document.name, space_of=space_of, texels=texels,
        progress=None if progress is None else partial(progress, "unwrapping"),
    )  # fmt: skip


def _kept_uv(document: Document, corners: Float64s, side: int | None) -> tuple[Float64s, tuple[int, int]]:
    """Return the document's own texture coordinates, if they do not overlap, and the texture's size."""
    surface = document.textured("baseColor")
    cause = ""
    if surface.faces.shape[0] != len(corners) or (surface.positions[surface.faces] != corners).any():
        cause = "not all of its triangles have vertex colours"
    elif len(surface.textures) > 1 or (surface.texture_of < 0).any():
        cause = "its triangles do not all show one texture"
    elif surface.uv.min() < 0 or surface.uv.max() > 1:
        cause = "its texture coordinates leave the image"
    if not cause:
        height, width = read_texture(surface.textures[0]).pixels.shape[:2]
        scale = 1.0 if side is None else side / max(width, height)
        size = max(1, round(width * scale)), max(1, round(height * scale))
        if overlap(surface.uv, size) <= _MAX_OVERLAP:
            return surface.uv, size
        cause = "its charts overlap in the image"
    raise InputError(document.name, f"its texture coordinates cannot be kept: {cause}", "leave out --keep-uv")


def _vertex_values(contents: MeshContents) -> Float32s:
    colours = contents.colours
    colours = np.repeat(colours, 3, axis=1) if colours.shape[1] == 1 else colours
    if contents.alpha is None or (contents.alpha >= 1).all():
        return colours
    return np.column_stack([colours, contents.alpha])


def _depth(contents: MeshContents) -> Depth:
    """Return the type of the texture: that of the colours, or one that holds them if they are text or linear light."""
    if contents.encoding == "srgb" and contents.stored in ("uint8", "uint16"):
        return np.uint8 if contents.stored == "uint8" else np.uint16
    levels = 255 * _as_srgb(_vertex_values(contents).astype(np.float64), contents.encoding)
    return np.uint8 if np.abs(levels - np.rint(levels)).max(initial=0) < _LEVEL_TOLERANCE else np.uint16


def _notices_on_vertices(contents: MeshContents) -> tuple[str, ...]:
    left = [*contents.left_out, *(["normals"] if contents.normals is not None else [])]
    notices = [f"Not in the new file: {'; '.join(left)}."] if left else []
    if np.any(np.diff(contents.offsets) > 3):
        notices.append("Quads and polygons are cut into triangles.")
    if contents.colours.size and (contents.colours.min() < 0 or contents.colours.max() > 1):
        notices.append("Colours outside [0, 1] are clipped.")
    return tuple(notices)


def _notices_on_textures(
    document: Document, old: TexturedSurface, images: list[DecodedImage]
) -> tuple[str, ...]:
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


def _as_srgb(values: Float64s, encoding: Encoding) -> Float64s:
    """Return colours, shape (N, 3) or (N, 4) with opacity, as display values."""
    if encoding == "srgb":
        return values
    return np.column_stack([linear_to_srgb(values[:, :3]), values[:, 3:]])


def _rounded(values: Float64s, dtype: Depth) -> Array:
    return np.rint(np.clip(values, 0, 1) * np.iinfo(dtype).max).astype(dtype)
