"""Images as pages hold them: files that browsers show."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from PIL import Image

from beltrami_cli.arrays import Uint8s
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image.decoded_image import DecodedImage
from beltrami_cli.formats.image.reading import read_image, read_texture
from beltrami_cli.surface.records import Slot, Texture
from beltrami_cli.surface.slots import COLOUR_SLOTS
from beltrami_cli.view.light import displayed_pixels
from beltrami_cli.view.pages.rendering import png_of

ImageBytes = tuple[str, bytes]  # MIME type and content
_MIME = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg"}


def textures_of(document: Document, slot: Slot | None) -> tuple[Texture, ...]:
    """Return the textures of a layer; an image is one."""
    if slot is not None:
        return document.textured(slot).textures
    return (Texture("", document.name, document.data),)


def image_of(texture: Texture, slot: Slot, picture: Callable[[], DecodedImage] | None = None) -> ImageBytes:
    """Return the MIME type and bytes of a texture: its own if browsers show its format, or else a PNG file."""
    mime = next((mime for mark, mime in _MIME.items() if texture.data.startswith(mark)), None)
    if mime is not None:
        return mime, texture.data
    shown = read_texture(texture) if picture is None else picture()
    return "image/png", _png(displayed_pixels(shown, is_data=slot not in COLOUR_SLOTS))


def _png(pixels: Uint8s) -> bytes:
    return png_of(pixels[..., :3] if (pixels[..., 3] == 255).all() else pixels)


def resized(image: ImageBytes, share: float) -> ImageBytes:
    """Return an image, scaled down by averages of display values, as a PNG file."""
    shown = Image.fromarray(displayed_pixels(read_image(image[1], "a picture")))
    width, height = (max(1, int(share * side)) for side in shown.size)
    return "image/png", _png(np.asarray(shown.resize((width, height), Image.Resampling.BOX)))
