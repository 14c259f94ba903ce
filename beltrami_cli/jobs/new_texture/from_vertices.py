"""New textures from vertex colours."""

from __future__ import annotations

from functools import partial

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s, Int64s
from beltrami_cli.errors import InputError
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image.reading import read_texture
from beltrami_cli.jobs.new_texture.texture import (
    Depth,
    NewTexture,
    as_srgb,
    quantised,
    unwrap_within_limit,
)
from beltrami_cli.jobs.progress import Progress
from beltrami_cli.jobs.settings import BakeSettings
from beltrami_cli.surface.baking import bake, interpolated, texels_for_vertices
from beltrami_cli.surface.coverage import overlap
from beltrami_cli.surface.polygons import triangulate
from beltrami_cli.surface.records import Encoding, MeshContents

_LEVEL_TOLERANCE = 0.05  # of an 8-bit step: numbers this close to levels are taken for 8-bit values
_MAX_OVERLAP = 0.01  # share of texels at several places that rounding at chart boundaries may cause


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
        unwrapped = unwrap_within_limit(
            document, contents.positions, faces, space_of, texels, settings, progress
        )
        uv, size, charts = unwrapped.uv, unwrapped.size, unwrapped.charts
    values = _vertex_values(contents)
    depth = _depth(contents, values)
    pixels = bake(uv, size, partial(_shade, values[faces], contents.encoding, depth), values.shape[1], depth)
    notices = (*contents.notices, *_notices(contents))
    return NewTexture(
        positions=contents.positions, faces=faces, uv=uv, space_of=space_of, pixels=pixels,
        charts=charts, notices=notices, frame=contents.frame,
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


def _depth(contents: MeshContents, values: Float32s) -> Depth:
    """Return the type of the texture: that of the colours, or one that holds them if they are text or linear light."""
    if contents.encoding == "srgb" and contents.stored in ("uint8", "uint16"):
        return np.uint8 if contents.stored == "uint8" else np.uint16
    levels = 255 * as_srgb(values.astype(np.float64), contents.encoding)
    return np.uint8 if np.abs(levels - np.rint(levels)).max(initial=0) < _LEVEL_TOLERANCE else np.uint16


def _shade(corners: Float32s, encoding: Encoding, depth: Depth, owners: Int64s, weights: Float64s) -> Array:
    """Return the pixels at points of the triangles `owners`; `corners` are colours, (F, 3, C)."""
    return quantised(as_srgb(interpolated(corners, owners, weights), encoding), depth)


def _notices(contents: MeshContents) -> tuple[str, ...]:
    left = [*contents.left_out, *(["normals"] if contents.normals is not None else [])]
    notices = [f"Not in the new file: {'; '.join(left)}."] if left else []
    if np.any(np.diff(contents.offsets) > 3):
        notices.append("Quads and polygons are cut into triangles.")
    if contents.colours.size and (contents.colours.min() < 0 or contents.colours.max() > 1):
        notices.append("Colours outside [0, 1] are clipped.")
    return tuple(notices)
