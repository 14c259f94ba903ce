"""Files that are written under temporary names, and moved to their paths together."""

from __future__ import annotations

import contextlib
import filecmp
import logging
import os
from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.jobs.writing.file_rights import take_over
from beltrami_cli.jobs.writing.journal import Journal
from beltrami_cli.jobs.writing.locks import folders_locked, signals_deferred
from beltrami_cli.jobs.writing.placing import TemporaryFile

if TYPE_CHECKING:
    from beltrami_cli.formats.changes import Bytes

LOG = logging.getLogger(__name__)


class Transaction:
    """Staged files; the `filename` of an OSError is the path that could not be written."""

    def __init__(self) -> None:
        self._staged: dict[Path, TemporaryFile] = {}  # by path
        self._journal: Journal | None = None
        self._made_folders: list[Path] = []  # innermost first

    def stage(self, path: Path, pieces: Iterable[Bytes], *, overwrite: bool, journal_in: Path) -> None:
        """Write a file under a temporary name; the journal is made in a folder together with the first file."""
        if self._journal is None:
            with folders_locked([journal_in]), signals_deferred():
                self._journal = Journal(journal_in)
        missing = takewhile(lambda each: not each.exists(), (path.parent, *path.parent.parents))
        self._made_folders = [*missing, *self._made_folders]
        path.parent.mkdir(parents=True, exist_ok=True)
        self._staged[path] = self._journal.write_aside(path, pieces, overwrite=overwrite)

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
            if self._journal is not None:
                files = [_allowed_to_replace(self._staged[path], may_replace) for path in paths]
                self._journal.rename_all(files)
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

    def _remove_temporary_files(self) -> None:
        # It is not a failure if some stay, since all outputs are complete.
        stay = [] if self._journal is None else self._journal.close()
        self._journal = None
        self._staged.clear()
        for error in stay:
            LOG.warning("the temporary file %s cannot be removed (%s)", error.filename, error.strerror)


def _allowed_to_replace(file: TemporaryFile, may_replace: Callable[[Path], bool]) -> TemporaryFile:
    if file.overwrite or not os.path.lexists(file.path) or not may_replace(file.path):
        return file
    take_over(file.path, file.temporary)
    return replace(file, overwrite=True)
