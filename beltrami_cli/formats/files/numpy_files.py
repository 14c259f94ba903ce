"""Bounded reading of NumPy arrays, in files of their own (.npy) or in archives (.npz).

Nothing is unpickled, and headers are checked before anything is allocated. The format of arrays:
https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html
"""

from __future__ import annotations

import contextlib
import io
import math
import tokenize
import warnings
import zipfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import IO, Any, Literal

import numpy as np

from beltrami_cli.arrays import Array
from beltrami_cli.errors import InputError, MemoryLimitError
from beltrami_cli.formats.files.archives import Archive, refusing_damage, require_ratio

_MAGIC = b"PK\x03\x04"
NPY_MAGIC = b"\x93NUMPY"
_LONGEST_HEADER = 10_000  # NumPy's own limit: longer ones could overload the parser of Python literals
_DEFLATE_RATIO = 1032  # the largest possible ratio: zlib's technical notes
_SAVE = "write it with numpy.savez_compressed"

# Of several names, the first that an archive has counts. An archive with a level set key is a level set.
LEVEL_SET_KEYS = ("values", "sdf", "tsdf", "level_set")
POSITION_KEYS = ("positions", "points", "xyz")


@dataclass(frozen=True)
class Header:
    """The header of an array of numbers or booleans; its numbers start at `offset` of the member."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    fortran: bool
    offset: int

    @property
    def count(self) -> int:
        return math.prod(self.shape)

    @property
    def size(self) -> int:
        return self.count * self.dtype.itemsize

    def array(self, data: bytes, offset: int = 0) -> Array:
        """Return the numbers that start at an offset of `data`, in native byte order."""
        flat = np.frombuffer(data, self.dtype, self.count, offset)
        array = flat.reshape(self.shape, order="F" if self.fortran else "C")
        return array.astype(self.dtype.newbyteorder("="), copy=False)

    def with_numbers(self, member: bytes, array: Array) -> bytes:
        numbers = array.astype(self.dtype).tobytes("F" if self.fortran else "C")
        return member[: self.offset] + numbers + member[self.offset + len(numbers) :]


def is_npz(data: bytes) -> bool:
    """Whether a file is an archive that starts with an array."""
    if data[:4] != _MAGIC or len(data) < 30:
        return False
    # The name of the first member follows its local header: PKWARE's APPNOTE.TXT, section 4.3.7.
    return data[30 : 30 + int.from_bytes(data[26:28], "little")].endswith(b".npy")


class NpzArchive(Archive):
    def __init__(self, data: bytes, name: str) -> None:
        super().__init__(data, name)
        self.names = tuple(member[:-4] for member in self.members if member.endswith(".npy"))

    def kind(self) -> Literal["level set", "points"] | None:
        if self.first(LEVEL_SET_KEYS):
            return "level set"
        return "points" if self.first(POSITION_KEYS) else None

    def first(self, names: Iterable[str]) -> str | None:
        return next((name for name in names if name in self.names), None)

    def header(self, key: str) -> Header:
        """Read the header of an array; InputError if it is damaged, or of other types than numbers and booleans."""
        member = self._entry_of[f"{key}.npy"]
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise self._error(key, "is compressed in a way that NumPy does not write")
        with self._opened(key) as file:
            header = _parse_header(file.read(_LONGEST_HEADER + 12))
        if not _holds_numbers(header):
            raise self._error(key, f"is of type {header.dtype}, and not of real numbers")
        if member.file_size < header.offset + header.size:
            raise self._error(key, f"of shape {header.shape} has too few numbers")
        if member.file_size > _DEFLATE_RATIO * (member.compress_size + 1):
            raise self._error(key, "says that it is longer than its bytes can be")
        return header

    def array(self, key: str, most: int | None = None) -> Array:
        """Read an array; InputError as `header`, or if it has more than `most` numbers."""
        header = self.header(key)
        if most is not None and header.count > most:
            has = f"has {header.count} numbers, and {most} are allowed"
            cause = f"the array {key} of shape {header.shape} {has}"
            raise MemoryLimitError(self.name, cause, "raise --max-voxels or --max-memory")
        with self._opened(key) as file:
            file.read(header.offset)
            data = file.read(header.size)
            file.read(1)  # reaching the end checks the archive's checksum
        if len(data) < header.size:
            raise self._error(key, "ends too early")
        return header.array(data)

    def require_ratio(self, key: str) -> None:
        member = self._entry_of[f"{key}.npy"]
        require_ratio(self.name, f"the array {key}", member.compress_size, member.file_size)

    def contents(self) -> dict[str, bytes]:
        """Return the contents of all members by their file names; InputError if one cannot be unpacked."""
        return {member.filename: self._content(member) for member in self._file.infolist()}

    def with_array(self, key: str, array: Array) -> bytes:
        """Return the archive with new numbers in one array; members keep their order, dates and compression."""
        buffer, header = io.BytesIO(), self.header(key)
        with zipfile.ZipFile(buffer, "w") as new:
            new.comment = self._file.comment
            for member in self._file.infolist():
                content = self._content(member)
                if member.filename == f"{key}.npy":
                    content = header.with_numbers(content, array)
                info = zipfile.ZipInfo(member.filename, member.date_time)
                info.compress_type, info.comment = member.compress_type, member.comment
                info.external_attr, info.create_system = member.external_attr, member.create_system
                new.writestr(info, content)
        return buffer.getvalue()

    @contextlib.contextmanager
    def _opened(self, key: str) -> Iterator[IO[bytes]]:
        with refusing_damage(self.name, f"the array {key}", _SAVE), self._file.open(f"{key}.npy") as file:
            yield file

    def _error(self, key: str, cause: str) -> InputError:
        return InputError(self.name, f"the array {key} {cause}", _SAVE)


def read_npy(data: bytes, name: str) -> Array:
    """Read the file of a single array; InputError if it is damaged or not of numbers."""
    with refusing_damage(name, "the array", "write it with numpy.save"):
        header = _parse_header(data[: _LONGEST_HEADER + 12])
    if not _holds_numbers(header):
        raise InputError(name, f"the array is of type {header.dtype}, and not of real numbers")
    if len(data) - header.offset < header.size:
        cause = f"the array of shape {header.shape} has too few numbers"
        raise InputError(name, cause, "the file is cut off")
    return header.array(data, header.offset)


def _holds_numbers(header: Header) -> bool:
    return header.dtype.kind in "buif" and header.dtype.itemsize <= 8


def _parse_header(start: bytes) -> Header:
    file = io.BytesIO(start)
    version = np.lib.format.read_magic(file)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"version {version} of the format is for records only")
    # The header states its own length; since only a bounded part of the file is read, a wrong one does no harm.
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    with warnings.catch_warnings(action="ignore"):  # of headers as Python 2 wrote them, which are understood
        try:
            shape, fortran, dtype = read(file, max_header_size=_LONGEST_HEADER)
        except (SyntaxError, tokenize.TokenError, TypeError, RecursionError, MemoryError) as error:
            raise ValueError("its header is not a description of an array") from error
    if any(side < 0 for side in shape):
        raise ValueError(f"the shape is {shape}")
    return Header(shape, dtype, fortran, file.tell())
