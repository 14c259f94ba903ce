"""Move a temporary file to its path, and put the replaced file back."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from beltrami_cli.jobs.writing.file_rights import PRIVATE, take_over
from beltrami_cli.jobs.writing.locks import close_descriptor

# Size and modification time: a file keeps them when it is linked, renamed, or moved to another file system.
Identity = tuple[int, int]


@dataclass(frozen=True)
class TemporaryFile:
    """A file under a temporary name, its final path, and whether it may replace a file there."""

    temporary: Path
    path: Path
    overwrite: bool = False
    identity: Identity | None = None  # None: it is not yet being moved into place

    @property
    def previous(self) -> Path:
        """The path of the replaced file until the set is complete."""
        return self.temporary.with_suffix(".previous.tmp")


def identity_of(path: Path) -> Identity | None:
    try:
        status = path.lstat()
    except FileNotFoundError:
        return None
    return status.st_size, status.st_mtime_ns


def undo(files: Sequence[TemporaryFile]) -> OSError | None:
    """Restore the previous files of all paths; return why that fails for one."""
    failure = None
    for file in reversed(files):
        try:
            _roll_back(file)
        except OSError as error:
            failure = error
    return failure


def _roll_back(file: TemporaryFile) -> None:
    """Restore the previous file of a path, unless another process has replaced it meanwhile."""
    now = identity_of(file.path)
    # On file systems without links, `_put_new` reserves a name by an empty file.
    is_reserved = now is not None and now[0] == 0 and os.path.lexists(file.temporary)
    if file.overwrite:
        if now in (None, file.identity) and os.path.lexists(file.previous):
            file.previous.replace(file.path)
    elif file.identity is not None and (now == file.identity or is_reserved):
        file.path.unlink()


def put(file: TemporaryFile, *, keep: bool) -> None:
    """Move a file into place, and `keep` the replaced file under another name."""
    try:
        if not file.overwrite:
            _put_new(file.temporary, file.path)
            return
        if keep:
            try:
                os.link(file.path, file.previous)
            except OSError:  # on file systems without hard links
                _copy(file.path, file.previous)
        file.temporary.replace(file.path)
    except OSError as error:
        error.filename = str(file.path)
        raise


def _copy(path: Path, copy: Path) -> None:
    """Copy a file with its rights and times."""
    close_descriptor(os.open(copy, os.O_CREAT | os.O_EXCL | os.O_WRONLY, PRIVATE))
    shutil.copyfile(path, copy)
    take_over(path, copy)
    status = path.stat()
    os.utime(copy, ns=(status.st_atime_ns, status.st_mtime_ns))


def _put_new(temporary: Path, path: Path) -> None:
    """Move a file to an unused path; FileExistsError if a file exists there, or appears meanwhile."""
    try:
        os.link(temporary, path)
    except FileExistsError:
        with contextlib.suppress(OSError):
            if temporary.samefile(path):  # on NFS the link may exist although the reply was lost
                return
        raise
    except OSError:  # the file system has no hard links
        # Only one process can make the empty file, and may then replace it.
        close_descriptor(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY))
        try:
            temporary.replace(path)
        except OSError:
            path.unlink()
            raise
