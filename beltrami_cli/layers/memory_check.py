"""Checks that images fit into memory, before any of them is decoded."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from beltrami_cli.errors import InputError
from beltrami_cli.formats.access import Access
from beltrami_cli.formats.image.reading import ImageSize, measure_image

# Bytes per pixel and per sample that a job on images needs in memory at least, besides the decoded images: to paint one
# at a time, its old and new colours in single precision; to smooth an image without files, the least of the peaks on
# noise of 1536 x 1536 pixels with one channel and three (40 + 13); to compare two (36 + 1); to read heights or
# positions, as coordinates in double precision, as read and for each pixel.
PIXEL_BYTES = {"painted": (0, 2 * 4), "smoothed": (40, 13), "compared": (36, 1), "mapped": (3 * 8, 8)}


def require_memory(
    images: Iterable[tuple[str, bytes]], access: Access, pixel_bytes: tuple[int, int] = PIXEL_BYTES["painted"]
) -> None:
    """Raise InputError if images cannot fit into memory: all as stored, and one of them as it is worked on.

    `pixel_bytes`: what that takes per pixel and per sample, by default that it is twice there as floats.
    """
    if access.memory is None:
        return
    decoded, working = 0, 0
    for name, size, _ in measured(images):
        decoded += size.decoded
        working = max(working, pixel_bytes[0] * size.texels + pixel_bytes[1] * size.samples)
        if decoded + working > access.memory:
            raise too_large(name, size)


def measured(images: Iterable[tuple[str, bytes]]) -> Iterator[tuple[str, ImageSize, int]]:
    """Measure images and their files; those that fail are left to their decoder, which raises the error."""
    for name, data in images:
        size = measure_image(data, name)
        if size is not None:
            yield name, size, len(data)


def too_large(name: str, size: ImageSize) -> InputError:
    """Return the error that an image, with those around it, needs more memory than there is."""
    cause = f"its {size.width} x {size.height} pixels of {size.channels} channels do not fit into memory"
    return InputError(name, cause, "scale it down, or raise --max-memory")
