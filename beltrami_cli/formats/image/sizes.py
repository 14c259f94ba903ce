"""The sizes of image files, from their headers alone, and checks that they fit into memory."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from beltrami_cli.errors import InputError, MemoryLimitError
from beltrami_cli.formats.access import Access
from beltrami_cli.formats.image.extra_codecs import EXTRA_CODECS, measured
from beltrami_cli.formats.image.file_formats import format_of
from beltrami_cli.formats.image.opening import UNNAMED, error_of, opened, seek_colours

# PNG and JPEG files have their size before their pixels, mostly in this many bytes, so that not all of them are copied.
_SIZE_FIRST, _HEAD = (b"\x89PNG", b"\xff\xd8\xff"), 1 << 16

# Bytes per pixel and per sample that a job on images needs at least, besides the decoded images: to recolour one
# at a time, its old and new colours in single precision; to smooth an image without files, the least of the peaks on
# noise of 1536 x 1536 pixels with one channel and three (40 + 13); to compare two (28 + 2); to read heights or
# positions, as coordinates in double precision, as read and for each pixel.
_PIXEL_BYTES = {"recoloured": (0, 2 * 4), "smoothed": (40, 13), "compared": (28, 2), "mapped": (3 * 8, 8)}


@dataclass(frozen=True)
class ImageSize:
    """Pixels and their bytes: width, height, channels, and the bytes of one sample."""

    width: int
    height: int
    channels: int
    sample: int

    @property
    def texels(self) -> int:
        return self.width * self.height

    @property
    def samples(self) -> int:
        return self.texels * self.channels

    @property
    def decoded(self) -> int:
        return self.samples * self.sample


def measure_image(data: bytes, name: str = UNNAMED) -> ImageSize | None:
    """Return the size of an image file without decoding it; None if it cannot be opened."""
    file_format = format_of(data, name)
    if file_format is not None and file_format in EXTRA_CODECS:
        try:
            return ImageSize(*measured(data, file_format, name), 1)
        except InputError:
            return None
    head = data[:_HEAD] if data.startswith(_SIZE_FIRST) else data
    size = _measured(head, name)
    return _measured(data, name) if size is None and len(head) < len(data) else size


def _measured(data: bytes, name: str) -> ImageSize | None:
    import OpenImageIO

    with opened(data, name=name) as (file, _):
        if file is None:
            error_of(OpenImageIO)
            return None
        seek_colours(file)
        spec = file.spec()
        return ImageSize(spec.width, spec.height, spec.nchannels, spec.format.basesize())


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
