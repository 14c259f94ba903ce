"""How large an image is, told from its header."""

from __future__ import annotations

from dataclasses import dataclass

from beltrami_cli.formats.image.scratch import scratch_file

# PNG and JPEG files tell their size before their pixels, mostly in so many bytes; so not all of them are copied.
_SIZE_FIRST, _HEAD = (b"\x89PNG", b"\xff\xd8\xff"), 1 << 16


@dataclass(frozen=True)
class ImageSize:
    """Pixels and their bytes: width, height, channels, and the bytes of one sample."""

    width: int
    height: int
    channels: int
    sample: int

    @property
    def samples(self) -> int:
        """Number of all samples."""
        return self.width * self.height * self.channels

    @property
    def decoded(self) -> int:
        """Bytes of all pixels."""
        return self.samples * self.sample


def measure_image(data: bytes) -> ImageSize | None:
    """Return the size of an image file without decoding it; None if it is none that can be opened.

    Parameters
    ----------
    data : bytes
        The file.
    """
    head = data[:_HEAD] if data.startswith(_SIZE_FIRST) else data
    size = _measured(head)
    return _measured(data) if size is None and len(head) < len(data) else size


def _measured(data: bytes) -> ImageSize | None:
    import OpenImageIO

    with scratch_file(data) as path:
        file = OpenImageIO.ImageInput.open(str(path))
        OpenImageIO.geterror()
        if file is None:
            return None
        try:
            spec = file.spec()
            return ImageSize(spec.width, spec.height, spec.nchannels, spec.format.basesize())
        finally:
            file.close()
            file.geterror()
            OpenImageIO.geterror()
