"""EXIF data: in a place of their own in PNG, JPEG and WebP files, and among the tags of TIFF files."""

from __future__ import annotations

from contextlib import suppress

from beltrami_cli.formats.image import jpeg, png, tiff_tags, webp
from beltrami_cli.formats.image.metadata import DAMAGED

FORMATS_WITH_EXIF = ("png", "jpeg", "webp", "tiff")
"""Formats that have a place for EXIF data."""
_START = b"Exif\0\0"


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
            found = next((bytes(chunk[8:-4]) for kind, chunk in png.chunks(data) if kind == b"eXIf"), b"")
        case "webp":
            found = next((payload for kind, payload in webp.metadata_chunks(data) if kind == b"EXIF"), b"")
        case "jpeg":
            found = next((bytes(segment[4:]) for _, segment in jpeg.segments(data) if _is_exif(segment)), b"")
    return found.removeprefix(_START)


def with_exif(exif: bytes, encoded: bytes, known: str) -> bytes:
    """Return an image with other EXIF data instead of its own; the same image if the format holds none."""
    match known:
        case "tiff":
            return exif
        case "png":
            header, *others = (chunk for kind, chunk in png.chunks(encoded) if kind != b"eXIf")
            return b"".join([png.START, header, png.packed_chunk(b"eXIf", exif), *others])
        case "webp":
            metadata = [chunk for chunk in webp.metadata_chunks(encoded) if chunk[0] != b"EXIF"]
            return webp.with_metadata([*metadata, (b"EXIF", exif)], encoded)
        case "jpeg":
            segments = [segment for _, segment in jpeg.segments(encoded) if not _is_exif(segment)]
            return jpeg.with_segment(encoded[:2] + b"".join(segments), jpeg.APP1, _START + exif)
    return encoded


def _is_exif(segment: bytes | memoryview) -> bool:
    return segment[1] == jpeg.APP1 and segment[4:10] == _START
