"""Bounded reading of ZIP archives, and how large packed data may become."""

from __future__ import annotations

import contextlib
import io
import zipfile
import zlib
from collections.abc import Iterator

from beltrami_cli.errors import InputError, MemoryLimitError
from beltrami_cli.formats.files.access import DEFAULT_ACCESS, Access

# Bytes up to which any compression ratio is accepted, and the largest ratio beyond.
_MIN_UNPACKED, _MAX_RATIO = 1 << 26, 100
_MAX_MEMBER = 1 << 30  # bytes of a member, where no memory limit is given
_READ_ERRORS = (zipfile.BadZipFile, zlib.error, RuntimeError, EOFError, OSError, ValueError)
_DAMAGED = "repack it, or export it again"


def most_unpacked(packed: int) -> int:
    """Return the most bytes that a legitimate model unpacks to."""
    return max(_MIN_UNPACKED, _MAX_RATIO * packed)


def is_too_dense(packed: int, unpacked: int) -> bool:
    """Whether the compression ratio exceeds that of any legitimate model."""
    return unpacked > most_unpacked(packed)


def require_ratio(name: str, what: str, packed: int, unpacked: int) -> None:
    """Raise InputError if packed data `is_too_dense`."""
    if is_too_dense(packed, unpacked):
        cause = f"{what} is {unpacked} bytes in {packed} packed ones, more than any model has"
        raise InputError(name, cause, "save it uncompressed, if it is meant so")


@contextlib.contextmanager
def refusing_damage(name: str, what: str, remedy: str = _DAMAGED) -> Iterator[None]:
    try:
        yield
    except _READ_ERRORS as error:
        raise InputError(name, f"{what} is damaged ({error})", remedy) from error


class Archive:
    """A ZIP archive in memory; members are read one by one, within limits. InputError if it is damaged."""

    def __init__(
        self, data: bytes, name: str, access: Access = DEFAULT_ACCESS, memory_per_byte: int = 1
    ) -> None:
        """`memory_per_byte`: what a member takes while it is used, for each of its bytes."""
        self.name = name
        self._most = (
            _MAX_MEMBER if access.memory is None else min(_MAX_MEMBER, access.memory // memory_per_byte)
        )
        with refusing_damage(name, "the archive"):
            self._file = zipfile.ZipFile(io.BytesIO(data))
        self.entries = [entry for entry in self._file.infolist() if not entry.filename.endswith("/")]
        self._entry_of = {entry.filename: entry for entry in self.entries}
        self.members = list(self._entry_of)

    def read(self, member: str) -> bytes:
        known = self._entry_of.get(member)
        if known is None:
            raise InputError(self.name, f"the archive has no {member}", _DAMAGED)
        if known.file_size > self._most:
            cause = f"{member} in the archive has {known.file_size} bytes, more than the {self._most} that are read"
            raise MemoryLimitError(self.name, cause, "raise --max-memory, or give a smaller model")
        require_ratio(self.name, member, known.compress_size, known.file_size)
        return self._content(known)

    def _content(self, member: zipfile.ZipInfo) -> bytes:
        what = f"{member.filename} in the archive"
        with refusing_damage(self.name, what), self._file.open(member) as file:
            # Without a size, all would be unpacked, whatever was announced.
            return file.read(member.file_size)
