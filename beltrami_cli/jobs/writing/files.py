"""All files of one run: OUTPUT, the files beside it, a report, a preview.

They are checked for collisions before anything is computed, written under temporary names beside their places, and put
in place together: all or none. A name that must be free is taken by an operation that fails if it is not, so of two
runs at the same time only one succeeds.
"""

from __future__ import annotations

import contextlib
import dataclasses
import filecmp
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.errors import OutputError
from beltrami_cli.jobs.writing.replacing import (
    Aside,
    endings_held,
    make_folder,
    put_together,
    temporary_beside,
    write_aside,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from beltrami_cli.formats.access import Access
    from beltrami_cli.formats.document import Bytes
    from beltrami_cli.jobs.writing.output import Output


@dataclass(frozen=True)
class _Staged:
    """A file that is written aside, the output that it belongs to, and the name that the user knows it by."""

    aside: Aside
    output: Output
    name: str


class FileSet:
    """The files that one run writes. As a context, it removes in the end what was not put in place.

    `reads` are files that only a result of them may replace: OUTPUT may be INPUT, but a report may not.
    `guarded` are files that nothing may replace, such as guides.
    """

    def __init__(self, reads: Iterable[str] = (), guarded: Iterable[str] = ()) -> None:
        self._outputs: list[Output] = []
        self._reads = {place_of(Path(name)) for name in reads if name != "-"}
        self._guarded = {place_of(Path(name)) for name in guarded}
        self._staged: dict[Path, _Staged] = {}
        self._streams: list[Callable[[], None]] = []
        self._cleaning = contextlib.ExitStack()

    def __enter__(self) -> FileSet:
        return self

    def __exit__(self, *error: object) -> None:
        with endings_held():
            self._cleaning.close()
        self._staged.clear()
        self._streams.clear()

    def add(self, output: Output) -> None:
        """Let an output belong to the set; OutputError if it collides with what is known of the others."""
        self._outputs.append(output)
        self.check()

    def guard(self, names: Iterable[str]) -> None:
        """Let nothing replace these files."""
        self._guarded |= {place_of(Path(name)) for name in names}
        self.check()

    def watching(self, access: Access) -> Access:
        """Return what may be read, such that no output but a result replaces what is read."""

        def note(path: Path, data: bytes) -> None:
            if access.note is not None:
                access.note(path, data)
            self._reads.add(place_of(path))
            self.check()

        return dataclasses.replace(access, note=note)

    def with_staged(self, access: Access) -> Access:
        """Return what may be read, with the files that are written aside as if they were in place."""
        instead = {
            Path(os.path.realpath(path.parent), path.name): staged.aside.temporary
            for path, staged in self._staged.items()
        }
        return dataclasses.replace(access, note=None, instead=instead)

    def check(self) -> None:
        """Raise OutputError if two outputs are one file, or one is a file that it must not replace."""
        taken: dict[str, str] = {}
        for output in sorted(self._outputs, key=lambda each: not each.is_result):
            for name, path in output.paths():
                place = place_of(path)
                if place in taken:
                    raise _collision(output, name, taken[place])
                if place in self._guarded or (place in self._reads and not output.is_result):
                    raise _collision(output, name, "a file that this run reads or writes")
                taken[place] = output.what if name == output.target else f"a file beside {output.what}"

    def stage(self, output: Output, files: Mapping[Path, Iterable[Bytes]], names: Mapping[Path, str]) -> None:
        """Write files of an output aside; OutputError if that fails."""
        with endings_held() as deliver:
            for path, pieces in files.items():
                aside = Aside(temporary_beside(path), path, overwrite=output.overwrite)
                try:
                    make_folder(path.parent, self._cleaning)
                    self._cleaning.callback(aside.temporary.unlink, missing_ok=True)
                    write_aside(aside, pieces, deliver)
                except OSError as error:
                    raise _unwritable(output.target, error) from error
                self._staged[path] = _Staged(aside, output, names[path])

    def stage_stream(self, write: Callable[[], None]) -> None:
        """Keep what goes to standard output or a device, which is written before anything is put in place."""
        self._streams.append(write)

    def keep_equal(self) -> None:
        """Replace nothing: leave files that have the same bytes already; OutputError if one has others."""
        for path, staged in list(self._staged.items()):
            try:
                if path.exists():
                    if not filecmp.cmp(path, staged.aside.temporary, shallow=False):
                        raise _existing(staged.name)
                    staged.aside.temporary.unlink()
                    del self._staged[path]
                    continue
            except OSError as error:
                raise _unwritable(staged.name, error) from error
            aside = dataclasses.replace(staged.aside, overwrite=False)
            self._staged[path] = dataclasses.replace(staged, aside=aside)

    def put_in_place(self) -> None:
        """Give all files their names; OutputError if that fails, and then all is as it was."""
        for write in self._streams:
            write()
        with endings_held():
            staged = sorted(self._staged.values(), key=_rank)
            try:
                put_together([each.aside for each in staged])
            except OSError as error:
                blamed = next((each.name for each in staged if str(each.aside.path) == error.filename), "")
                if isinstance(error, FileExistsError):
                    raise _existing(blamed) from error
                raise _unwritable(blamed or staged[-1].name, error) from error
            self._cleaning.pop_all()
            self._staged.clear()
        self._streams.clear()


def place_of(path: Path) -> str:
    """Return what two names of one place have in common."""
    place = os.path.normcase(os.path.realpath(path.parent) + os.sep + path.name)
    return place.casefold() if sys.platform == "darwin" else place


def _rank(staged: _Staged) -> tuple[bool, bool, str]:
    """Put files that others name before those that name them, and OUTPUT last; otherwise alike in every run."""
    is_main = staged.name == staged.output.target
    return is_main, staged.output.is_result, str(staged.aside.path)


def _collision(output: Output, name: str, other: str) -> OutputError:
    what = f"the {output.what}" if name == output.target and not output.is_result else "it"
    return OutputError(name, f"{what} would replace {other}", "choose another name")


def _existing(name: str) -> OutputError:
    return OutputError(name, "exists already", "choose another name, or --overwrite")


def _unwritable(name: str, error: OSError) -> OutputError:
    return OutputError(name, f"cannot be written ({error.strerror})", "free space or choose another place")
