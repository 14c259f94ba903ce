"""Checks that images fit into memory, by the sizes in their headers and by what is done with them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from beltrami_cli.errors import InputError, MemoryLimitError
from beltrami_cli.formats.files.access import Access
from beltrami_cli.formats.image.sizes import ImageSize, measure_image

# Bytes per pixel and per sample that a job on images needs at least, besides the decoded images: to recolour one
# at a time, its old and new colours in single precision; to smooth an image without files, the least of the peaks on
# noise of 1536 x 1536 pixels with one channel and three (40 + 13); to compare two (28 + 2); to read heights or
# positions, as coordinates in double precision, as read and for each pixel.
_PIXEL_BYTES = {"recoloured": (0, 2 * 4), "smoothed": (40, 13), "compared": (28, 2), "mapped": (3 * 8, 8)}


def sizes_of(images: Iterable[tuple[str, bytes]]) -> Iterator[tuple[str, ImageSize, int]]:
    """Measure images and their files; an image that fails is left to its decoder, which raises the error."""
    for name, data in images:
        size = measure_image(data, name)
        if size is not None:
            yield name, size, len(data)


def require_memory(images: Iterable[tuple[str, bytes]], access: Access, work: str = "recoloured") -> None:
    """Raise InputError if images cannot fit into memory: all as stored, and one of them as it is worked on."""
    if access.memory is None:
        return
    (per_pixel, per_sample), decoded, working = _PIXEL_BYTES[work], 0, 0
    for name, size, _ in sizes_of(images):
        decoded += size.decoded
        working = max(working, per_pixel * size.texels + per_sample * size.samples)
        if decoded + working > access.memory:
            raise too_large(name, size)


def too_large(name: str, size: ImageSize) -> InputError:
    """Return the error that an image, with those around it, needs more memory than there is."""
    cause = f"its {size.width} x {size.height} pixels of {size.channels} channels do not fit into memory"
    return MemoryLimitError(name, cause, "scale it down, or raise --max-memory")
