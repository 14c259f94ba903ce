"""From files to what can be drawn: painted surfaces, points, images."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.access import read_source
from beltrami_cli.formats.image import Picture, read_image, to_float, without_alpha
from beltrami_cli.formats.image.recognition import is_image
from beltrami_cli.jobs.opening import document_from
from beltrami_cli.samples.settings.smooth import DEFAULTS, SmoothSettings
from beltrami_cli.samples.textures.colours import COLOUR_SLOTS
from beltrami_cli.surface.colour_values import srgb_to_linear
from beltrami_cli.surface.geometry import triangle_areas
from beltrami_cli.view.rendering.cloud_view import CloudView
from beltrami_cli.view.rendering.image_view import ImageView
from beltrami_cli.view.rendering.paint import TexturePaint, VertexPaint
from beltrami_cli.view.rendering.surface_view import SurfaceView

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.access import Access
    from beltrami_cli.formats.document import Document
    from beltrami_cli.surface.records import PaintedVertices, Slot
    from beltrami_cli.view.settings import RenderSettings

Drawable = SurfaceView | CloudView | ImageView
_FAR = 128  # powers of two, beyond which a model is brought nearer; its fourth powers then stay within 2^256
_RGB = ("red", "green", "blue")


def open_view(
    source: str, settings: RenderSettings, access: Access, reading: SmoothSettings = DEFAULTS
) -> Drawable:
    """Read a file as what is seen of it.

    Parameters
    ----------
    source : str
        A model, points or an image; "-" for standard input.
    settings : RenderSettings
        What is shown of models that have both textures and vertex colours.
    access : Access
        What may be read.
    reading : SmoothSettings
        How level sets are read.

    Raises
    ------
    InputError
        If the file cannot be read, or has no colours of the kind that is asked for.
    ProcessingError
        If the package that draws surfaces is not installed.
    """
    data = read_source(source, access)
    name = "<stdin>" if source == "-" else source
    if is_image(data, name):
        return ImageView(sheet_of(read_image(data, name, finite=False)))
    document = document_from(data, source, reading, access)
    slot: Slot = settings.slot  # type: ignore[assignment]
    has_texture = slot in document.slots()
    if settings.on == "texture" and not has_texture:
        raise InputError(name, f"it has no {slot} texture", "leave out --on")
    if has_texture and settings.on != "vertices":
        return _textured(document, slot)
    return _painted(document.painted())


def sheet_of(picture: Picture, *, is_data: bool = False) -> NDArray[np.float32]:
    """Return an image in linear light with opacity, shape (H, W, 4).

    Parameters
    ----------
    picture : Picture
        Floats are clipped to what can be shown; what is no finite number is transparent.
    is_data : bool
        Whether the numbers are no colours, and are shown as if they were display values.
    """
    values = to_float(picture) if is_data else without_alpha(picture, to_float(picture))
    channels = picture.colour if len(picture.colour) == 3 else picture.colour[:1] * 3
    colours = values[..., channels]
    seen = np.isfinite(colours).all(axis=2, keepdims=True)
    colours = np.clip(np.where(seen, colours, 0), 0, 1)
    light = srgb_to_linear(colours) if picture.encoding == "srgb" or is_data else colours
    opacity = np.clip(values[..., picture.alpha], 0, 1)[..., None] if picture.alpha is not None else 1.0
    opacity = np.where(seen, opacity, 0).astype(np.float32)
    return np.concatenate([light, np.nan_to_num(opacity)], axis=2).astype(np.float32)


def _textured(document: Document, slot: Slot) -> SurfaceView:
    surface = document.textured(slot)
    pictures = [read_image(texture.data, texture.name) for texture in surface.textures]
    sheets = [sheet_of(picture, is_data=slot not in COLOUR_SLOTS) for picture in pictures]
    positions = within_reach(surface.positions)
    areas = triangle_areas(positions, surface.faces)
    return SurfaceView(positions, surface.faces, TexturePaint(surface, sheets, areas))


def _painted(painted: PaintedVertices) -> SurfaceView | CloudView:
    light = light_of(painted)
    finite = np.isfinite(painted.positions).all(axis=1)
    positions = within_reach(painted.positions)
    if len(painted.faces):
        return SurfaceView(positions, painted.faces, VertexPaint(painted.faces, light))
    return CloudView(positions[finite], light[finite])


def within_reach(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return positions times a power of two where squares of areas would leave the range of numbers.

    Others are returned as they are. A picture shows no difference, and models that are alike are scaled alike.
    """
    largest = np.max(np.abs(positions), where=np.isfinite(positions), initial=0.0)
    exponent = np.frexp(largest)[1]
    if abs(exponent) < _FAR:
        return positions
    return np.asarray(np.ldexp(positions, -_FAR * round(exponent / _FAR)), np.float64)


def light_of(painted: PaintedVertices) -> NDArray[np.float64]:
    """Return vertex colours in linear light, shape (V, 3); what is no red, green and blue is grey."""
    is_rgb = set(_RGB) <= set(painted.channels)
    chosen = [painted.channels.index(name) for name in _RGB] if is_rgb else [0, 0, 0]
    colours = np.clip(painted.colours[:, chosen].astype(np.float64), 0, 1)
    return np.asarray(srgb_to_linear(colours) if painted.encoding == "srgb" else colours, np.float64)
