"""The size of an image is told from its header, however far into the file that reaches."""

from __future__ import annotations

import numpy as np
import pytest

from beltrami_cli.formats.image.reading import ImageSize, measure_image
from formats.image_files import LOSSLESS, encode, noise, png_chunk, png_chunks

_BYTES = {"uint8": 1, "uint16": 2, "half": 2, "float": 4}


@pytest.mark.parametrize(
    ("known", "kind", "channels"), [*LOSSLESS, ("jpeg", "uint8", 3), ("jpeg", "uint8", 1)]
)
def test_the_size_is_that_of_the_pixels(known: str, kind: str, channels: int) -> None:
    small, large = noise(kind, channels), noise(kind, channels, 300, 400)
    for pixels in (small, large):
        height, width = pixels.shape[:2]
        expected = ImageSize(width, height, channels, _BYTES[kind])
        assert measure_image(encode(pixels, known, kind)) == expected


def test_metadata_before_the_pixels_may_be_long() -> None:
    words = np.random.default_rng(1).integers(32, 127, 200_000, np.uint8).tobytes()
    header, *others = [png_chunk(*chunk) for chunk in png_chunks(encode(noise("uint8", 3), "png"))]
    png = b"\x89PNG\r\n\x1a\n" + header + png_chunk(b"tEXt", b"Comment\0" + words) + b"".join(others)
    assert measure_image(png) == ImageSize(7, 5, 3, 1)
    jpeg = encode(noise("uint8", 3), "jpeg")
    segment = b"\xff\xfe" + (60_002).to_bytes(2) + words[:60_000]
    assert measure_image(jpeg[:2] + 3 * segment + jpeg[2:]) == ImageSize(7, 5, 3, 1)


def test_what_is_no_image_has_no_size() -> None:
    for data in (b"", b"ply\n", b"\x89PNG", b"\x89PNG" + bytes(1 << 17), b"\xff\xd8\xff" + bytes(1 << 17)):
        assert measure_image(data) is None
