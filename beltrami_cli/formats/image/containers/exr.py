"""Parts of EXR files, each with a header and chunks of pixels; a new file keeps all but the pixels of one part.

References
----------
.. [1] OpenEXR File Layout, Academy Software Foundation: version, headers of parts, tables of chunk addresses.
"""

from __future__ import annotations

import struct
from itertools import accumulate, islice, pairwise

_START = 8  # bytes: a mark, and the version with its flags
_MULTI_PART, _LONG_NAMES = 0x1000, 0x400  # flags
_COUNT = "chunkCount"
_OF_PARTS = ("name", "type", "version", _COUNT)  # which files of one part need not have
# How pixels, and parts of them, are stored, and what announces mip levels or describes the pixels of before.
_STRUCTURE = {
    "channels", "compression", "dataWindow", "lineOrder", "tiles", "dwaCompressionLevel",
    "textureformat", "oiio:AverageColor", "oiio:ConstantColor", "oiio:SHA-1", "oiio:subimages", *_OF_PARTS,
}  # fmt: skip

# Types of attributes that OpenImageIO reads, except previews.
_READ_BY_OPENIMAGEIO = {
    "string", "int", "float", "m33f", "m44f", "v3f", "v3i", "v2f", "v2i", "stringvector", "floatvector", "double",
    "v2d", "v3d", "m33d", "m44d", "box2i", "box2f", "timecode", "keycode", "chromaticities", "rational", "lineOrder",
}  # fmt: skip

Header = dict[str, tuple[str, bytes]]
"""Types and values of attributes by their names."""


def carried_over(source: bytes, encoded: bytes, part: int = 0) -> bytes:
    """Return an EXR file with the pixels of a part from another file, of one part, and all else as it was."""
    old, end = _headers(source)
    new, new_end = _headers(encoded)
    chunks = _chunks(source, end, old) if len(old) > 1 else [[]]
    chunks[part] = _chunks(encoded, new_end, new)[0]
    merged = {name: each for name, each in new[0].items() if name in _STRUCTURE and name not in _OF_PARTS}
    merged |= {name: each for name, each in old[part].items() if name not in _STRUCTURE or name in _OF_PARTS}
    if _COUNT in merged:
        merged[_COUNT] = "int", struct.pack("<i", len(chunks[part]))
    old[part] = merged
    flags, kept_flags = (int.from_bytes(data[4:_START], "little") for data in (encoded, source))
    if len(old) > 1:
        chunks[part] = [struct.pack("<i", part) + chunk for chunk in chunks[part]]
        flags = kept_flags
    flags |= kept_flags & _LONG_NAMES
    start = encoded[:4] + flags.to_bytes(4, "little")
    end_of_list = b"\0" if len(old) > 1 else b""  # an empty header
    head = start + b"".join(map(_packed, old)) + end_of_list
    stored = [chunk for each in chunks for chunk in each]
    places = accumulate(map(len, stored[:-1]), initial=len(head) + 8 * len(stored))
    return b"".join([head, struct.pack(f"<{len(stored)}Q", *places), *stored])


def metadata_names(data: bytes) -> dict[str, bool]:
    """Return the attributes of all parts, except those about pixels, and whether OpenImageIO reads them."""
    names: dict[str, bool] = {}
    for number, header in enumerate(_headers(data)[0]):
        where = f" of part {number + 1}" if number else ""
        for name, (kind, _) in header.items():
            if name not in _STRUCTURE:
                names[f"EXR attribute {name}{where}"] = number > 0 or kind in _READ_BY_OPENIMAGEIO
    return names


def _headers(data: bytes) -> tuple[list[Header], int]:
    """Read the headers of all parts, and where they end; ValueError or struct.error if they are damaged."""
    is_multi_part = bool(int.from_bytes(data[4:_START], "little") & _MULTI_PART)
    parts, at = list[Header](), _START
    while True:
        header, at = _header(data, at)
        if header or not is_multi_part:
            parts.append(header)
        if not (header and is_multi_part):
            return parts, at


def _header(data: bytes, at: int) -> tuple[Header, int]:
    header: Header = {}
    while data[at] != 0:
        texts = list[str]()
        for _ in range(2):  # the name and the type
            end = data.index(b"\0", at)
            texts.append(data[at:end].decode("latin-1"))
            at = end + 1
        (size,) = struct.unpack_from("<i", data, at)
        if not 0 <= size <= len(data) - at - 4:
            raise ValueError
        header[texts[0]] = texts[1], data[at + 4 : at + 4 + size]
        at += 4 + size
    return header, at + 1


def _packed(header: Header) -> bytes:
    return b"".join(
        b"%s\0%s\0" % (name.encode("latin-1"), kind.encode("latin-1")) + struct.pack("<i", len(value)) + value
        for name, (kind, value) in header.items()
    ) + b"\0"  # fmt: skip


def _chunks(data: bytes, at: int, parts: list[Header]) -> list[list[bytes]]:
    """Return the chunks of each part, which stand behind the tables of their addresses, in any order."""
    addresses = list[int]()
    first = len(data)
    while at + 8 * len(addresses) < first:  # the tables end where the first chunk begins
        addresses += struct.unpack_from("<Q", data, at + 8 * len(addresses))
        first = min(first, addresses[-1])
    ordered = sorted({*addresses, len(data)})
    if ordered[-1] != len(data) or len(ordered) != len(addresses) + 1:
        raise ValueError
    end_of = dict(pairwise(ordered))
    chunks = iter([data[address : end_of[address]] for address in addresses])
    counts = [len(addresses)]
    if len(parts) > 1:
        counts = [int.from_bytes(each[_COUNT][1], "little") for each in parts]
    if sum(counts) != len(addresses):
        raise ValueError
    return [[*islice(chunks, count)] for count in counts]
