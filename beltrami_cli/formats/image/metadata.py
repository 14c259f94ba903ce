"""Metadata that OpenImageIO leaves out: of PNG, JPEG and WebP files, EXIF data, and how JPEG was quantised.

EXIF data have a place of their own in PNG, JPEG and WebP files, and are among the tags of TIFF files.

References
----------
.. [1] PNG (Portable Network Graphics) Specification, third edition, W3C 2025, sections 5, 9 and 11.
.. [2] ITU-T T.81 (JPEG), annex B: marker segments and tables.
.. [3] WebP Container Specification, Google: RIFF chunks.
.. [4] CIPA DC-007, Multi-Picture Format, section 5.2: MP Index IFD.
"""

from __future__ import annotations

import io
import re
import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from beltrami_cli.arrays import Float64s
from beltrami_cli.formats.image import headers, tiff_tags

DAMAGED = (ValueError, LookupError, struct.error)
"""Errors that damaged metadata raise."""

PNG_START, _JPEG_START = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"
_ANIMATION = (b"acTL", b"fcTL", b"fdAT")
_OF_SAMPLES = (b"tRNS", b"sBIT", b"hIST", b"bKGD")  # PNG chunks that depend on the type of the samples
# Which OpenImageIO adds, even to images with a profile.
_OF_THE_ENCODER = (b"sRGB", b"gAMA", b"cHRM", b"oFFs")
_RIFF_START = 12
_WEBP_FLAGS = {b"ICCP": 0x20, b"EXIF": 0x08, b"XMP ": 0x04}
_WEBP_ALPHA, _WEBP_ANIMATION = 0x10, 0x02
_WEBP_PIXELS = (b"ALPH", b"VP8 ", b"VP8L")
_WEBP_STRUCTURE = (b"VP8X", b"ANIM", b"ANMF", *_WEBP_PIXELS)
_START_OF_SCAN, _END_OF_IMAGE = 0xDA, 0xD9
# But Adobe's segment, which says how these very samples are coded.
_METADATA = (0xFE, *range(0xE0, 0xEE), 0xEF)
_MOST_BITS_OF_A_PALETTE = 8
# Bytes of headers of BMP: the first by Windows, the first with a mask of alpha, and both by OS/2 2.
_WINDOWS_HEADER, _ALPHA_HEADER, _LATER_OS2 = 40, 56, (16, 64)
# Packings of BMP with masks of the bits of red, green and blue, and in the second of alpha.
_BIT_FIELDS = (3, 6)
TARGA_END = b"TRUEVISION-XFILE.\0"  # after the addresses of the extension and developer areas
_TARGA_ALPHA = 494  # byte of the former
_MPF = b"MPF\0"  # the mark of an index of pictures
_MP_ENTRIES = 0xB002  # tag of its entries
_MP_ENTRY = 16  # bytes of one
_PLAIN_MARKERS = (0x01, *range(0xD0, 0xDA))  # markers without a segment


def carry_over(source: bytes, encoded: bytes, known: str, part: int = 0) -> bytes:
    """Return an encoded image, of a part of an EXR file, with what else another file of its format holds."""
    match known:
        case "png":
            return _carry_png(source, encoded)
        case "jpeg":
            return _carry_jpeg(source, encoded)
        case "webp":
            return webp_with(webp_metadata(source), encoded) + source[_webp_end(source) :]
        case "bmp":
            return _carry_bmp(source, encoded)
        case "targa":
            return _carry_targa(source, encoded)
        case "tiff":
            return tiff_tags.with_tags(source, encoded)
        case "openexr":
            return headers.with_attributes(source, encoded, part)
        case "hdr" | "ppm" | "pgm" | "pfm":
            return headers.with_header(source, encoded, known)
    return encoded


def without_additions(encoded: bytes, known: str) -> bytes:
    """Return an image, just encoded, without what the encoder says about it of its own accord."""
    if known != "png":
        return encoded
    kept = (chunk for kind, chunk in png_chunks(encoded) if kind not in _OF_THE_ENCODER)
    return b"".join([PNG_START, *kept])


def is_animated(data: bytes, known: str) -> bool:
    """Whether a PNG or WebP file is an animation."""
    if known == "png":
        return any(kind == b"acTL" for kind, _ in png_chunks(data))
    return known == "webp" and data[12:16] == b"VP8X" and len(data) > 20 and bool(data[20] & _WEBP_ANIMATION)


def has_palette(data: bytes, known: str) -> bool:
    """Whether a PNG, BMP, TGA or GIF file stores indices into a palette."""
    match known:
        case "png":
            return data[25:26] == b"\3"  # colour type, in the header that every file starts with
        case "bmp":  # bits a pixel, in the header of OS/2 or in that of Windows
            at = 24 if data[14:18] == b"\x0c\0\0\0" else 28
            return 0 < int.from_bytes(data[at : at + 2], "little") <= _MOST_BITS_OF_A_PALETTE
        case "targa":  # a map of colours, and pixels that number them, plain or in runs
            return data[1:3] in (b"\1\1", b"\1\x09")
    return known == "gif"


def has_usual_bits(data: bytes) -> bool:
    """Whether OpenImageIO takes the right bits of a BMP file for its colours, and all for its alpha."""
    header, bits, packing = (
        int.from_bytes(data[at : at + n], "little") for at, n in ((14, 4), (28, 2), (30, 4))
    )
    if packing not in _BIT_FIELDS or header < _WINDOWS_HEADER:
        return header not in _LATER_OS2
    *colours, alpha = (int.from_bytes(data[at : at + 4], "little") for at in range(54, 70, 4))
    if header < _ALPHA_HEADER and packing != _BIT_FIELDS[1]:
        alpha = 0
    return alpha == 0 if bits == 16 else (colours == [0xFF0000, 0xFF00, 0xFF] and alpha in (0, 0xFF000000))


def is_plain_bmp(data: bytes) -> bool:
    """Whether a BMP file has 24 or 32 bits a pixel and a header of Windows: the kinds that are written."""
    header, bits = (int.from_bytes(data[at : at + n], "little") for at, n in ((14, 4), (28, 2)))
    return header >= _WINDOWS_HEADER and bits in (24, 32)


def is_lossless_webp(data: bytes) -> bool:
    """Whether the (first) picture of a WebP file is coded without loss."""
    return any(kind == b"VP8L" or b"VP8L" in payload[16:40] for kind, payload in webp_chunks(data))


def png_chunks(data: bytes) -> Iterator[tuple[bytes, memoryview]]:
    """Give the type and the whole bytes of every complete chunk, which are not copied."""
    at, view, kind = len(PNG_START), memoryview(data), b""
    while at + 12 <= len(data) and kind != b"IEND":
        end, kind = at + 12 + int.from_bytes(data[at : at + 4]), data[at + 4 : at + 8]
        if end > len(data):
            return
        yield kind, view[at:end]
        at = end


_END_OF_SCAN = re.compile(rb"\xff[^\x00\xff\xd0-\xd7]")  # any marker except a restart within a scan


def _jpeg_markers(data: bytes | memoryview) -> Iterator[tuple[int, int, int]]:
    """Give every marker of the first picture in a JPEG file, and where its segment and scan start and end."""
    at = 2
    while at + 2 <= len(data) and data[at] == 0xFF:
        marker, end = data[at + 1], at + 2
        if marker == 0xFF:  # a fill byte
            at += 1
            continue
        if marker not in _PLAIN_MARKERS:
            end += int.from_bytes(data[end : end + 2])
        if marker == _START_OF_SCAN:
            found = _END_OF_SCAN.search(data, end)
            end = found.start() if found else len(data)
        yield marker, at, end
        if marker == _END_OF_IMAGE:
            return
        at = end


def jpeg_segments(data: bytes | memoryview) -> Iterator[tuple[int, bytes | memoryview]]:
    """Give the marker and the whole bytes of every segment before the scan, then the scan and all behind it."""
    view = memoryview(data)
    for marker, start, end in _jpeg_markers(view):
        if marker == _START_OF_SCAN:
            yield marker, view[start:]
            return
        yield marker, bytes(view[start:end])


def _jpeg_end(data: bytes) -> int:
    """Return where the first picture of a JPEG file ends."""
    return next((end for marker, _, end in _jpeg_markers(data) if marker == _END_OF_IMAGE), len(data))


def first_jpeg(data: bytes) -> bytes:
    """Return a JPEG file without what follows its first picture: a gain map, previews, a video; others as they are."""
    # With a gain map, OpenImageIO would read the brighter picture that HDR displays make of both, in floats.
    return data[: _jpeg_end(data)] if data.startswith(_JPEG_START) else data


def further_pictures(data: bytes) -> bytes:
    """Return what follows the first picture of a JPEG file, padding aside; of other files nothing."""
    return data[_jpeg_end(data) :].strip(b"\0") if data.startswith(_JPEG_START) else b""


def _carry_png(source: bytes, encoded: bytes) -> bytes:
    same_samples = source[24:26] == encoded[24:26]  # bit depth and type of colour
    unwanted = _ANIMATION if same_samples else (*_ANIMATION, *_OF_SAMPLES)
    before, behind = list[memoryview](), list[memoryview]()
    chunks, size = before, len(PNG_START)
    for kind, chunk in png_chunks(source):
        size += len(chunk)
        if kind == b"IDAT":
            chunks = behind
        elif kind[:1].islower() and kind not in unwanted:
            chunks.append(chunk)
    header, *pixels, end = (chunk for kind, chunk in png_chunks(encoded) if kind[:1].isupper())
    return b"".join([PNG_START, header, *before, *pixels, *behind, end, source[size:]])


def _carry_bmp(source: bytes, encoded: bytes) -> bytes:
    """Replace the pixels, unless the first row is the top one; a header may describe, and hold, a profile."""
    (old, *storage), (new, *same) = (struct.unpack_from("<I4xiiHH", data, 10) for data in (source, encoded))
    width, height, _, bits = storage
    if storage != same:
        return encoded
    size = -(-width * bits // 32) * 4 * abs(height)  # rows are filled up to 4 bytes
    return source[:old] + encoded[new : new + size] + source[old + size :]


def _carry_targa(source: bytes, encoded: bytes) -> bytes:
    """Replace what the header and the extension area of a TGA file say about alpha: whether there is any."""
    made = bytearray(encoded)
    if source[16] == made[16]:  # bits of a pixel; the next byte says how many of them are alpha
        made[17] = made[17] & 0xF0 | source[17] & 0x0F
    old, new = (int.from_bytes(data[-26:-22], "little") + _TARGA_ALPHA for data in (source, encoded))
    if source.endswith(TARGA_END) and encoded.endswith(TARGA_END) and _TARGA_ALPHA < old < len(source) - 26:
        made[new] = source[old]
    return bytes(made)


def _carry_jpeg(source: bytes, encoded: bytes) -> bytes:
    metadata = [bytes(segment) for marker, segment in jpeg_segments(source) if marker in _METADATA]
    pixels = [segment for marker, segment in jpeg_segments(encoded) if marker not in _METADATA]
    picture, end = encoded[:2] + b"".join([*metadata, *pixels]), _jpeg_end(source)
    growth = len(picture) - end
    for index in metadata:
        if index[4 : 4 + len(_MPF)] == _MPF:
            shift = growth + source.index(index) - picture.index(index)
            picture = picture.replace(index, _index_of_pictures(index, shift, growth), 1)
    return picture + source[end:]


def _index_of_pictures(segment: bytes, shift: int, growth: int) -> bytes:
    """Return the index of the pictures in a JPEG file [4] whose first one has grown, with the others shifted."""
    tiff, order = bytearray(segment[4 + len(_MPF) :]), "<" if segment[8:10] == b"II" else ">"
    try:
        at = struct.unpack_from(f"{order}I", tiff, 4)[0]
        (count,) = struct.unpack_from(f"{order}H", tiff, at)
        fields = [struct.unpack_from(f"{order}HHII", tiff, at + 2 + 12 * i) for i in range(count)]
        entries = next((size, place) for tag, _, size, place in fields if tag == _MP_ENTRIES)
        for at in range(entries[1], entries[1] + entries[0], _MP_ENTRY):
            length, offset = struct.unpack_from(f"{order}II", tiff, at + 4)
            # Offsets count from the head of the index; that of the first picture is 0.
            moved = (length, offset + shift) if offset else (length + growth, 0)
            struct.pack_into(f"{order}II", tiff, at + 4, *moved)
    except (struct.error, StopIteration):  # no index that a program could follow
        return segment
    return segment[: 4 + len(_MPF)] + bytes(tiff)


def webp_chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Give the type and the payload of every complete chunk."""
    at, end = _RIFF_START, _webp_end(data)
    while at + 8 <= end:
        size = int.from_bytes(data[at + 4 : at + 8], "little")
        if at + 8 + size > end:
            return
        yield data[at : at + 4], data[at + 8 : at + 8 + size]
        at += 8 + size + size % 2


def _webp_end(data: bytes) -> int:
    size = int.from_bytes(data[4:8], "little")
    return min(len(data), 8 + size + size % 2)


def webp_metadata(data: bytes) -> list[tuple[bytes, bytes]]:
    """Return the types and payloads of all chunks without pixels."""
    return [chunk for chunk in webp_chunks(data) if chunk[0] not in _WEBP_STRUCTURE]


def webp_with(metadata: list[tuple[bytes, bytes]], encoded: bytes) -> bytes:
    """Return the pixels of a WebP image with these chunks of metadata."""
    if not metadata:
        return encoded
    pixels = [chunk for chunk in webp_chunks(encoded) if chunk[0] in _WEBP_PIXELS]
    width, height, alpha = _webp_size(*pixels[-1])
    flags = 0
    for kind, _ in metadata:
        flags |= _WEBP_FLAGS.get(kind, 0)
    flags |= _WEBP_ALPHA if alpha or len(pixels) > 1 else 0
    canvas = (width - 1).to_bytes(3, "little") + (height - 1).to_bytes(3, "little")
    profile = [chunk for chunk in metadata if chunk[0] == b"ICCP"]
    behind = [chunk for chunk in metadata if chunk[0] != b"ICCP"]
    chunks = [(b"VP8X", bytes([flags, 0, 0, 0]) + canvas), *profile, *pixels, *behind]
    sized = ((kind + len(data).to_bytes(4, "little"), data, b"\0" * (len(data) % 2)) for kind, data in chunks)
    body = b"".join(part for parts in sized for part in parts)
    return b"RIFF" + (len(body) + 4).to_bytes(4, "little") + b"WEBP" + body


def _webp_size(kind: bytes, payload: bytes) -> tuple[int, int, bool]:
    """Return width, height and whether there is alpha from the start of the coded pixels."""
    if kind == b"VP8L":
        bits = int.from_bytes(payload[1:5], "little")
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1, bool(bits >> 28 & 1)
    size = payload[6:10]
    return int.from_bytes(size[:2], "little") & 0x3FFF, int.from_bytes(size[2:], "little") & 0x3FFF, False


def png_chunk(kind: bytes, data: bytes) -> bytes:
    """Return a chunk with its length and checksum."""
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


CODED_TOGETHER = 16  # blocks of all planes begin at rows and columns that are multiples of this
_RGB = [*b"RGB"]  # identifiers of components that are no luma and chroma


@dataclass(frozen=True)
class JpegTables:
    """Steps of the DCT coefficients of luma and of chroma, and the pixels that a sample of chroma spans."""

    steps: Float64s  # shape (1, 8, 8) of grey pictures, or (2, 8, 8)
    span: tuple[int, int]  # rows, columns: 1 or 2 each


def is_progressive_jpeg(data: bytes) -> bool:
    """Whether a JPEG file is made of scans that become finer."""
    header = _jpeg_header(data)
    return header is not None and "progressive" in header.info


def read_jpeg_tables(data: bytes | memoryview) -> JpegTables | None:
    """Read the tables of a grey or YCbCr picture; None of any other, or if they are damaged."""
    header = _jpeg_header(data)
    if header is None or not header.layer:
        return None
    tables = {number: np.array(table, np.float64) for number, table in header.quantization.items()}
    identifiers, across, down, used = zip(*header.layer, strict=True)
    if not all(number in tables and len(tables[number]) == 64 for number in used):
        return None
    steps, span = np.stack([tables[number].reshape(8, 8) for number in used]), (1, 1)
    if len(used) > 1:
        is_ycbcr = header.info.get("adobe_transform", 1) == 1 and [*identifiers] != _RGB
        if len(used) != 3 or not is_ycbcr or {*across[1:], *down[1:]} != {1} or (steps[1] != steps[2]).any():
            return None
        steps, span = steps[:2], (down[0], across[0])
    # Decoders let steps of 0 pass, which have no multiples.
    return JpegTables(steps, span) if steps.min() >= 1 and {*span} <= {1, 2} else None


def _jpeg_header(data: bytes | memoryview) -> Any:
    """Return the header of a JPEG file as Pillow reads it; None if it is none, or damaged."""
    if data[: len(_JPEG_START)] != _JPEG_START:
        return None
    from PIL.JpegImagePlugin import JpegImageFile

    try:
        return JpegImageFile(io.BytesIO(data))
    except (OSError, SyntaxError, ValueError):
        return None


FORMATS_WITH_EXIF = ("png", "jpeg", "webp", "tiff")
"""Formats that have a place for EXIF data."""

_APP0, _APP1, _COMMENT = 0xE0, 0xE1, 0xFE
_EXIF_START, _XMP_START = b"Exif\0\0", b"http://ns.adobe.com/xap/1.0/\0"
_LONGEST_SEGMENT = 0xFFFF - 2  # bytes in a segment of JPEG, whose length counts itself


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
        case "jpeg":
            segments = [segment for _, segment in jpeg_segments(encoded) if not _is_exif(segment)]
            return _with_segment(encoded[:2] + b"".join(segments), _APP1, _EXIF_START + exif)
    return encoded


def jpeg_with(encoded: bytes, *, comment: bytes, xmp: bytes) -> bytes:
    """Return a JPEG image with a comment and XMP data, as far as each is given and fits into a segment."""
    encoded = _with_segment(encoded, _APP1, _XMP_START + xmp) if xmp else encoded
    return _with_segment(encoded, _COMMENT, comment) if comment else encoded


def _with_segment(encoded: bytes, marker: int, payload: bytes) -> bytes:
    """Return a JPEG image with a segment in front, but behind that of JFIF; the same image if it is too long."""
    if len(payload) > _LONGEST_SEGMENT:
        return encoded
    segments = [segment for _, segment in jpeg_segments(encoded)]
    at = 1 if segments[0][1] == _APP0 else 0
    segment = bytes([0xFF, marker]) + (2 + len(payload)).to_bytes(2) + payload
    return encoded[:2] + b"".join([*segments[:at], segment, *segments[at:]])


def _is_exif(segment: bytes | memoryview) -> bool:
    return segment[1] == _APP1 and segment[4:10] == _EXIF_START
