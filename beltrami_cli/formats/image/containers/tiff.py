"""Tags of TIFF files: all that do not describe the storage of pixels are copied from one file to another.

References
----------
.. [1] TIFF Revision 6.0, Adobe 1992, sections 2 and 8; private tags are any numbers from 32768.
.. [2] BigTIFF: the same with addresses of 64 bits.
.. [3] Exif 3.0, section 4.6: directories of EXIF, GPS and interoperability.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

# Bytes of one value, and of the numbers in it that have a byte order, by the type of a tag [1]_ [2]_.
_SIZES = {
    1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4, 16: 8, 17: 8, 18: 8,
}  # fmt: skip
_ORDERED = {3: 2, 4: 4, 5: 4, 8: 2, 9: 4, 10: 4, 11: 4, 12: 8, 13: 4, 16: 8, 17: 8, 18: 8}
_ONLY_IN_BIG = (16, 17, 18)
_IFD_TYPES = (13, 18)  # addresses of directories
_SUB_IFDS, _EXIF, _GPS, _INTEROPERABILITY = 330, 34665, 34853, 40965
_DIRECTORIES = (_SUB_IFDS, _EXIF, _GPS, _INTEROPERABILITY)
_MAX_DEPTH = 4  # of directories: EXIF has two below that of the image
_IPTC = 33723  # bytes, though their type is mostly LONG
_PIXEL_ADDRESSES = (273, 324, 513)  # strips, tiles, JPEG streams
# Width, height, bits, compression and its parameters, photometric interpretation, order of bits, strips, samples,
# planes, predictor, palette, tiles, extra samples, sample format, JPEG and YCbCr.
_STRUCTURE = {
    256, 257, 258, 259, 262, 263, 264, 265, 266, 273, 277, 278, 279, 284, 288, 289, 292, 293, 317, 320, 322, 323, 324,
    325, 338, 339, 347, *range(512, 522), 529, 530, 531, 532,
}  # fmt: skip
_TEXTURE_FORMAT = 33302  # of Pixar: says that there are mip levels, which are left out
_PHOTOSHOP_LAYERS = 37724  # which programs show instead of the image
# Ranges and curves of levels, which new samples need not fit.
_OF_SAMPLES = {280, 281, 290, 291, 301, 340, 341}
# Tags that stand in EXIF data, too [3]_: texts, resolution, dates, people and directories.
_OF_EXIF = {270, 271, 272, 274, 282, 283, 296, 305, 306, 315, 33432, _EXIF, _GPS}
# Tags that OpenImageIO reads: further texts, XMP, IPTC, the colour profile; and kinds and numbers of pages.
_READ_BY_OPENIMAGEIO = {254, 255, 269, 285, 297, 316, 700, _IPTC, 34675, *_OF_EXIF}
_EMPTY = b"II*\0\x08\0\0\0\0\0\0\0\0\0"  # without tags
_NAMES = {_SUB_IFDS: "further images", _EXIF: "EXIF", _GPS: "GPS", _PHOTOSHOP_LAYERS: "layers of Photoshop"}


class _Form(NamedTuple):
    """How a file stores numbers and addresses: formats of `struct`."""

    order: str  # of bytes
    is_big: bool
    address: str
    entries: str  # their number in a directory
    inline: int  # bytes of values that an entry holds itself


@dataclass(frozen=True)
class _Entry:
    kind: int
    count: int
    values: bytes  # little-endian
    directories: tuple[dict[int, _Entry], ...] = ()  # in place of values


def is_big(data: bytes) -> bool:
    """Whether a TIFF file has addresses of 64 bits."""
    return data[:4] in (b"II+\0", b"MM\0+")


def carried_over(source: bytes, encoded: bytes) -> bytes:
    """Return a TIFF image with the tags of another file, except those about the storage of pixels."""
    old, new = _Directories(source).first, _Directories(encoded).first
    dropped = {*_STRUCTURE, _TEXTURE_FORMAT, _PHOTOSHOP_LAYERS, *_OF_SAMPLES}
    kept = {tag: entry for tag, entry in old.items() if tag not in dropped}
    return _with_directory(encoded, kept | {tag: entry for tag, entry in new.items() if tag in _STRUCTURE})


def merged_exif(exif: bytes, encoded: bytes) -> bytes:
    """Return a TIFF image, or EXIF data, with its tags and the tags of other EXIF data."""
    old, new = (_Directories(data or _EMPTY).first for data in (exif, encoded))
    has_pixels = any(tag in new for tag in _PIXEL_ADDRESSES)
    return _with_directory(encoded if has_pixels else _EMPTY, new | _of_exif(old))


def exif_tags(data: bytes) -> dict[str, bytes]:
    """Return the values of the tags that EXIF data share with TIFF images, called as by `metadata_names`."""
    return _flat(_of_exif(_Directories(data or _EMPTY).first))


def value_of(data: bytes, tag: int) -> bytes:
    """Return the value of a tag of the first image, or nothing."""
    entry = _Directories(data).first.get(tag)
    return b"" if entry is None else entry.values


def _of_exif(entries: dict[int, _Entry]) -> dict[int, _Entry]:
    return {tag: entry for tag, entry in entries.items() if tag in _OF_EXIF}


def _with_directory(data: bytes, entries: dict[int, _Entry]) -> bytes:
    form, written = _form(data), bytearray(data)  # little-endian
    at = _append(written, entries, form)
    struct.pack_into(form.address, written, form.inline, at)
    return bytes(written)


def metadata_names(data: bytes) -> dict[str, bool]:
    """Return the names of the tags of the first image, except those about the storage of pixels.

    And whether OpenImageIO reads them; tags in further directories stand behind the tag of the directory.
    """
    read = _Directories(data)
    left_out = {*_STRUCTURE, _TEXTURE_FORMAT}
    found = _flat({tag: each for tag, each in read.first.items() if tag not in left_out})
    known = {*map(str, _READ_BY_OPENIMAGEIO)}
    names = (*found, *map(_called, read.unreadable - left_out))
    return {f"TIFF tag {name}": name.split()[0] in known for name in names}


def _flat(entries: dict[int, _Entry], prefix: str = "") -> dict[str, bytes]:
    found: dict[str, bytes] = {}
    for tag, entry in entries.items():
        found[prefix + _called(tag)] = entry.values
        for directory in entry.directories:
            found |= _flat(directory, f"{prefix}{_called(tag)} ")
    return found


def _called(tag: int) -> str:
    return f"{tag} ({_NAMES[tag]})" if tag in _NAMES else str(tag)


def _form(data: bytes) -> _Form:
    order, big = "<" if data[:2] == b"II" else ">", is_big(data)
    return _Form(
        order, big, f"{order}{'Q' if big else 'I'}", f"{order}{'Q' if big else 'H'}", 8 if big else 4
    )


class _Directories:
    """The directories of the first image in a file; damaged ones in it are left out."""

    def __init__(self, data: bytes) -> None:
        self._data, self._form = data, _form(data)
        self._seen = set[int]()
        self._left = len(data)  # bytes of values that may still be read, each once
        self.unreadable = set[int]()  # tags
        (at,) = struct.unpack_from(self._form.address, data, self._form.inline)
        self.first = self._directory(at, 0)

    def _directory(self, at: int, depth: int) -> dict[int, _Entry]:
        """Read a directory; ValueError or struct.error if it is damaged or was read before."""
        if at in self._seen or depth > _MAX_DEPTH:
            raise ValueError
        self._seen.add(at)
        form, entries = self._form, dict[int, _Entry]()
        (count,) = struct.unpack_from(form.entries, self._data, at)
        at += struct.calcsize(form.entries)
        size = 4 + 2 * form.inline
        for place in range(at, min(at + count * size, len(self._data) - size + 1), size):
            tag, kind = struct.unpack_from(f"{form.order}HH", self._data, place)
            try:
                entries[tag] = self._entry(tag, kind, place + 4, depth)
            except (ValueError, struct.error):
                if depth:
                    raise
                self.unreadable.add(tag)
        return entries

    def _entry(self, tag: int, kind: int, at: int, depth: int) -> _Entry:
        form = self._form
        if kind not in _SIZES or (kind in _ONLY_IN_BIG and not form.is_big):
            raise ValueError
        (count,) = struct.unpack_from(form.address, self._data, at)
        at += form.inline
        size = count * _SIZES[kind]
        if size > form.inline:
            (at,) = struct.unpack_from(form.address, self._data, at)
        self._left -= size
        values = self._data[at : at + size]
        if len(values) < size or self._left < 0:
            raise ValueError
        if kind in _ORDERED and form.order == ">" and tag != _IPTC:
            values = np.frombuffer(values, f">u{_ORDERED[kind]}").astype(f"<u{_ORDERED[kind]}").tobytes()
        if tag not in _DIRECTORIES and kind not in _IFD_TYPES:
            return _Entry(kind, count, values)
        places = np.frombuffer(values, f"<u{_SIZES[kind]}").tolist()
        inside = tuple(self._directory(place, depth + 1) for place in places)
        if any(pixels in directory for directory in inside for pixels in _PIXEL_ADDRESSES):
            raise ValueError
        return _Entry(kind, count, b"", inside)


def _append(written: bytearray, entries: dict[int, _Entry], form: _Form) -> int:
    """Append a directory to a little-endian file; return its address."""
    listed = list[bytes]()
    for tag, entry in sorted(entries.items()):
        kind, values = entry.kind, entry.values
        if entry.directories:
            places = [_append(written, each, form) for each in entry.directories]
            kind = (18 if form.is_big else 13) if kind in _IFD_TYPES else (16 if form.is_big else 4)
            values = b"".join(struct.pack(form.address, place) for place in places)
        if len(values) > form.inline:
            at = _appended(written, values)
            values = struct.pack(form.address, at)
        head = struct.pack(f"{form.order}HH", tag, kind) + struct.pack(form.address, entry.count)
        listed.append(head + values.ljust(form.inline, b"\0"))
    end = struct.pack(form.address, 0)
    return _appended(written, struct.pack(form.entries, len(listed)) + b"".join(listed) + end)


def _appended(written: bytearray, values: bytes) -> int:
    written += bytes(-len(written) % 8)  # addresses are even [1]_, in BigTIFF multiples of 8
    at = len(written)
    written += values
    return at
