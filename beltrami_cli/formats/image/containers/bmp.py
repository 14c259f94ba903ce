"""Headers of BMP files: which kinds are read and written."""

from __future__ import annotations

import struct

_MAX_BITS_OF_A_PALETTE = 8
# Where numbers stand: size of the header, bits of a pixel in the oldest and in all others, packing, masks, profile.
_HEADER_AT, _OLDEST_BITS_AT, _BITS_AT, _PACKING_AT, _MASKS_AT, _PROFILE_AT = 14, 24, 28, 30, 54, 70
# Bytes of headers of BMP: by OS/2 1, the first by Windows, the first with a mask of alpha, and both by OS/2 2.
_OLDEST_HEADER, _WINDOWS_HEADER, _ALPHA_HEADER, _LATER_OS2 = 12, 40, 56, (16, 64)
# Packings of BMP with masks of the bits of red, green and blue, and in the second of alpha.
_BIT_FIELDS = (3, 6)
_PROFILES = (b"KNIL", b"DEBM")  # in another file, or behind the pixels; by the header of version 5
_PROFILE_HEADER = 124  # bytes of it


def has_palette(data: bytes) -> bool:
    """Whether pixels have so few bits that they are indices; the headers of OS/2 and Windows differ."""
    at = _OLDEST_BITS_AT if _number(data, _HEADER_AT, 4) == _OLDEST_HEADER else _BITS_AT
    return 0 < _number(data, at, 2) <= _MAX_BITS_OF_A_PALETTE


def has_usual_bits(data: bytes) -> bool:
    """Whether OpenImageIO takes the right bits of a BMP file for its colours, and all for its alpha."""
    header, bits = _number(data, _HEADER_AT, 4), _number(data, _BITS_AT, 2)
    packing = _number(data, _PACKING_AT, 4)
    if packing not in _BIT_FIELDS or header < _WINDOWS_HEADER:
        return header not in _LATER_OS2
    *colours, alpha = (_number(data, _MASKS_AT + 4 * channel, 4) for channel in range(4))
    if header < _ALPHA_HEADER and packing != _BIT_FIELDS[1]:
        alpha = 0
    return alpha == 0 if bits == 16 else (colours == [0xFF0000, 0xFF00, 0xFF] and alpha in (0, 0xFF000000))


def is_plain(data: bytes) -> bool:
    """Whether a BMP file has 24 or 32 bits a pixel and a header of Windows: the kinds that are written."""
    return _number(data, _HEADER_AT, 4) >= _WINDOWS_HEADER and _number(data, _BITS_AT, 2) in (24, 32)


def _number(data: bytes, at: int, size: int) -> int:
    return int.from_bytes(data[at : at + size], "little")


def carried_over(source: bytes, encoded: bytes) -> bytes:
    """Replace the pixels, unless the first row is the top one; a header may describe, and hold, a profile."""
    (old, *storage), (new, *same) = (struct.unpack_from("<I4xiiHH", data, 10) for data in (source, encoded))
    width, height, _, bits = storage
    if storage != same:
        return encoded
    size = -(-width * bits // 32) * 4 * abs(height)  # rows are filled up to 4 bytes
    return source[:old] + encoded[new : new + size] + source[old + size :]


def metadata_names(data: bytes) -> dict[str, bool]:
    has_profile = data[_PROFILE_AT : _PROFILE_AT + 4] in _PROFILES and data[_HEADER_AT] >= _PROFILE_HEADER
    return {"colour profile": False} if has_profile else {}
