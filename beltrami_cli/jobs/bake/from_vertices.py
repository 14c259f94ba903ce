"""A new texture from vertex colours."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.image import read_image
from beltrami_cli.jobs.bake.new_texture import NewTexture, as_srgb, rounded, unwrapped
from beltrami_cli.surface.baking import bake, interpolated, overlap, texels_for_vertices
from beltrami_cli.surface.polygons import triangulate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.document import Document
    from beltrami_cli.jobs.bake.new_texture import Progress
    from beltrami_cli.jobs.bake.settings import BakeSettings
    from beltrami_cli.surface.records import MeshContents

_ON_A_LEVEL = 0.05  # of an 8-bit step: numbers this close to levels came from 8 bits
_SHARED = 0.01  # share of texels at several places that rounding at the edges of charts may make


def texture_from_vertices(
    document: Document,
    wanted: BakeSettings,
    progress: Progress = None,
    colours: NDArray[np.float32] | None = None,
) -> NewTexture:
    """Spread the vertex colours over the texels of a texture.

    `colours`, shape (V, C), stand in for those of the document if they are given.

    They are interpolated as the numbers that are stored (in glTF linear light), and rounded once: to 8 bits if 8 bits
    hold the colours, otherwise to 16.

    Raises
    ------
    InputError
        If there are no vertex colours or no triangles, or the texture coordinates cannot be kept.
    ProcessingError
        If it cannot be unwrapped.
    """
    contents = document.contents()
    faces = triangulate(contents.positions, contents.corners, contents.offsets)
    if not len(faces):
        raise InputError(
            document.name, "it has no triangles", "a texture needs a surface; mesh the points first"
        )
    space_of = document.painted().space_of
    if wanted.keep_uv:
        uv, size = _kept_uv(document, contents.positions[faces], wanted.size)
        charts = None
    else:
        texels = texels_for_vertices(contents.positions, faces)
        made = unwrapped(document, contents.positions, faces, space_of, texels, wanted, progress)
        uv, size, charts = made.uv, made.size, made.charts
    dtype = _depth(contents)
    if colours is not None:
        contents = dataclasses.replace(contents, colours=colours)
    values = _vertex_values(contents)
    corners = values[faces]

    def shade(owners: NDArray[np.int64], weights: NDArray[np.float64]) -> NDArray[Any]:
        return rounded(as_srgb(interpolated(corners, owners, weights), contents.encoding), dtype)

    pixels = bake(uv, size, shade, values.shape[1], dtype)
    notices = tuple(_left_behind(contents))
    return NewTexture(contents.positions, faces, uv, space_of, pixels, charts, notices)


def _kept_uv(
    document: Document, corners: NDArray[np.float64], side: int | None
) -> tuple[NDArray[np.float64], tuple[int, int]]:
    """Return the document's own texture coordinates, if every texel of them is at one place, and the texture's size."""
    surface = document.textured("baseColor")
    cause = ""
    if surface.faces.shape[0] != len(corners) or (surface.positions[surface.faces] != corners).any():
        cause = "not all of its triangles have vertex colours"
    elif len(surface.textures) > 1 or (surface.texture_of < 0).any():
        cause = "its triangles do not all show one texture"
    elif surface.uv.min() < 0 or surface.uv.max() > 1:
        cause = "its texture coordinates leave the image"
    if not cause:
        height, width = read_image(surface.textures[0].data, surface.textures[0].name).pixels.shape[:2]
        scale = 1.0 if side is None else side / max(width, height)
        size = max(1, round(width * scale)), max(1, round(height * scale))
        if overlap(surface.uv, size) <= _SHARED:
            return surface.uv, size
        cause = "its charts overlap in the image"
    raise InputError(document.name, f"its texture coordinates cannot be kept: {cause}", "leave out --keep-uv")


def _vertex_values(contents: MeshContents) -> NDArray[np.float32]:
    colours = contents.colours
    colours = np.repeat(colours, 3, axis=1) if colours.shape[1] == 1 else colours
    if contents.alpha is None or (contents.alpha >= 1).all():
        return colours
    return np.column_stack([colours, contents.alpha])


def _depth(contents: MeshContents) -> type[np.uint8] | type[np.uint16]:
    """Return the type of the texture: that of the colours, or what holds them where they are text or linear light."""
    if contents.encoding == "srgb" and contents.stored in ("uint8", "uint16"):
        return np.uint8 if contents.stored == "uint8" else np.uint16
    levels = 255 * as_srgb(_vertex_values(contents).astype(np.float64), contents.encoding)
    return np.uint8 if np.abs(levels - np.rint(levels)).max(initial=0) < _ON_A_LEVEL else np.uint16


def _left_behind(contents: MeshContents) -> list[str]:
    left = [*contents.left_out, *(["normals"] if contents.normals is not None else [])]
    notices = [f"Not in the new file: {'; '.join(left)}."] if left else []
    if np.any(np.diff(contents.offsets) > 3):
        notices.append("Quads and polygons are cut into triangles.")
    if contents.colours.size and (contents.colours.min() < 0 or contents.colours.max() > 1):
        notices.append("Colours outside [0, 1] are clipped.")
    return notices
