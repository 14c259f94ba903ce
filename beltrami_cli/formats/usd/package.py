"""USDZ packages: ZIP archives of stored files, each of which starts at a multiple of 64 bytes.

References
----------
.. [1] "Usdz file format specification", version 1.3. https://openusd.org/release/spec_usdz.html
"""

from __future__ import annotations

import posixpath
import struct
import zlib
from typing import TYPE_CHECKING

from beltrami_cli.errors import InputError
from beltrami_cli.formats.access import require_ratio
from beltrami_cli.formats.archive import Archive

if TYPE_CHECKING:
    import zipfile
    from collections.abc import Mapping

    from beltrami_cli.formats.access import Access
    from beltrami_cli.formats.document import Bytes

LAYERS = (".usd", ".usda", ".usdc")
"""Suffixes of files that usd-core reads."""

IMAGES = (".png", ".jpg", ".jpeg", ".exr", ".avif")
"""Suffixes of images that a package may hold [1]_."""

_SOUNDS = (".m4a", ".mp3", ".wav")
_ALIGNMENT, _PADDING = 64, 0x1986  # the number of extra fields that only fill up
_LOCAL, _CENTRAL, _END = struct.Struct("<4s5H3L2H"), struct.Struct("<4s6H3L5H2L"), struct.Struct("<4s4H2LH")
_MOST = (1 << 32) - 1
_UTF_8, _VERSION = 1 << 11, 10
_DATE = (1980, 1, 1, 0, 0, 0)  # the same in every run


class Package:
    """An opened package, whose first file is the root layer."""

    def __init__(self, data: bytes, name: str, access: Access) -> None:
        self._archive, self._data = Archive(data, name, access), data
        self._dates = {entry.filename: entry.date_time for entry in self._archive.entries}
        entries = self._archive.entries
        require_ratio(name, "the package", len(data), sum(entry.file_size for entry in entries))
        wrong = next((each.filename for each in entries if _is_unfit(each.filename)), None)
        if wrong is not None or len(self._dates) != len(entries):
            cause = (
                f"it has a file named {wrong[:80]!r}" if wrong is not None else "it has two files of one name"
            )
            raise InputError(name, f"{cause}, which a package cannot have", "export it again")
        if not is_package(entries):
            raise InputError(name, "its first file is no USD layer", "export it again, by a program for USDZ")
        self.members = list(self._dates)
        self.root = self.members[0]
        self.layers = [member for member in self.members if member.lower().endswith(LAYERS)]

    def faults(self) -> list[str]:
        """Return what readers that map packages into memory cannot do with, one sentence each."""
        found = []
        for entry in self._archive.entries:
            sizes = _LOCAL.unpack_from(self._data, entry.header_offset)[
                -2:
            ]  # of the name and the extra fields
            start = entry.header_offset + _LOCAL.size + sum(sizes)
            if entry.compress_type:
                found.append(f"{entry.filename} is compressed")
            elif start % _ALIGNMENT:
                found.append(f"{entry.filename} does not start at a multiple of {_ALIGNMENT} bytes")
            if not entry.filename.lower().endswith((*LAYERS, *IMAGES, *_SOUNDS)):
                found.append(f"{entry.filename} is of a type that no package may hold")
        return found

    def read(self, member: str) -> bytes:
        """Return a file's content; InputError if it is damaged or too large."""
        return self._archive.read(member)

    def packed(self, new: Mapping[str, Bytes]) -> list[Bytes]:
        """Return a package with other files in the place of some, and the rest behind them."""
        contents = {member: new.get(member) or self.read(member) for member in self.members}
        return packed(contents | dict(new), self._dates)


def is_package(entries: list[zipfile.ZipInfo]) -> bool:
    """Whether the files of an archive make a package."""
    return bool(entries) and entries[0].filename.lower().endswith(LAYERS)


def _is_unfit(name: str) -> bool:
    plain = posixpath.normpath(name)
    return plain != name or name.startswith(("/", "../")) or name == ".." or "\\" in name or ":" in name


def packed(files: Mapping[str, Bytes], dates: Mapping[str, tuple[int, ...]] | None = None) -> list[Bytes]:
    """Return files as a package, in their order."""
    pieces: list[Bytes] = []
    central: list[bytes] = []
    at = 0
    for name, content in files.items():
        encoded = name.encode(errors="surrogateescape")
        year, month, day, hour, minute, second = (dates or {}).get(name, _DATE)
        time, date = hour << 11 | minute << 5 | second // 2, (year - 1980) << 9 | month << 5 | day
        flags = 0 if encoded.isascii() else _UTF_8
        padding = -(at + _LOCAL.size + len(encoded)) % _ALIGNMENT
        padding += _ALIGNMENT if 0 < padding < 4 else 0
        extra = struct.pack("<2H", _PADDING, padding - 4) + bytes(padding - 4) if padding else b""
        sums = zlib.crc32(content), len(content), len(content)
        # Method 0: stored.
        common = flags, 0, time, date, *sums, len(encoded)
        header = _LOCAL.pack(b"PK\x03\x04", _VERSION, *common, len(extra)) + encoded + extra
        central.append(_CENTRAL.pack(b"PK\x01\x02", _VERSION, _VERSION, *common, 0, 0, 0, 0, 0, at) + encoded)
        pieces += [header, content]
        at += len(header) + len(content)
        if at > _MOST:
            raise InputError(name, "the package would have more than 4 GB", "choose smaller textures")
    size = sum(map(len, central))
    end = _END.pack(b"PK\x05\x06", 0, 0, len(files), len(files), size, at, 0)
    return [*pieces, *central, end]
