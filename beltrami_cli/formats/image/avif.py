"""AVIF images, by Pillow.

References
----------
.. [1] AV1 Image File Format, AOMedia; AV1 Codec ISO Media File Format Binding, section 2.3: av1C.
"""

from __future__ import annotations

import io
import warnings
from typing import Any

import numpy as np

from beltrami_cli.arrays import Uint8s
from beltrami_cli.formats.image.file_formats import damaged_image

DECODING_BYTES = 25  # as of `extra_codecs.Codec`
_HIGH_BITDEPTH, _TWELVE_BIT = 0x40, 0x20
_SLOWEST_SPEED = 6
_DECODING_ERRORS = (OSError, ValueError, RuntimeError, SyntaxError, MemoryError)  # of damaged files


def measure(data: bytes, name: str) -> tuple[int, int, int]:
    with _opened(data, name) as image:
        width, height = image.size
        return width, height, 4 if image.mode == "RGBA" else 3


def decode(data: bytes, name: str) -> tuple[Uint8s, tuple[str, ...], bytes | None]:
    with _opened(data, name) as image:
        try:
            pixels = np.array(image.convert(image.mode if image.mode == "RGBA" else "RGB"))
        except _DECODING_ERRORS as error:
            raise damaged_image(name, "avif", error) from None
        notices, bits = [], _bits_of(data)
        if getattr(image, "n_frames", 1) > 1:
            notices.append(f"{name} holds several images; only the first is read and kept.")
        if bits > 8:
            notices.append(f"{name} has {bits}-bit samples, which become 8-bit ones.")
        return pixels, tuple(notices), image.info.get("icc_profile")


def encoding_bytes(texels: int, source: bytes) -> int:
    del source
    return 64 * texels


def encode(pixels: Uint8s, quality: int, source: bytes, *, as_data: bool) -> bytes:
    from PIL import Image

    kept = _metadata(source) if source else {}
    del as_data  # a file does not say whether it holds colours
    buffer = io.BytesIO()
    # Tiles that follow the number of processors would make the file depend on the machine.
    options = {"quality": quality, "subsampling": "4:4:4", "speed": _SLOWEST_SPEED, "autotiling": False}
    Image.fromarray(pixels).save(buffer, "AVIF", **options, **kept)
    return buffer.getvalue()


def metadata_names(data: bytes) -> dict[str, bool]:
    return {name.upper(): False for name in _metadata(data) if name != "icc_profile"}


def _opened(data: bytes, name: str) -> Any:
    from PIL import Image

    try:
        with warnings.catch_warnings():  # of large images, which are checked by their size
            warnings.simplefilter("ignore")
            return Image.open(io.BytesIO(data), formats=["AVIF"])
    except (*_DECODING_ERRORS, Image.DecompressionBombError) as error:
        raise damaged_image(name, "avif", str(error).partition("<")[0].strip()) from None


def _metadata(data: bytes) -> dict[str, bytes]:
    """Return the colour profile, EXIF and XMP of a file, by the names of Pillow's options."""
    with _opened(data, "") as image:
        return {key: image.info[key] for key in ("icc_profile", "exif", "xmp") if image.info.get(key)}


def _bits_of(data: bytes) -> int:
    """Return the bits of a sample, by the first configuration of a codec."""
    at = data.find(b"av1C")
    flags = data[at + 6] if 0 <= at < len(data) - 6 else 0
    if not flags & _HIGH_BITDEPTH:
        return 8
    return 12 if flags & _TWELVE_BIT else 10
