"""Write files under temporary names, and move them to their paths together.

A run that writes files has a journal, `.beltrami-ID.tmp` in OUTPUT's folder, which it keeps locked. It names the
temporary files, `.beltrami-ID.N.tmp`, each in its target's folder. Before several files are put in place it lists them,
and replaced files are kept as `.beltrami-ID.N.previous.tmp`; the set is complete when the last line is written. An
unlocked journal is of a killed run: the next run in the folder undoes its unfinished set, and removes the temporary
files. Signals that would end the process wait while files are put in place or removed.
"""

from __future__ import annotations

import contextlib
import errno
import filecmp
import json
import logging
import os
import re
import stat
import zlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from beltrami_cli.formats.files.bounded_text import parse_json
from beltrami_cli.jobs.writing.file_rights import PRIVATE, take_over
from beltrami_cli.jobs.writing.locks import close_descriptor, folders_locked, try_lock
from beltrami_cli.jobs.writing.placing import TemporaryFile, identity_of, put, undo
from beltrami_cli.signals import signals_deferred

if TYPE_CHECKING:
    from beltrami_cli.formats.changes import Bytes

LOG = logging.getLogger(__name__)
_JOURNAL = re.compile(r"\.beltrami-[0-9a-f]{12}\.tmp")
_COMMITTED = True  # last line of a journal whose set is complete or rolled back
_LARGEST_JOURNAL = 1 << 26  # bytes: 10,000 files with paths of 4096 bytes
_user = getattr(os, "geteuid", int)  # 0 where there are no users
_OPEN_FLAGS = (
    os.O_RDWR | getattr(os, "O_BINARY", 0) | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
)
_BLOCK = 1 << 20  # bytes read back at a time


class Journal:
    """The temporary files of a run, and their journal, from which the next run cleans up if this one is killed.

    It is made within the lock of its folder, so that no other run finds it before it is locked itself.
    The `filename` of an OSError is the path that could not be written.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / f".beltrami-{os.urandom(6).hex()}.tmp"
        self._files, self._is_needed = list[TemporaryFile](), False
        self._staged: dict[Path, TemporaryFile] = {}  # files that are moved into place, by path
        self._made_folders: list[Path] = []  # innermost first
        self._descriptor = os.open(self._path, _OPEN_FLAGS | os.O_CREAT | os.O_EXCL, 0o600)
        self._lock = contextlib.ExitStack()
        self._lock.callback(close_descriptor, self._descriptor)
        try_lock(self._descriptor)

    def stage(self, path: Path, pieces: Iterable[Bytes], *, overwrite: bool) -> None:
        """Write a file under a temporary name, with the rights of a new file, or of the file that it replaces."""
        missing = takewhile(lambda each: not each.exists(), (path.parent, *path.parent.parents))
        self._made_folders = [*missing, *self._made_folders]
        path.parent.mkdir(parents=True, exist_ok=True)
        file = TemporaryFile(path.with_name(f"{self._path.stem}.{len(self._files)}.tmp"), path, overwrite)
        self._files.append(file)
        self._list(file)
        replaces = overwrite and path.exists()
        flags = os.O_CREAT | os.O_EXCL | os.O_WRONLY | getattr(os, "O_BINARY", 0)
        descriptor = os.open(file.temporary, flags, PRIVATE if replaces else 0o666)
        with os.fdopen(descriptor, "wb") as opened:
            checksum = _write_pieces(opened, pieces)
            opened.flush()
            os.fsync(descriptor)
        _require_readable(file.temporary, checksum)
        if replaces:
            take_over(path, file.temporary)
        self._staged[path] = file

    def temporary_files(self) -> dict[Path, Path]:
        """Return the temporary files by the paths that they will have."""
        return {path: file.temporary for path, file in self._staged.items()}

    def keep_equal(self) -> None:
        """Keep existing files that have the same bytes; FileExistsError if one differs."""
        for path, file in list(self._staged.items()):
            try:
                if not path.exists():
                    self._staged[path] = replace(file, overwrite=False)
                elif filecmp.cmp(path, file.temporary, shallow=False):
                    del self._staged[path]
                else:
                    raise FileExistsError
            except OSError as error:
                error.filename = str(path)
                raise

    def commit(
        self, order: Callable[[Path], tuple[bool, bool, str]], may_replace: Callable[[Path], bool]
    ) -> None:
        """Move all files into place in an order, or none; `may_replace` decides on files that appeared meanwhile."""
        paths = sorted(self._staged, key=order)
        with folders_locked(path.parent for path in paths), signals_deferred():
            self._rename_all([_allowed_to_replace(self._staged[path], may_replace) for path in paths])
            self._made_folders.clear()
            self._remove_temporary_files()

    def close(self) -> None:
        """Remove files and folders that were not moved into place."""
        with signals_deferred():
            self._remove_temporary_files()
            for folder in self._made_folders:
                with contextlib.suppress(OSError):  # it may contain other files by now
                    folder.rmdir()
            self._made_folders.clear()

    def _rename_all(self, files: Sequence[TemporaryFile]) -> None:
        """Move all files into place, in this order, or none; OSError names the file that failed."""
        if len(files) < 2:  # a single rename is atomic
            for file in files:
                put(file, keep=False)
            return
        moving, in_place = list[TemporaryFile](), list[TemporaryFile]()
        for file in files:
            replaces = file.overwrite and os.path.lexists(file.path)
            moving.append(replace(file, identity=identity_of(file.temporary), overwrite=replaces))
            self._list(moving[-1])
        os.fsync(self._descriptor)
        try:
            for file in moving:
                put(file, keep=True)
                in_place.append(file)
            if not os.fstat(self._descriptor).st_nlink:
                raise OSError(errno.ESTALE, "another run has removed its temporary files")
            self._write(_COMMITTED)
        except BaseException as error:
            self._roll_back(in_place, error)
            raise
        with contextlib.suppress(OSError):  # It must be on the disk before replaced files are removed.
            os.fsync(self._descriptor)

    def _roll_back(self, files: Sequence[TemporaryFile], error: BaseException) -> None:
        """Restore what files in place have replaced; if that fails for one, the next run does it by the journal."""
        if (stuck := undo(files)) is not None:
            self._is_needed = True
            state = f"{stuck.filename} stays until the next run with this output ({stuck.strerror})"
            raise OSError(errno.EIO, f"{error}; {state}") from error
        with contextlib.suppress(OSError):  # A second rollback would do no harm.
            self._write(_COMMITTED)

    def _remove_temporary_files(self) -> None:
        """Remove the temporary files, unless the next run needs them to roll back."""
        self._lock.close()
        # It is not a failure if some stay, since all outputs are complete.
        for error in [] if self._is_needed else _remove(self._files, self._path):
            LOG.warning("the temporary file %s cannot be removed (%s)", error.filename, error.strerror)

    def _list(self, file: TemporaryFile) -> None:
        # Relative names stay valid if the whole folder is moved.
        name = str(file.temporary).removeprefix(f"{self._path.parent}{os.sep}")
        self._write([name, file.path.name, file.overwrite, file.identity])

    def _write(self, value: object) -> None:
        left = memoryview(json.dumps(value).encode() + b"\n")
        while left:
            left = left[os.write(self._descriptor, left) :]


def _allowed_to_replace(file: TemporaryFile, may_replace: Callable[[Path], bool]) -> TemporaryFile:
    if file.overwrite or not os.path.lexists(file.path) or not may_replace(file.path):
        return file
    take_over(file.path, file.temporary)
    return replace(file, overwrite=True)


def _write_pieces(file: BinaryIO, pieces: Iterable[Bytes]) -> int:
    """Write pieces to a file, and return their checksum."""
    checksum = 0
    for piece in pieces:
        file.write(piece)
        checksum = zlib.crc32(piece, checksum)
    return checksum


def _require_readable(path: Path, checksum: int) -> None:
    """Raise OSError unless a file reads back as written, since file systems may lose data without an error."""
    again = 0
    with path.open("rb") as file:
        while block := file.read(_BLOCK):
            again = zlib.crc32(block, again)
    if again != checksum:
        raise OSError(errno.EIO, "the bytes read back differ from the bytes written", str(path))


def recover(folder: Path) -> None:
    """Roll back unfinished sets of killed runs by the journals in a folder, and remove their temporary files.

    Files of running processes, or of other users, stay. OSError if files in place cannot be undone.
    """
    journals: list[Path] = []
    with contextlib.suppress(OSError):
        journals = sorted(path for path in folder.iterdir() if _JOURNAL.fullmatch(path.name))
    for journal in journals:
        # Under the lock of the folder: otherwise two runs would each take the other for the owner of the journal.
        with folders_locked([folder]), contextlib.ExitStack() as opened:
            try:
                file = opened.enter_context(os.fdopen(os.open(journal, _OPEN_FLAGS), "rb"))
            except OSError:
                continue
            status = os.fstat(file.fileno())
            is_ours = stat.S_ISREG(status.st_mode) and status.st_uid == _user()
            if not is_ours or not try_lock(file.fileno()):
                continue  # of another user, or of a run in progress
            files, is_committed = _read(journal, file.read(_LARGEST_JOURNAL))
            with folders_locked({each.path.parent for each in files} - {folder}), signals_deferred():
                if not is_committed and (stuck := undo(files)) is not None:
                    raise stuck
                _remove(files, journal)


def _read(journal: Path, text: bytes) -> tuple[list[TemporaryFile], bool]:
    """Return the trusted files of a set, and whether the set is complete or rolled back."""
    files: dict[Path, TemporaryFile] = {}
    name_of_temporary = re.compile(re.escape(journal.stem) + r"\.[0-9]+\.tmp")
    is_committed = False
    # Text after the last line break is an incomplete line.
    for line in text.split(b"\n")[:-1]:
        with contextlib.suppress(ValueError, TypeError):
            value = parse_json(line)
            if value is _COMMITTED:
                is_committed = True
                continue
            name, target, overwrite, put = value
            temporary, identity = journal.parent / name, None if put is None else tuple(put)
            file = TemporaryFile(temporary, temporary.with_name(target), overwrite, identity=identity)
            # A planted journal must not reach files elsewhere: a temporary file must be in their folder.
            is_witnessed = any(map(os.path.lexists, (file.temporary, file.previous)))
            if name_of_temporary.fullmatch(temporary.name) and (is_witnessed or "/" not in name):
                files[temporary] = file
    return list(files.values()), is_committed


def _remove(files: Iterable[TemporaryFile], journal: Path) -> list[OSError]:
    """Remove the temporary files of a run, then its journal; return why some stay, for the next run to remove."""
    failures: list[OSError] = []
    for path in (*(name for file in files for name in (file.temporary, file.previous)), journal):
        try:
            if path != journal or not failures:
                path.unlink(missing_ok=True)
        except OSError as error:
            if os.path.lexists(path):
                failures.append(error)
    return failures
