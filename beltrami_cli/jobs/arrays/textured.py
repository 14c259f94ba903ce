"""Smooth the textures of a mesh: arrays in, arrays out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from beltrami_cli.arrays import Array
from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.fields import override
from beltrami_cli.formats.image.decoded_image import DecodedImage, array_image
from beltrami_cli.jobs.arrays.arguments import (
    ARRAYS,
    array_of,
    colour_table,
    face_table,
    image_array,
    in_type_of,
    numbers_of,
    position_table,
    require_choice,
)
from beltrami_cli.jobs.arrays.mesh_arrays import MeshArrays, mesh_arrays
from beltrami_cli.jobs.progress import PhaseProgress
from beltrami_cli.jobs.smoothing import smooth_layer
from beltrami_cli.layers.reports import SlotReport
from beltrami_cli.layers.settings import DEFAULTS, LevelSettings, SmoothSettings
from beltrami_cli.layers.texture_layer import TextureLayer
from beltrami_cli.surface.precision import require_finite, require_scale
from beltrami_cli.surface.records import Encoding, Texture, TexturedSurface
from beltrami_cli.surface.slots import SLOTS, Slot


@dataclass(frozen=True)
class TexturedResult:
    """Smoothed textures, with the parameters used and statistics.

    Attributes
    ----------
    images : list of ndarray
        In the shape, type and encoding of the input; what did not change is bit-identical to it.
    report : SlotReport
        Parameters, noise, change and statistics, as in the report of a file.
    warnings : list of str
        Messages for the user, such as that no texel is covered by the surface.
    """

    images: list[Array]
    report: SlotReport
    warnings: list[str]


def smooth_textured(
    mesh: Any,
    images: Sequence[ArrayLike] | None = None,
    settings: SmoothSettings = DEFAULTS,
    *,
    texture_of: ArrayLike | None = None,
    origin: Literal["lower", "upper"] = "lower",
    slot: Slot = "baseColor",
    encoding: Encoding = "srgb",
    progress: PhaseProgress | None = None,
    **overrides: Any,
) -> TexturedResult:
    """Smooth the textures of a mesh over its surface, across their seams, with the short-time Beltrami kernel.

    Parameters
    ----------
    mesh : MeshArrays or trimesh.Trimesh
        Triangles with texture coordinates; beyond 0 and 1 these repeat the image.
    images : sequence of array_like, shape (H, W) or (H, W, C), optional
        Textures of one slot, by default the image of the mesh: grey or RGB, with opacity or without, row 0 the upper
        one. Types as for `smooth`, all finite. Texels of opacity 0 supply no colour.
    settings : SmoothSettings
        As for `smooth`. Settings that choose parts of a file, or how files are written, have no effect.
    texture_of : array_like of int, shape (F,), optional
        Index of each face's image, -1 for none; needed with several images.
    origin : {"lower", "upper"}
        The edge of the image where v is 0: lower as in OBJ, trimesh, Open3D and Blender, upper as in glTF.
    slot : {"baseColor", "emissive", "normal", "occlusion", "metallicRoughness"}
        What the images are of; the last three are data rather than colours.
    encoding : {"srgb", "linear"}
        Encoding of colours.
    progress : callable, optional
        As for `smooth`.
    **overrides
        As for `smooth`, with channels named "red", "green", "blue" or "grey"; no arrays of noise.

    Returns
    -------
    TexturedResult
        With ``images`` in the shapes and types of the input.

    Raises
    ------
    UsageError
        If a parameter is unknown, out of its range or only for files, the shape or type of an array is wrong, or a
        vertex or image with a number does not exist.
    InputError
        If positions, texture coordinates or images are not finite.
    """
    settings = override(settings, **overrides)
    guides, noise = settings.embedding.guides, settings.kernel.given_noise
    if guides or settings.embedding.smooth_geometry or (noise is not None and noise.source):
        raise UsageError("smooth_textured takes no guides, files of noise or smooth_geometry")
    require_choice("slot", slot, SLOTS)
    arrays = mesh_arrays(mesh) or MeshArrays(mesh)
    if images is None:
        images = [] if arrays.image is None else [arrays.image]
    given = [image_array(image, f"image {number}") for number, image in enumerate(images)]
    require_choice("encoding", encoding)
    decoded = [_decoded(image, f"image {number}", encoding) for number, image in enumerate(given)]
    names = [image.name for image in decoded]
    surface = _textured_surface(arrays, names, texture_of, origin)
    # Images that other slots show, too, are handed back as pixels, not as files: here all of them.
    layer = TextureLayer.read(surface, slot, settings, shared=names, decoded=decoded)
    done = smooth_layer(layer.levelled(LevelSettings()) if settings.level_seams else layer, progress)
    assert isinstance(done.report, SlotReport)
    smoothed = [
        in_type_of(old, image.pixels, new.pixels).reshape(old.shape)
        for old, image, new in zip(given, decoded, done.stored.shared, strict=True)
    ]
    return TexturedResult(smoothed, done.report, [*done.warnings, *done.stored.notices])


def _textured_surface(
    mesh: MeshArrays, names: Sequence[str], texture_of: ArrayLike | None, origin: str
) -> TexturedSurface:
    """Check positions, faces and texture coordinates, with v from an edge, for images of some names."""
    if mesh.uv is None or mesh.faces is None:
        raise UsageError("the mesh has no texture coordinates; give MeshArrays(positions, faces, uv=uv)")
    require_choice("origin", origin, ("lower", "upper"))
    positions = numbers_of(position_table(mesh.positions), "positions", ("V", 3))
    require_finite(positions, ARRAYS, "the position of vertex")
    faces, uv = face_table(mesh.faces, len(positions)), array_of(mesh.uv, "uv")
    if uv.ndim == 2:
        uv = numbers_of(uv, "uv", (len(positions), 2))[faces]
    uv = numbers_of(uv, "uv", (len(faces), 3, 2)).astype(np.float64)
    image_of = np.zeros(len(faces), np.int32) if texture_of is None else texture_of
    image_of = numbers_of(image_of, "texture_of", (len(faces),), "ui")
    is_clear = len(names) == 1 or (names and texture_of is not None)
    if not is_clear or not np.isin(image_of, range(-1, len(names))).all():
        raise UsageError(f"there are {len(names)} images; texture_of must give each face one of them, or -1")
    shown = np.flatnonzero(image_of >= 0)
    require_finite(uv[shown].reshape(-1, 6), ARRAYS, "uv of face", shown)
    require_scale(positions, faces[shown], ARRAYS)
    if origin == "lower":
        uv[..., 1] = 1 - uv[..., 1]
    textures = tuple(Texture(name, name, b"") for name in names)
    return TexturedSurface(positions, faces, uv, image_of.astype(np.int32), textures)


def _decoded(image: Array, name: str, encoding: Encoding) -> DecodedImage:
    """Take a texture: numbers as for `colour_table`, grey or RGB, with opacity or without."""
    if image.ndim not in (2, 3) or image.size == 0 or image.shape[2:] > (4,):
        wanted = "(H, W), or (H, W, C) with C from 1 to 4"
        raise UsageError(f"{name} must be of shape {wanted}, not {image.shape}")
    pixels, kind = image.reshape(*image.shape[:2], -1), image.dtype
    if kind not in (np.uint8, np.uint16):
        pixels = colour_table(pixels.reshape(-1, pixels.shape[2])).reshape(pixels.shape)
        if not np.isfinite(pixels).all():
            raise InputError(name, "some of its values are not finite", "repair it")
    stored = "float16" if kind == np.float16 else str(pixels.dtype)
    return array_image(pixels, name, encoding, stored)
