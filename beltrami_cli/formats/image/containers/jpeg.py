"""Segments of JPEG files, and the bytes after the first image; a new file keeps both.

References
----------
.. [1] ITU-T T.81 (JPEG), annex B: marker segments.
.. [2] CIPA DC-007, Multi-Picture Format, section 5.2: MP Index IFD.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator

START = b"\xff\xd8"
_START_OF_SCAN, _END_OF_IMAGE = 0xDA, 0xD9
_APP0, _APP1, _APP14, _APP15, _COMMENT = 0xE0, 0xE1, 0xEE, 0xEF, 0xFE
# But Adobe's segment, which says how these very samples are coded.
_METADATA = (_COMMENT, *range(_APP0, _APP14), _APP15)
_MPF = b"MPF\0"  # the mark of an index of images
_MP_ENTRIES = 0xB002  # tag of its entries
_MP_ENTRY = 16  # bytes of one
# Segments that OpenImageIO reads, and MPF: another notice reports that the images of an index are dropped.
_READ = ("JFIF", "MPF", "Exif", "http://ns.adobe.com/xap/1.0/", "ICC_PROFILE", "Photoshop 3.0", "COM")
_PLAIN_MARKERS = (0x01, *range(0xD0, 0xDA))  # markers without a segment
_END_OF_SCAN = re.compile(rb"\xff[^\x00\xff\xd0-\xd7]")  # any marker except a restart within a scan
EXIF_START = b"Exif\0\0"
_XMP_START = b"http://ns.adobe.com/xap/1.0/\0"
_LONGEST_SEGMENT = 0xFFFF - 2  # bytes in a segment of JPEG, whose length counts itself


def carried_over(source: bytes, encoded: bytes) -> bytes:
    """Return an encoded JPEG with the metadata of another one, and what follows its first image."""
    metadata = [bytes(segment) for marker, segment in segments(source) if marker in _METADATA]
    pixels = [segment for marker, segment in segments(encoded) if marker not in _METADATA]
    image, size = encoded[:2] + b"".join([*metadata, *pixels]), _end(source)
    growth = len(image) - size
    for index in metadata:
        if index[4 : 4 + len(_MPF)] == _MPF:
            shift = growth + source.index(index) - image.index(index)
            image = image.replace(index, _index_of_images(index, shift, growth), 1)
    return image + source[size:]


def _index_of_images(segment: bytes, shift: int, growth: int) -> bytes:
    """Return the index of the images in a JPEG file [2]_ whose first one has grown, with the others shifted."""
    tiff, order = bytearray(segment[4 + len(_MPF) :]), "<" if segment[8:10] == b"II" else ">"
    try:
        at = struct.unpack_from(f"{order}I", tiff, 4)[0]
        (count,) = struct.unpack_from(f"{order}H", tiff, at)
        fields = [struct.unpack_from(f"{order}HHII", tiff, at + 2 + 12 * i) for i in range(count)]
        entries = next((size, place) for tag, _, size, place in fields if tag == _MP_ENTRIES)
        for at in range(entries[1], entries[1] + entries[0], _MP_ENTRY):
            length, offset = struct.unpack_from(f"{order}II", tiff, at + 4)
            # Offsets count from the head of the index; that of the first image is 0.
            moved = (length, offset + shift) if offset else (length + growth, 0)
            struct.pack_into(f"{order}II", tiff, at + 4, *moved)
    except (struct.error, StopIteration):  # no index that a program could follow
        return segment
    return segment[: 4 + len(_MPF)] + bytes(tiff)


def _markers(data: bytes | memoryview) -> Iterator[tuple[int, int, int]]:
    """Yield every marker [1]_ of the first image in a JPEG file, and where its segment and scan start and end."""
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


def segments(data: bytes | memoryview) -> Iterator[tuple[int, bytes | memoryview]]:
    """Yield the marker and the whole bytes of every segment before the scan, then the scan and all behind it."""
    view = memoryview(data)
    for marker, start, end in _markers(view):
        if marker == _START_OF_SCAN:
            yield marker, view[start:]
            return
        yield marker, bytes(view[start:end])


def metadata_names(data: bytes) -> dict[str, bool]:
    names = set[str]()
    for marker, segment in segments(data):
        if marker == _COMMENT:
            names.add("COM")
        elif _APP0 <= marker <= _APP15 and marker != _APP14:
            names.add(bytes(segment[4:]).partition(b"\0")[0][:40].decode("latin-1"))
    return {f"JPEG segment {name}": name in _READ for name in names}


def exif(data: bytes) -> bytes:
    return next((bytes(segment[4:]) for _, segment in segments(data) if _is_exif(segment)), b"")


def with_exif(encoded: bytes, exif_data: bytes) -> bytes:
    kept = [segment for _, segment in segments(encoded) if not _is_exif(segment)]
    return _with_segment(encoded[:2] + b"".join(kept), _APP1, EXIF_START + exif_data)


def _is_exif(segment: bytes | memoryview) -> bool:
    return segment[1] == _APP1 and segment[4:10] == EXIF_START


def with_texts(encoded: bytes, *, comment: bytes, xmp: bytes) -> bytes:
    """Return a JPEG image with a comment and XMP data, as far as each is given and fits into a segment."""
    encoded = _with_segment(encoded, _APP1, _XMP_START + xmp) if xmp else encoded
    return _with_segment(encoded, _COMMENT, comment) if comment else encoded


def _with_segment(encoded: bytes, marker: int, payload: bytes) -> bytes:
    """Return a JPEG image with a segment in front, but behind that of JFIF; the same image if it is too long."""
    if len(payload) > _LONGEST_SEGMENT:
        return encoded
    before = [segment for _, segment in segments(encoded)]
    at = 1 if before[0][1] == _APP0 else 0
    segment = bytes([0xFF, marker]) + (2 + len(payload)).to_bytes(2) + payload
    return encoded[:2] + b"".join([*before[:at], segment, *before[at:]])


def _end(data: bytes) -> int:
    return next((end for marker, _, end in _markers(data) if marker == _END_OF_IMAGE), len(data))


def first_image(data: bytes) -> bytes:
    """Return a JPEG file without what follows its first image: a gain map, previews, a video; others as they are."""
    # With a gain map, OpenImageIO would read the brighter image that HDR displays make of both, in floats.
    return data[: _end(data)] if data.startswith(START) else data


def further_images(data: bytes) -> bytes:
    """Return what follows the first image of a JPEG file, padding aside; of other files nothing."""
    return data[_end(data) :].strip(b"\0") if data.startswith(START) else b""
