"""Metadata, by the format of a file: what is carried over to a file that is written from it, and what there is."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator

from beltrami_cli.formats.image import (
    bitmaps,
    exr,
    extra_codecs,
    jpeg,
    png,
    text_headers,
    tiff_tags,
    webp,
)

DAMAGED = (ValueError, LookupError, struct.error)
"""Errors that damaged metadata raise."""
_PNG_STRUCTURE = ("tRNS", "acTL", "fcTL", "fdAT")  # other notices tell what becomes of these
_PNG_READ = ("tEXt", "zTXt", "iTXt", "pHYs", "eXIf", "iCCP", "gAMA", "cHRM", "sRGB", "cICP", "tIME", "oFFs")
_BMP_PROFILES = (b"KNIL", b"DEBM")  # in another file, or behind the pixels; by the header of version 5
_PROFILE_HEADER = 124  # bytes of it
# Another notice reports that the images of an index (MPF) are dropped.
_JPEG_READ = ("JFIF", "MPF", "Exif", "http://ns.adobe.com/xap/1.0/", "ICC_PROFILE", "Photoshop 3.0", "COM")
_HEADER_BOX = b"jp2h"
# That hold pixels, or how they are stored, in JPEG 2000 and JPEG XL.
_BOXES = (
    b"jP  ", b"ftyp", _HEADER_BOX, b"ihdr", b"bpcc", b"colr", b"pclr", b"cmap", b"cdef", b"jp2c",
    b"JXL ", b"jxlc", b"jxlp", b"jxll", b"jxli",
)  # fmt: skip
_JPEG_2000_TILE = b"\xff\x90"
_JPEG_2000_COMMENT = re.compile(rb"\xff\x64..\x00\x01(?!Created by OpenJPEG)", re.DOTALL)


def carry_over(source: bytes, encoded: bytes, known: str, part: int = 0) -> bytes:
    """Return an encoded image, of a part of an EXR file, with what else another file of its format holds."""
    match known:
        case "png":
            return png.carried_over(source, encoded)
        case "jpeg":
            return jpeg.carried_over(source, encoded)
        case "webp":
            return webp.carried_over(source, encoded)
        case "bmp":
            return bitmaps.carried_bmp(source, encoded)
        case "targa":
            return bitmaps.carried_targa(source, encoded)
        case "tiff":
            return tiff_tags.with_tags(source, encoded)
        case "openexr":
            return exr.with_attributes(source, encoded, part)
        case "hdr" | "ppm" | "pgm" | "pfm":
            return text_headers.with_header(source, encoded, known)
    return encoded


def items(data: bytes, known: str) -> dict[str, bool]:
    """Return names for the pieces of metadata in a file, and whether OpenImageIO reads each, for another format."""
    match known:
        case "png":
            kinds = {kind.decode("latin-1") for kind, _ in png.chunks(data) if kind[:1].islower()}
            return {f"PNG chunk {kind}": kind in _PNG_READ for kind in kinds - {*_PNG_STRUCTURE}}
        case "jpeg":
            return {f"JPEG segment {name}": name in _JPEG_READ for name in jpeg.segment_names(data)}
        case "webp":
            kinds = {kind.decode("latin-1") for kind, _ in webp.metadata_chunks(data)}
            return {f"WebP chunk {kind}": kind in ("ICCP", "EXIF", "XMP ") for kind in kinds}
        case "tiff":
            return {f"TIFF tag {tag}": is_read for tag, is_read in tiff_tags.tags(data).items()}
        case "openexr":
            return {f"EXR attribute {name}": is_read for name, is_read in exr.attributes(data).items()}
        case "jpeg2000" | "j2k" | "jpegxl":
            boxes = (kind.decode("latin-1").strip() for kind in _boxes(data) if kind not in _BOXES)
            lost = [f"box {box}" for box in boxes]
            has_comment = known != "jpegxl" and _JPEG_2000_COMMENT.search(data.partition(_JPEG_2000_TILE)[0])
            return dict.fromkeys([*lost, "comment"] if has_comment else lost, False)
        case "hdr" | "ppm" | "pgm" | "pfm":
            return dict.fromkeys(text_headers.header_lines(data, known), False)
        case "targa" if data.endswith(bitmaps.TARGA_END) and any(data[-22:-18]):
            return {"developer area": False}
        case "bmp" if data[70:74] in _BMP_PROFILES and data[14] >= _PROFILE_HEADER:
            return {"colour profile": False}
        case "ktx2":
            return {f"KTX2 key {name}": False for name in extra_codecs.ktx2_keys(data)}
        case "avif":
            names = extra_codecs.avif_metadata(data)
            return {name.upper(): False for name in names if name != "icc_profile"}
    return {}


def _boxes(data: bytes) -> Iterator[bytes]:
    """Yield the types of the boxes of an ISO file; a bare stream of code has none."""
    at = 0
    while at + 8 <= len(data) and data[4:8] in (b"jP  ", b"JXL "):
        size, kind = int.from_bytes(data[at : at + 4]), data[at + 4 : at + 8]
        yield kind
        if kind == _HEADER_BOX:  # with boxes of its own
            size = 8
        elif size == 1:
            size = int.from_bytes(data[at + 8 : at + 16])
        if size < 8:  # up to the end of the file
            return
        at += size
