"""The sizes of image files, from their headers alone."""

from __future__ import annotations

from dataclasses import dataclass

from beltrami_cli.errors import InputError
from beltrami_cli.formats.image.extra_codecs import EXTRA_CODECS, measure
from beltrami_cli.formats.image.file_formats import format_of
from beltrami_cli.formats.image.opening import UNNAMED, error_of, opened, seek_colours

# PNG and JPEG files have their size before their pixels, mostly in this many bytes, so that not all of them are copied.
_SIZE_FIRST, _HEAD = (b"\x89PNG", b"\xff\xd8\xff"), 1 << 16


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
            return ImageSize(*measure(data, file_format, name), 1)
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
