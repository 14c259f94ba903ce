"""ZIP archives in which files come: every member is bounded before it is unpacked."""

from __future__ import annotations

import io
import zipfile
import zlib
from typing import TYPE_CHECKING

from beltrami_cli.errors import InputError
from beltrami_cli.formats.access import require_ratio

if TYPE_CHECKING:
    from beltrami_cli.formats.access import Access

_MOST_MEMBERS = 10_000
_LARGEST = 1 << 30  # bytes of a member, where no memory limit is given
_DAMAGED = "repack it, or export it again"


class Archive:
    """A ZIP archive in memory, of which members are read one by one, none beyond what is allowed."""

    def __init__(self, data: bytes, name: str, access: Access, share: int = 1) -> None:
        """`share` is how many times its size in memory a member takes while it is used."""
        self._name = name
        self._most = _LARGEST if access.memory is None else min(_LARGEST, access.memory // share)
        try:
            self._file = zipfile.ZipFile(io.BytesIO(data))
        except (zipfile.BadZipFile, NotImplementedError, ValueError, OSError) as error:
            raise InputError(name, f"the archive is damaged ({error})", _DAMAGED) from error
        if len(self._file.infolist()) > _MOST_MEMBERS:
            raise InputError(name, f"the archive has more than {_MOST_MEMBERS} members", _DAMAGED)

    @property
    def members(self) -> list[str]:
        """The names of all files in the archive."""
        return [name for name in self._file.namelist() if not name.endswith("/")]

    def read(self, member: str) -> bytes:
        """Return the content of a member; its true size is checked as well as the announced one."""
        try:
            known = self._file.getinfo(member)
            if known.file_size > self._most:
                raise self._too_large(member, known.file_size)
            require_ratio(self._name, member, known.compress_size, known.file_size)
            with self._file.open(known) as file:
                data = file.read(self._most + 1)
        except KeyError:
            raise InputError(self._name, f"the archive has no {member}", _DAMAGED) from None
        except (
            zipfile.BadZipFile,
            zlib.error,
            NotImplementedError,
            RuntimeError,
            EOFError,
            OSError,
            ValueError,
        ) as error:
            raise InputError(self._name, f"{member} in the archive is damaged ({error})", _DAMAGED) from error
        if len(data) > self._most:
            raise self._too_large(member, len(data))
        return data

    def _too_large(self, member: str, size: int) -> InputError:
        cause = f"{member} in the archive has {size} bytes, more than the {self._most} that are read"
        return InputError(self._name, cause, "raise --max-memory, or give a smaller model")

    @property
    def entries(self) -> list[zipfile.ZipInfo]:
        """What is known of all files in the archive, in their order."""
        return [entry for entry in self._file.infolist() if not entry.filename.endswith("/")]
