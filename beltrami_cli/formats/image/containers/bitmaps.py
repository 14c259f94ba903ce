"""Headers of BMP and TGA files: which kinds are read and written, and metadata that a new file keeps."""

from __future__ import annotations

import struct

_MAX_BITS_OF_A_PALETTE = 8
# Bytes of headers of BMP: the first by Windows, the first with a mask of alpha, and both by OS/2 2.
_WINDOWS_HEADER, _ALPHA_HEADER, _LATER_OS2 = 40, 56, (16, 64)
# Packings of BMP with masks of the bits of red, green and blue, and in the second of alpha.
_BIT_FIELDS = (3, 6)
TARGA_END = b"TRUEVISION-XFILE.\0"  # after the addresses of the extension and developer areas
_TARGA_ALPHA = 494  # byte of the former


def bmp_has_palette(data: bytes) -> bool:
    """Whether pixels have so few bits that they can only be indices, in the header of OS/2 or in that of Windows."""
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


def is_plain_bmp(data: bytes) -> bool:
    """Whether a BMP file has 24 or 32 bits a pixel and a header of Windows: the kinds that are written."""
    header, bits = (int.from_bytes(data[at : at + n], "little") for at, n in ((14, 4), (28, 2)))
    return header >= _WINDOWS_HEADER and bits in (24, 32)


def carried_bmp(source: bytes, encoded: bytes) -> bytes:
    """Replace the pixels, unless the first row is the top one; a header may describe, and hold, a profile."""
    (old, *storage), (new, *same) = (struct.unpack_from("<I4xiiHH", data, 10) for data in (source, encoded))
    width, height, _, bits = storage
    if storage != same:
        return encoded
    size = -(-width * bits // 32) * 4 * abs(height)  # rows are filled up to 4 bytes
    return source[:old] + encoded[new : new + size] + source[old + size :]


def targa_has_palette(data: bytes) -> bool:
    """Whether there is a map of colours, and pixels that number them, plain or in runs."""
    return data[1:3] in (b"\1\1", b"\1\x09")


def carried_targa(source: bytes, encoded: bytes) -> bytes:
    """Replace what the header and the extension area of a TGA file say about alpha: whether there is any."""
    made = bytearray(encoded)
    if source[16] == made[16]:  # bits of a pixel; the next byte says how many of them are alpha
        made[17] = made[17] & 0xF0 | source[17] & 0x0F
    old, new = (int.from_bytes(data[-26:-22], "little") + _TARGA_ALPHA for data in (source, encoded))
    if source.endswith(TARGA_END) and encoded.endswith(TARGA_END) and _TARGA_ALPHA < old < len(source) - 26:
        made[new] = source[old]
    return bytes(made)
