"""Chunks of WebP files; a new file keeps those without pixels.

References
----------
.. [1] WebP Container Specification, Google: RIFF chunks.
"""

from __future__ import annotations

from collections.abc import Iterator

_RIFF_START = 12
_FLAGS = {b"ICCP": 0x20, b"EXIF": 0x08, b"XMP ": 0x04}
_ALPHA, _ANIMATION = 0x10, 0x02
_PIXELS = (b"ALPH", b"VP8 ", b"VP8L")
_STRUCTURE = (b"VP8X", b"ANIM", b"ANMF", *_PIXELS)


def carried_over(source: bytes, encoded: bytes) -> bytes:
    """Return an encoded WebP with the metadata of another one, and the bytes after its end."""
    return _with_metadata(_metadata_chunks(source), encoded) + source[_end(source) :]


def is_animated(data: bytes) -> bool:
    return data[12:16] == b"VP8X" and len(data) > 20 and bool(data[20] & _ANIMATION)


def is_lossless(data: bytes) -> bool:
    return any(kind == b"VP8L" or b"VP8L" in payload[16:40] for kind, payload in chunks(data))


def chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Yield the type and the payload of every complete chunk."""
    at, end = _RIFF_START, _end(data)
    while at + 8 <= end:
        size = int.from_bytes(data[at + 4 : at + 8], "little")
        if at + 8 + size > end:
            return
        yield data[at : at + 4], data[at + 8 : at + 8 + size]
        at += 8 + size + size % 2


def _end(data: bytes) -> int:
    size = int.from_bytes(data[4:8], "little")
    return min(len(data), 8 + size + size % 2)


def _metadata_chunks(data: bytes) -> list[tuple[bytes, bytes]]:
    """Return the types and payloads of all chunks without pixels."""
    return [chunk for chunk in chunks(data) if chunk[0] not in _STRUCTURE]


def _with_metadata(metadata: list[tuple[bytes, bytes]], encoded: bytes) -> bytes:
    """Return the pixels of a WebP image with these chunks of metadata."""
    if not metadata:
        return encoded
    pixels = [chunk for chunk in chunks(encoded) if chunk[0] in _PIXELS]
    width, height, alpha = _size(*pixels[-1])
    flags = 0
    for kind, _ in metadata:
        flags |= _FLAGS.get(kind, 0)
    flags |= _ALPHA if alpha or len(pixels) > 1 else 0
    canvas = (width - 1).to_bytes(3, "little") + (height - 1).to_bytes(3, "little")
    profile = [chunk for chunk in metadata if chunk[0] == b"ICCP"]
    behind = [chunk for chunk in metadata if chunk[0] != b"ICCP"]
    stored = [(b"VP8X", bytes([flags, 0, 0, 0]) + canvas), *profile, *pixels, *behind]
    sized = ((kind + len(data).to_bytes(4, "little"), data, b"\0" * (len(data) % 2)) for kind, data in stored)
    body = b"".join(part for parts in sized for part in parts)
    return b"RIFF" + (len(body) + 4).to_bytes(4, "little") + b"WEBP" + body


def _size(kind: bytes, payload: bytes) -> tuple[int, int, bool]:
    """Return width, height and whether there is alpha from the start of the coded pixels."""
    if kind == b"VP8L":
        bits = int.from_bytes(payload[1:5], "little")
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1, bool(bits >> 28 & 1)
    size = payload[6:10]
    return int.from_bytes(size[:2], "little") & 0x3FFF, int.from_bytes(size[2:], "little") & 0x3FFF, False


def metadata_names(data: bytes) -> dict[str, bool]:
    kinds = {kind.decode("latin-1") for kind, _ in _metadata_chunks(data)}
    return {f"WebP chunk {kind}": kind in ("ICCP", "EXIF", "XMP ") for kind in kinds}


def exif(data: bytes) -> bytes:
    return next((payload for kind, payload in _metadata_chunks(data) if kind == b"EXIF"), b"")


def with_exif(encoded: bytes, exif_data: bytes) -> bytes:
    kept = [chunk for chunk in _metadata_chunks(encoded) if chunk[0] != b"EXIF"]
    return _with_metadata([*kept, (b"EXIF", exif_data)], encoded)
