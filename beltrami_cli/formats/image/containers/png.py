"""Chunks of PNG files; a new file keeps the chunks that OpenImageIO does not write.

References
----------
.. [1] PNG (Portable Network Graphics) Specification, third edition, W3C 2025, sections 5, 9 and 11.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator

_START = b"\x89PNG\r\n\x1a\n"
# Chunks that OpenImageIO reads, and some that other notices report.
_READ = ("tEXt", "zTXt", "iTXt", "pHYs", "eXIf", "iCCP", "gAMA", "cHRM", "sRGB", "cICP", "tIME", "oFFs")
_REPORTED = {"tRNS", "acTL", "fcTL", "fdAT"}
_ANIMATION = (b"acTL", b"fcTL", b"fdAT")
_OF_SAMPLES = (b"tRNS", b"sBIT", b"hIST", b"bKGD")  # chunks that depend on the type of the samples
# Which OpenImageIO adds, even to images with a profile.
_OF_THE_ENCODER = (b"sRGB", b"gAMA", b"cHRM", b"oFFs")


def carried_over(source: bytes, encoded: bytes) -> bytes:
    """Return an encoded PNG with the chunks of another one, but those about animation and other samples."""
    same_samples = source[24:26] == encoded[24:26]  # bit depth and type of colour
    unwanted = _ANIMATION if same_samples else (*_ANIMATION, *_OF_SAMPLES)
    before, behind = list[memoryview](), list[memoryview]()
    kept, size = before, len(_START)
    for kind, chunk in chunks(source):
        size += len(chunk)
        if kind == b"IDAT":
            kept = behind
        elif kind[:1].islower() and kind not in unwanted:
            kept.append(chunk)
    header, *pixels, end = (chunk for kind, chunk in chunks(encoded) if kind[:1].isupper())
    return b"".join([_START, header, *before, *pixels, *behind, end, source[size:]])


def without_additions(encoded: bytes) -> bytes:
    """Return a new image without the metadata that the encoder adds by itself."""
    kept = (chunk for kind, chunk in chunks(encoded) if kind not in _OF_THE_ENCODER)
    return b"".join([_START, *kept])


def is_animated(data: bytes) -> bool:
    return any(kind == b"acTL" for kind, _ in chunks(data))


def has_palette(data: bytes) -> bool:
    """Whether the type of colour, in the header that every file starts with, is that of indices."""
    return data[25:26] == b"\3"


def chunks(data: bytes) -> Iterator[tuple[bytes, memoryview]]:
    """Yield type and bytes (uncopied) of every complete chunk."""
    at, view, kind = len(_START), memoryview(data), b""
    while at + 12 <= len(data) and kind != b"IEND":
        end, kind = at + 12 + int.from_bytes(data[at : at + 4]), data[at + 4 : at + 8]
        if end > len(data):
            return
        yield kind, view[at:end]
        at = end


def packed_chunk(kind: bytes, data: bytes) -> bytes:
    return len(data).to_bytes(4) + kind + data + zlib.crc32(kind + data).to_bytes(4)


def metadata_names(data: bytes) -> dict[str, bool]:
    kinds = {kind.decode("latin-1") for kind, _ in chunks(data) if kind[:1].islower()}
    return {f"PNG chunk {kind}": kind in _READ for kind in kinds - _REPORTED}


def exif(data: bytes) -> bytes:
    return next((bytes(chunk[8:-4]) for kind, chunk in chunks(data) if kind == b"eXIf"), b"")


def with_exif(encoded: bytes, exif_data: bytes) -> bytes:
    header, *others = (chunk for kind, chunk in chunks(encoded) if kind != b"eXIf")
    return b"".join([_START, header, packed_chunk(b"eXIf", exif_data), *others])
