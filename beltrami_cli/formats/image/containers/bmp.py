"""Headers of BMP files: which kinds are read and written."""

from __future__ import annotations

import struct

_MAX_BITS_OF_A_PALETTE = 8
# Bytes of headers of BMP: the first by Windows, the first with a mask of alpha, and both by OS/2 2.
_WINDOWS_HEADER, _ALPHA_HEADER, _LATER_OS2 = 40, 56, (16, 64)
# Packings of BMP with masks of the bits of red, green and blue, and in the second of alpha.
_BIT_FIELDS = (3, 6)
_PROFILES = (b"KNIL", b"DEBM")  # in another file, or behind the pixels; by the header of version 5
_PROFILE_HEADER = 124  # bytes of it


def has_palette(data: bytes) -> bool:
    """Whether pixels have so few bits that they are indices; the headers of OS/2 and Windows differ."""
    at = 24 if data[14:18] == b"\x0c\0\0\0" else 28
    return 0 < int.from_bytes(data[at : at + 2], "little") <= _MAX_BITS_OF_A_PALETTE


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


def is_plain(data: bytes) -> bool:
    """Whether a BMP file has 24 or 32 bits a pixel and a header of Windows: the kinds that are written."""
    header, bits = (int.from_bytes(data[at : at + n], "little") for at, n in ((14, 4), (28, 2)))
    return header >= _WINDOWS_HEADER and bits in (24, 32)


def carried_over(source: bytes, encoded: bytes) -> bytes:
    """Replace the pixels, unless the first row is the top one; a header may describe, and hold, a profile."""
    (old, *storage), (new, *same) = (struct.unpack_from("<I4xiiHH", data, 10) for data in (source, encoded))
    width, height, _, bits = storage
    if storage != same:
        return encoded
    size = -(-width * bits // 32) * 4 * abs(height)  # rows are filled up to 4 bytes
    return source[:old] + encoded[new : new + size] + source[old + size :]


def metadata_names(data: bytes) -> dict[str, bool]:
    has_profile = data[70:74] in _PROFILES and data[14] >= _PROFILE_HEADER
    return {"colour profile": False} if has_profile else {}
