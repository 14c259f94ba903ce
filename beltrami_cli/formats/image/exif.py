"""EXIF data, which PNG, JPEG and WebP files hold in a place of their own, and TIFF files among their tags."""

from __future__ import annotations

from contextlib import suppress

from beltrami_cli.formats.image import tiff_tags
from beltrami_cli.formats.image.metadata import (
    DAMAGED,
    PNG_START,
    jpeg_segments,
    png_chunk,
    png_chunks,
    webp_metadata,
    webp_with,
)

FORMATS_WITH_EXIF = ("png", "jpeg", "webp", "tiff")
"""Formats that have a place for EXIF data."""

_APP0, _APP1 = 0xE0, 0xE1
_EXIF_START = b"Exif\0\0"
_LONGEST_EXIF = 0xFFFF - 2 - len(_EXIF_START)  # bytes in a segment of JPEG, whose length counts itself


def carry_exif(source: bytes, source_format: str, encoded: bytes, known: str, made: bytes) -> bytes:
    """Add the EXIF data of a file to an image of another format, and the fields that were made for it."""
    exif = exif_of(source, source_format)
    with suppress(*DAMAGED):
        made = tiff_tags.with_exif(exif, made) if tiff_tags.exif_tags(exif) else made
    return with_exif(made, encoded, known) if tiff_tags.exif_tags(made) else encoded


def exif_of(data: bytes, known: str) -> bytes:
    """Return the EXIF data of a PNG, JPEG, WebP or TIFF file, which are a TIFF file without pixels; or nothing."""
    found = b""
    match known:
        case "tiff":
            return data
        case "png":
            found = next((bytes(chunk[8:-4]) for kind, chunk in png_chunks(data) if kind == b"eXIf"), b"")
        case "webp":
            found = next((payload for kind, payload in webp_metadata(data) if kind == b"EXIF"), b"")
        case "jpeg":
            found = next((bytes(segment[4:]) for _, segment in jpeg_segments(data) if _is_exif(segment)), b"")
    return found.removeprefix(_EXIF_START)


def with_exif(exif: bytes, encoded: bytes, known: str) -> bytes:
    """Return an image with other EXIF data in the place of its own; the same image if the format has no place."""
    match known:
        case "tiff":
            return exif
        case "png":
            chunks = [(kind, chunk) for kind, chunk in png_chunks(encoded) if kind != b"eXIf"]
            (_, header), *others = chunks
            return b"".join([PNG_START, header, png_chunk(b"eXIf", exif), *(chunk for _, chunk in others)])
        case "webp":
            metadata = [chunk for chunk in webp_metadata(encoded) if chunk[0] != b"EXIF"]
            return webp_with([*metadata, (b"EXIF", exif)], encoded)
        case "jpeg" if len(exif) <= _LONGEST_EXIF:
            segments = [segment for _, segment in jpeg_segments(encoded) if not _is_exif(segment)]
            payload = _EXIF_START + exif
            segment = bytes([0xFF, _APP1]) + (2 + len(payload)).to_bytes(2) + payload
            at = 1 if segments[0][1] == _APP0 else 0
            return encoded[:2] + b"".join([*segments[:at], segment, *segments[at:]])
    return encoded


def _is_exif(segment: bytes | memoryview) -> bool:
    return segment[1] == _APP1 and segment[4:10] == _EXIF_START
