"""Checks that images fit into memory, before any of them is decoded."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator
from pathlib import Path

from beltrami_cli.errors import InputError
from beltrami_cli.formats.access import Access
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image.reading import ImageSize, measure_image
from beltrami_cli.layers.settings import TextureSettings
from beltrami_cli.layers.texel_colours import choose_textures
from beltrami_cli.surface.large_arrays import kept_within
from beltrami_cli.surface.records import Slot

# Bytes per pixel and per sample that a job on images needs in memory at least, besides the decoded images: to paint one
# at a time, its old and new colours in single precision; to smooth an image without files, the least of the peaks on
# noise of 1536 x 1536 pixels with one channel and three (40 + 13); to compare two (36 + 1); to read heights or
# positions, as coordinates in double precision, as read and for each pixel.
PIXEL_BYTES = {"painted": (0, 2 * 4), "smoothed": (40, 13), "compared": (36, 1), "mapped": (3 * 8, 8)}

# Bytes per texel of all textures, or per pixel of an image, that stay in memory where large arrays are in files: masks.
# 16 textures of 2048 x 2048, limited to 180 MB, took 270 MB with the program's own 90 and arrays of 45: 2.0 a texel.
_MASKS = 2


def require_memory(
    images: Iterable[tuple[str, bytes]], access: Access, pixel_bytes: tuple[int, int] = PIXEL_BYTES["painted"]
) -> None:
    """Raise InputError if images cannot fit into memory: all as stored, and one of them as it is worked on.

    `pixel_bytes`: what that takes per pixel and per sample, by default that it is twice there as floats.
    """
    if access.memory is None:
        return
    decoded, working = 0, 0
    for name, size, _ in _measured(images):
        decoded += size.decoded
        working = max(working, pixel_bytes[0] * size.texels + pixel_bytes[1] * size.samples)
        if decoded + working > access.memory:
            raise _too_large(name, size)


def require_memory_for_textures(
    document: Document, slots: Iterable[Slot], wanted: TextureSettings, access: Access
) -> None:
    """Raise InputError if the chosen textures of a document cannot fit into memory, slot by slot."""
    for images in _files(document, slots, wanted):
        require_memory(images, access)


@contextlib.contextmanager
def within_memory(
    document: Document,
    slots: Iterable[Slot],
    wanted: TextureSettings,
    access: Access,
    target: str | None = None,
    *,
    in_files: bool = True,
) -> Iterator[None]:
    """Keep large arrays in files, in the folder of `target`, where memory is too small for all of them.

    InputError if it is too small even so, for textures of some slots, or for the image that the document is; or if
    arrays are not to be `in_files`, as for work that makes many in memory. Besides arrays there must be room for one
    image as it is decoded, and for the new file, about as large as the old one, without and with its metadata.
    """
    if not in_files:
        for images in _files(document, slots, wanted):
            require_memory(images, access, PIXEL_BYTES["smoothed"])
    if access.memory is None or not in_files:
        yield
        return
    memory = access.memory - len(document.data)
    left = memory
    for images in _files(document, slots, wanted):
        largest = texels = 0
        for name, size, stored in _measured(images):
            largest, texels = max(largest, size.decoded + 2 * stored), texels + size.texels
            left = min(left, memory - largest - _MASKS * texels)
            if left < 0:
                raise _too_large(name, size)
    with kept_within(left, Path(target).absolute().parent if target else None):
        yield


def _files(
    document: Document, slots: Iterable[Slot], wanted: TextureSettings
) -> Iterator[Iterator[tuple[str, bytes]]]:
    """Give the names and bytes of the images that are painted together: of each slot, or the document's own."""
    if document.kind == "image":
        yield iter([(document.name, document.data)])
        return
    for slot in slots:
        textures = choose_textures(document.textured(slot), wanted).textures
        yield ((texture.name, texture.data) for texture in textures)


def _measured(images: Iterable[tuple[str, bytes]]) -> Iterator[tuple[str, ImageSize, int]]:
    """Measure images and their files; those that fail are left to their decoder, which raises the error."""
    for name, data in images:
        size = measure_image(data, name)
        if size is not None:
            yield name, size, len(data)


def _too_large(name: str, size: ImageSize) -> InputError:
    """Return the error that an image, with those around it, needs more memory than there is."""
    cause = f"its {size.width} x {size.height} pixels of {size.channels} channels do not fit into memory"
    return InputError(name, cause, "scale it down, or raise --max-memory")
