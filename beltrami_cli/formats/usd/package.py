"""USDZ packages: ZIP archives of stored files that start at multiples of 64 bytes.

References
----------
.. [1] "Usdz file format specification", version 1.3. https://openusd.org/release/spec_usdz.html
"""

from __future__ import annotations

import io
import posixpath
import struct
import zipfile
from collections.abc import Mapping

from beltrami_cli.errors import InputError
from beltrami_cli.formats.changes import Bytes
from beltrami_cli.formats.files.access import Access
from beltrami_cli.formats.files.archives import Archive, require_ratio

LAYERS = (".usd", ".usda", ".usdc")  # suffixes of files that usd-core reads
IMAGES = (".png", ".jpg", ".jpeg", ".exr", ".avif")  # suffixes of images that a package may hold [1]_
_SOUNDS = (".m4a", ".mp3", ".wav")
_ALIGNMENT, _PADDING = 64, 0x1986  # alignment in bytes, and the ID of extra fields for padding
_LOCAL_HEADER = struct.Struct("<4s5H3L2H")  # of a ZIP entry, before the name
_FIELD = struct.Struct("<2H")  # ID and length of an extra field
Date = tuple[int, int, int, int, int, int]
_DATE: Date = (1980, 1, 1, 0, 0, 0)  # fixed, so that packages are reproducible
_UNIX = 3


class Package(Archive):
    """An opened package, whose first file is the root layer."""

    def __init__(self, data: bytes, name: str, access: Access) -> None:
        super().__init__(data, name, access)
        self._data = data
        require_ratio(name, "the package", len(data), sum(entry.file_size for entry in self.entries))
        wrong = next((member for member in self.members if _is_unfit(member)), None)
        if wrong is not None or len(self.members) != len(self.entries):
            cause = "it has two files of one name" if wrong is None else f"it has a file named {wrong[:80]!r}"
            raise InputError(name, f"{cause}, which a package cannot have", "export it again")
        if not self.members or not self.members[0].lower().endswith(LAYERS):
            raise InputError(
                name, "its first file is not a USD layer", "export it again, by a program for USDZ"
            )
        self.layers = [member for member in self.members if member.lower().endswith(LAYERS)]

    def faults(self) -> list[str]:
        """Return violations of USDZ packing, one sentence each; readers that map packages into memory fail on them."""
        violations = []
        for entry in self.entries:
            *_, name_size, extra_size = _LOCAL_HEADER.unpack_from(self._data, entry.header_offset)
            start = entry.header_offset + _LOCAL_HEADER.size + name_size + extra_size
            if entry.compress_type:
                violations.append(f"{entry.filename} is compressed")
            elif start % _ALIGNMENT:
                violations.append(f"{entry.filename} does not start at a multiple of {_ALIGNMENT} bytes")
            if not entry.filename.lower().endswith((*LAYERS, *IMAGES, *_SOUNDS)):
                violations.append(f"{entry.filename} is of a type that no package may hold")
        return violations

    def packed(self, new: Mapping[str, Bytes]) -> list[Bytes]:
        """Return the package with new files: replacements keep their place, others are appended."""
        contents = {member: new.get(member) or self.read(member) for member in self.members}
        return packed(contents | dict(new), {entry.filename: entry.date_time for entry in self.entries})


def _is_unfit(name: str) -> bool:
    plain = posixpath.normpath(name)
    return plain != name or name.startswith(("/", "../")) or name == ".." or "\\" in name or ":" in name


def packed(files: Mapping[str, Bytes], dates: Mapping[str, Date] | None = None) -> list[Bytes]:
    """Return a package of files in the given order."""
    stream = io.BytesIO()
    try:
        with zipfile.ZipFile(stream, "w", allowZip64=False) as package:
            for name, content in files.items():
                entry = zipfile.ZipInfo(name, (dates or {}).get(name, _DATE))
                entry.create_system = _UNIX  # on every system, so that packages are reproducible
                padding = -(stream.tell() + _LOCAL_HEADER.size + len(name.encode())) % _ALIGNMENT
                padding += _ALIGNMENT if 0 < padding < _FIELD.size else 0
                filling = padding - _FIELD.size
                entry.extra = _FIELD.pack(_PADDING, filling) + bytes(filling) if padding else b""
                package.writestr(entry, content)
    except zipfile.LargeZipFile:
        raise InputError(name, "the package would have more than 2 GB", "choose smaller textures") from None
    return [stream.getbuffer()]
