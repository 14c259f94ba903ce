"""The files that one run writes: checked for collisions, written under temporary names, put in place together."""

from __future__ import annotations

import dataclasses
import os
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.errors import OutputError
from beltrami_cli.formats.files.access import Access
from beltrami_cli.jobs.writing.journal import Journal
from beltrami_cli.jobs.writing.locks import folders_locked
from beltrami_cli.signals import signals_deferred

if TYPE_CHECKING:
    from beltrami_cli.formats.changes import Bytes


@dataclass(frozen=True, eq=False)
class PlannedFile:
    """A file that a run is going to write. Of two at one path the second would replace the first."""

    path: Path
    name: str  # for messages
    what: str  # OUTPUT, report, a sidecar file of OUTPUT, ...
    is_result: bool  # whether it is OUTPUT or a sidecar file, which may replace the files that it was made of
    is_sidecar: bool = False


class FileSet:
    """The files that one run writes; as a context manager it removes what was not moved into place.

    `reads`: inputs, which only the result may replace: OUTPUT may be INPUT, but a report may not.
    """

    def __init__(self, reads: Iterable[str] = ()) -> None:
        self._planned: dict[str, PlannedFile] = {}  # by canonical path
        self._reads = {canonical_path(Path(name)) for name in reads if name != "-"}
        self._guarded: set[str] = set()
        self._journal: Journal | None = None  # from the first staged file until all are in place
        self._staged: dict[Path, PlannedFile] = {}
        self._may_replace: dict[Path, Callable[[], bool]] = {}
        self._streams: list[Callable[[], None]] = []

    def __enter__(self) -> FileSet:
        return self

    def __exit__(self, *error: object) -> None:
        if self._journal is not None:
            self._journal.close()
            self._journal = None
        self._streams.clear()

    def plan(self, file: PlannedFile) -> None:
        """Add a file; OutputError if another one is planned there, or it would replace one that the run reads."""
        place = canonical_path(file.path)
        other = self._planned.setdefault(place, file)
        if other is not file:
            wrong, kept = (other, file) if file.is_result and not other.is_result else (file, other)
            raise _collision(wrong, kept.what)
        self._check(place)

    def guard(self, names: Iterable[str]) -> None:
        """Protect files, such as guides, from being replaced."""
        for name in names:
            self._guarded.add(place := canonical_path(Path(name)))
            self._check(place)

    def watching(self, access: Access) -> Access:
        """Return an access that records files as read, so that only the result may replace them."""

        def note(path: Path, data: bytes) -> None:
            if access.hooks.on_read is not None:
                access.hooks.on_read(path, data)
            self._reads.add(place := canonical_path(path))
            self._check(place)

        return dataclasses.replace(access, hooks=dataclasses.replace(access.hooks, on_read=note))

    def _check(self, place: str) -> None:
        """Raise OutputError if a planned file must not replace the one that is there."""
        file = self._planned.get(place)
        if file is not None and (place in self._guarded or (place in self._reads and not file.is_result)):
            raise _collision(file, "a file that this run reads or writes")

    def with_staged_files(self, access: Access) -> Access:
        """Return an access that reads temporary files as if they were already in place."""
        staged = {} if self._journal is None else self._journal.temporary_files()
        replacements = {
            Path(os.path.realpath(path.parent), path.name): temporary for path, temporary in staged.items()
        }
        hooks = dataclasses.replace(access.hooks, on_read=None, replacements=replacements)
        return dataclasses.replace(access, hooks=hooks)

    def stage(
        self,
        file: PlannedFile,
        pieces: Iterable[Bytes],
        *,
        overwrite: bool,
        may_replace: Callable[[], bool] = lambda: False,
    ) -> None:
        """Write a planned file under a temporary name; OSError if that fails.

        `may_replace` is asked before it is put in place about a file that has appeared there meanwhile.
        """
        from beltrami_cli.surface.large_arrays import release_pages

        if self._journal is None:
            # The next run with the same OUTPUT looks for the journal in its folder.
            folder = self._main().path.parent
            with folders_locked([folder]), signals_deferred():
                self._journal = Journal(folder)
        self._staged[file.path], self._may_replace[file.path] = file, may_replace
        self._journal.stage(file.path, pieces, overwrite=overwrite)
        release_pages()

    def add_stream(self, write: Callable[[], None]) -> None:
        """Have `write` called, to standard output or a device, before files are moved into place."""
        self._streams.append(write)

    def keep_equal(self) -> None:
        """Keep existing files that have the same bytes; OutputError if one differs."""
        self._may_replace.clear()
        try:
            if self._journal is not None:
                self._journal.keep_equal()
        except OSError as error:
            raise self._failure(error) from error

    def commit(self) -> None:
        """Move all files into place; OutputError if that fails, with all files as before."""
        for write in self._streams:
            write()
        try:
            if self._journal is not None:
                self._journal.commit(order=self._order, may_replace=self._replaces)
        except OSError as error:
            raise self._failure(error) from error
        self._journal = None
        self._streams.clear()

    def _order(self, path: Path) -> tuple[bool, bool, str]:
        """Return a key that sorts files before the files that refer to them, so OUTPUT is last."""
        file = self._staged[path]
        return not file.is_sidecar, file.is_result, str(path)

    def _replaces(self, path: Path) -> bool:
        may_replace = self._may_replace.get(path)
        return may_replace is not None and may_replace()

    def _main(self) -> PlannedFile:
        """Return OUTPUT, or else the first file."""
        return min(self._planned.values(), key=lambda file: not file.is_result)

    def _failure(self, error: OSError) -> OutputError:
        name = self._staged.get(Path(error.filename or ""), self._main()).name
        return existing(name) if isinstance(error, FileExistsError) else unwritable(name, error)


def _collision(file: PlannedFile, other: str) -> OutputError:
    what = "it" if file.is_result else f"the {file.what}"
    return OutputError(file.name, f"{what} would replace {other}", "choose another name")


def existing(name: str) -> OutputError:
    return OutputError(name, "exists already", "choose another name, or allow overwriting (--overwrite)")


def unwritable(name: str, error: OSError) -> OutputError:
    return OutputError(name, f"cannot be written ({error.strerror})", "free space or choose another place")


def canonical_path(path: Path) -> str:
    """Return the path that all names of a file share: absolute, without links, in one case."""
    place = os.path.normcase(os.path.realpath(path.parent) + os.sep + path.name)
    return place.casefold() if sys.platform == "darwin" else place
