"""Opens files as views: of a coloured surface, of points or of an image."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from beltrami_cli.errors import InputError, MemoryLimitError
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.files.access import Access
from beltrami_cli.formats.image.reading import read_texture
from beltrami_cli.formats.image.sizes import measure_image
from beltrami_cli.jobs.opening import open_input
from beltrami_cli.jobs.progress import Progress, tracked
from beltrami_cli.layers.settings import DEFAULTS, SmoothSettings
from beltrami_cli.surface.geometry import triangle_areas
from beltrami_cli.surface.records import Slot
from beltrami_cli.surface.slots import COLOUR_SLOTS
from beltrami_cli.view.drawing.cameras import within_reach
from beltrami_cli.view.drawing.cloud_view import CloudView
from beltrami_cli.view.drawing.image_view import ImageView
from beltrami_cli.view.drawing.surface_colours import InterpolatedColours, TextureColours
from beltrami_cli.view.drawing.surface_view import SurfaceView
from beltrami_cli.view.light import linear_colours, linear_pixels
from beltrami_cli.view.settings import RenderSettings

_TEXEL_BYTES = 22  # of a texel: four floats, and a third more for smaller copies


Drawable = SurfaceView | CloudView | ImageView


def open_views(
    sources: Sequence[str],
    settings: RenderSettings,
    access: Access,
    reading: SmoothSettings = DEFAULTS,
    progress: Progress | None = None,
) -> list[Drawable]:
    """Read files, or "-" for standard input, as views; `reading`: how level sets are read."""
    documents = [open_input(source, reading, access) for source in sources]
    require_memory_to_draw(documents, settings, access)
    return [view_of(document, settings) for document in tracked(documents, "reading", progress)]


def require_memory_to_draw(
    documents: Sequence[Document], settings: RenderSettings, access: Access, remedy: str = ""
) -> None:
    """Raise InputError if the visible images of documents do not fit into memory together, before any is decoded."""
    if access.memory is None:
        return
    texels = largest = 0
    for document in documents:
        for data, name in _image_files(document, () if settings.on == "vertices" else (settings.slot,)):
            size = measure_image(data, name)
            if size is not None:  # otherwise the decoder reports the error
                texels, largest = texels + size.texels, max(largest, size.decoded)
        if _TEXEL_BYTES * texels + largest > access.memory:
            cause = f"{texels / 1e6:.3g} million texels do not fit into memory to be drawn"
            raise MemoryLimitError(document.name, cause, f"raise --max-memory{remedy}")


def view_of(document: Document, settings: RenderSettings) -> Drawable:
    """Return the view of an image, or else of the textures, the vertex colours or the points of a document."""
    if document.kind == "image":
        return ImageView(linear_pixels(document.image()))
    slot: Slot = settings.slot  # type: ignore[assignment]
    has_texture = slot in document.slots()
    if has_texture and settings.on == "auto":
        has_texture = bool(document.readable([slot]))
    if settings.on == "texture" and not has_texture:
        raise InputError(document.name, f"it has no {slot} texture", "leave out --show")
    if has_texture and settings.on != "vertices":
        surface = document.textured(slot)
        is_data = slot not in COLOUR_SLOTS
        images = [linear_pixels(read_texture(texture), is_data=is_data) for texture in surface.textures]
        positions = within_reach(surface.positions)
        areas = triangle_areas(positions, surface.faces)
        return SurfaceView(positions, surface.faces, TextureColours(surface, images, areas))
    vertices = document.coloured_vertices()
    light, finite = linear_colours(vertices), np.isfinite(vertices.positions).all(axis=1)
    positions = within_reach(vertices.positions)
    if len(vertices.faces):
        return SurfaceView(positions, vertices.faces, InterpolatedColours(vertices.faces, light))
    return CloudView(positions[finite], light[finite])


def _image_files(document: Document, slots: Collection[str]) -> list[tuple[bytes, str]]:
    """Return the image files of a document, with their names; of a model, the textures of some slots."""
    if document.kind == "image":
        return [(document.data, document.name)]
    readable = document.readable(slot for slot in document.slots() if slot in slots)
    textures = [texture for slot in readable for texture in document.textured(slot).textures]
    return [(texture.data, texture.name) for texture in textures]
