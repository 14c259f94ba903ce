"""The files of one run: OUTPUT, its sidecar files, a report, a preview.

They are checked for collisions before anything is computed, written under temporary names in the folders of their
targets, and put in place together: all or none. A name that must be free is taken by an operation that fails if it is
not, so of two simultaneous runs only one succeeds.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Literal

from beltrami_cli.errors import OutputError
from beltrami_cli.formats.files.access import Access
from beltrami_cli.formats.files.paths import is_url
from beltrami_cli.jobs.writing.journal import Journal, recover
from beltrami_cli.jobs.writing.locks import folders_locked
from beltrami_cli.signals import signals_deferred

if TYPE_CHECKING:
    from beltrami_cli.formats.changes import Bytes, Written

# "own": only files with the signature of this program.
Overwrite = bool | Literal["own"]
_SIGNATURE_BYTES = 1 << 16  # bytes searched for the signature


class Output:
    """The destination of a result, a report or an image: `target` is a path, or "-" for standard output.

    `what` it is, for messages: OUTPUT may replace the file that it was made of, all else replaces nothing that is read.
    `is_own` recognises what this program wrote by its first bytes, for `overwrite="own"`.
    `files` is the set that it belongs to, whose owner puts it in place; without one, `write` does so at once.
    `references` reads the names of the sidecar files of the existing OUTPUT, which may be replaced.
    OutputError if it exists and must not be replaced, or its folder cannot be written to.
    """

    def __init__(
        self,
        target: str,
        *,
        overwrite: Overwrite,
        is_text: bool = False,
        what: str = "OUTPUT",
        is_own: Callable[[bytes], bool] = lambda head: False,
        files: FileSet | None = None,
        reads: Iterable[str] = (),
        references: Callable[[], frozenset[str]] = frozenset,
    ) -> None:
        self.target, self.overwrite, self.what = target, bool(overwrite), what
        self.is_result = what == "OUTPUT"
        self.is_stdout = target == "-"
        if not target:
            raise OutputError(what, "its name is empty", "name a file, or - for standard output")
        if is_url(target):
            raise OutputError(target, "it is a URL, which batch alone writes to", "name a file")
        self.is_device = not self.is_stdout and is_special(Path(target))
        # A link is followed, so that its target is replaced and the link stays; links to pipes lead nowhere.
        self.path = Path(target if self.is_device else os.path.realpath(target))
        # None for standard output and devices, which take one file only.
        self.folder = None if self.is_stdout or self.is_device else self.path.parent
        self._sidecars: tuple[str, ...] = ()
        self.references = references
        # The names of its sidecar files that may be replaced: of INPUT, or by `references` once they are needed.
        self.replaceable = frozenset[str]()
        self.occupied = dict[str, None]()  # names that `is_taken` found to belong to other models
        self._is_alone = files is None
        self.files = FileSet(reads) if files is None else files
        self.files.add(self)
        if self.is_stdout:
            if sys.stdout.isatty() and not is_text:
                cause = "a model is not written to a terminal"
                raise OutputError("<stdout>", cause, "redirect it to a file or pipe")
        elif self.folder is not None:
            self._check_folder(self.folder)
            self._check_file(self.path)
            if overwrite == "own":
                self._require_own(is_own)

    def paths(self) -> Iterator[tuple[str, Path]]:
        """Yield the files that will be written as far as they are known, with their names for messages."""
        if self.folder is not None:
            yield self.target, self.path
            yield from ((self._named(self.folder / name), self.folder / name) for name in self._sidecars)

    def is_taken(self, name: str) -> bool:
        """Whether its folder has a file of that name which is not a sidecar file of the existing OUTPUT.

        Such names are collected in `occupied`.
        """
        if self.folder is None or not os.path.lexists(self.folder / name):
            return False
        self.replaceable = self.replaceable or self.references()
        if name in self.replaceable:
            return False
        self.occupied[name] = None
        return True

    def check_sidecars(self, names: Iterable[str]) -> None:
        """Check that sidecar files, by paths relative to the output's folder, may be written; OutputError if not."""
        names = self._sidecars = tuple(names)
        for name in names:
            if self.folder is None:
                cause = "there is no folder for its sidecar files"
                remedy = "choose a file as OUTPUT, or --format glb (of OBJ and PLY with --unwrap)"
                raise OutputError("<stdout>" if self.is_stdout else self.target, cause, remedy)
            path = PurePosixPath(name)
            # Readers never return such names; this is a second line of defence.
            if path.is_absolute() or ".." in path.parts:
                raise OutputError(name, "would be written outside the output's folder")
            self._check_file(self.folder / name)
        self.files.check()

    def may_replace(self, path: Path) -> bool:
        return self.overwrite and path in {self.path, *(self.path.parent / name for name in self.replaceable)}

    def write(self, written: Written) -> None:
        """Write all files, under temporary names if it is in a set; on OutputError all files are as before."""
        if not self._is_alone:
            self._stage(written)
            return
        with self.files:
            self._stage(written)
            self.files.commit()
        self.overwrite = True  # the existing file is its own

    def _stage(self, written: Written) -> None:
        self.check_sidecars(written.sidecars)
        if self.folder is None:
            self.files.add_stream(lambda: self._write_stream(written.main))
            return
        files = {self.folder / name: [data] for name, data in written.sidecars.items()}
        self.files.stage(self, {**files, self.path: written.main})

    def _write_stream(self, pieces: Iterable[Bytes]) -> None:
        try:
            if self.is_stdout:
                for piece in pieces:
                    sys.stdout.buffer.write(piece)
                sys.stdout.buffer.flush()
            else:
                with self.path.open("wb") as file:
                    file.writelines(pieces)
        except OSError as error:
            if isinstance(error, BrokenPipeError):
                # The interpreter must not try to flush the rest of the buffer when it exits.
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise _unwritable(self.target, error) from error

    def _check_file(self, path: Path) -> None:
        name = self._named(path)
        try:
            is_folder, exists = path.is_dir(), path.exists()
        except OSError as error:
            cause = f"no file can be called so ({error.strerror})"
            raise OutputError(name, cause, "choose another name") from error
        if is_folder:
            raise OutputError(name, "is a folder", "name a file")
        if exists and not self.overwrite:
            raise _existing(name)

    def _require_own(self, is_own: Callable[[bytes], bool]) -> None:
        try:
            with self.path.open("rb") as file:
                head = file.read(_SIGNATURE_BYTES)
        except FileNotFoundError:
            return
        except OSError:
            head = b"?"
        if head and not is_own(head):
            cause = f"exists, and is not a {self.what} of this program as far as can be seen"
            remedy = "choose another name, or remove it"
            raise OutputError(self.target, cause, remedy)

    def _check_folder(self, folder: Path) -> None:
        name = self._named(folder)
        try:
            if not folder.exists():
                raise OutputError(self.target, f"the folder {name} does not exist", "make it first")
            if not folder.is_dir():
                raise OutputError(self.target, f"{name} is not a folder", "choose another place")
            with signals_deferred(), tempfile.TemporaryFile(dir=folder):
                pass  # it is writable
            recover(folder)
        except OSError as error:
            cause = f"the folder {name} cannot be written to ({error.strerror})"
            raise OutputError(self.target, cause, "choose another folder") from error

    def _named(self, path: Path) -> str:
        """Return the name of an output file for messages; of a link, the path of its target."""
        target = Path(self.target)
        with contextlib.suppress(OSError):  # such as names that are too long
            if target.is_symlink():
                return str(path)
        return str(target.parent / path.relative_to(self.path.parent))


class FileSet:
    """The files that one run writes; as a context manager it removes those that were not moved into place.

    `reads`: inputs, which only the result may replace: OUTPUT may be INPUT, but a report may not.
    """

    def __init__(self, reads: Iterable[str] = ()) -> None:
        self._outputs: list[Output] = []
        self._reads = {canonical_path(Path(name)) for name in reads if name != "-"}
        self._guarded: set[str] = set()
        self._journal: Journal | None = None  # from the first staged file until all are in place
        self._names: dict[Path, str] = {}  # for messages
        self._overwriting: dict[Path, Output] = {}  # outputs that may replace files, by the paths of these
        self._streams: list[Callable[[], None]] = []

    def __enter__(self) -> FileSet:
        return self

    def __exit__(self, *error: object) -> None:
        if self._journal is not None:
            self._journal.close()
            self._journal = None
        self._streams.clear()

    def add(self, output: Output) -> None:
        """Add an output to the set; OutputError if it collides with another one."""
        self._outputs.append(output)
        self.check()

    def guard(self, names: Iterable[str]) -> None:
        """Protect files, such as guides, from being replaced."""
        self._guarded |= {canonical_path(Path(name)) for name in names}
        self.check()

    def watching(self, access: Access) -> Access:
        """Return an access that records files as read, so that only the result may replace them."""

        def note(path: Path, data: bytes) -> None:
            if access.hooks.on_read is not None:
                access.hooks.on_read(path, data)
            self._reads.add(canonical_path(path))
            self.check()

        return dataclasses.replace(access, hooks=dataclasses.replace(access.hooks, on_read=note))

    def with_staged_files(self, access: Access) -> Access:
        """Return an access that reads temporary files as if they were already in place."""
        staged = {} if self._journal is None else self._journal.temporary_files()
        replacements = {
            Path(os.path.realpath(path.parent), path.name): temporary for path, temporary in staged.items()
        }
        hooks = dataclasses.replace(access.hooks, on_read=None, replacements=replacements)
        return dataclasses.replace(access, hooks=hooks)

    def check(self) -> None:
        """Raise OutputError if two outputs are the same file, or one is a file that must not be replaced."""
        taken: dict[str, str] = {}
        for output in sorted(self._outputs, key=lambda each: not each.is_result):
            for name, path in output.paths():
                place = canonical_path(path)
                if place in taken:
                    raise _collision(output, name, taken[place])
                if place in self._guarded or (place in self._reads and not output.is_result):
                    raise _collision(output, name, "a file that this run reads or writes")
                taken[place] = output.what if name == output.target else f"a sidecar file of {output.what}"

    def stage(self, output: Output, files: Mapping[Path, Iterable[Bytes]]) -> None:
        """Write files of an output under temporary names."""
        from beltrami_cli.surface.large_arrays import release_pages

        # The next run with the same OUTPUT looks for the journal in its folder.
        folder = self._main().path.parent
        self._names |= {path: name for name, path in output.paths()}
        for path, pieces in files.items():
            if output.overwrite:
                self._overwriting[path] = output
            try:
                if self._journal is None:
                    with folders_locked([folder]), signals_deferred():
                        self._journal = Journal(folder)
                self._journal.stage(path, pieces, overwrite=output.may_replace(path))
            except OSError as error:
                raise _unwritable(output.target, error) from error
            release_pages()

    def add_stream(self, write: Callable[[], None]) -> None:
        """Have `write` called, to standard output or a device, before files are moved into place."""
        self._streams.append(write)

    def keep_equal(self) -> None:
        """Keep existing files that have the same bytes; OutputError if one differs."""
        self._overwriting.clear()
        try:
            if self._journal is not None:
                self._journal.keep_equal()
        except OSError as error:
            raise self._failure(error) from error

    def commit(self) -> None:
        """Move all files into place; OutputError if that fails, with all files as before."""
        for write in self._streams:
            write()
        # Files come before the files that refer to them, so OUTPUT is last.
        is_result = {output.path: output.is_result for output in self._outputs}
        try:
            if self._journal is not None:
                self._journal.commit(
                    order=lambda path: (path in is_result, is_result.get(path, False), str(path)),
                    may_replace=self._is_of_newer_output,
                )
        except OSError as error:
            raise self._failure(error) from error
        self._journal = None
        self._streams.clear()

    def _is_of_newer_output(self, path: Path) -> bool:
        """Whether another run with the same OUTPUT has written a file meanwhile, which this run may replace."""
        output = self._overwriting.get(path)
        return output is not None and path in {output.path.parent / name for name in output.references()}

    def _main(self) -> Output:
        """Return OUTPUT, or else the first output that is a file."""
        return min(
            (each for each in self._outputs if each.folder is not None), key=lambda each: not each.is_result
        )

    def _failure(self, error: OSError) -> OutputError:
        name = self._names.get(Path(error.filename or ""), self._main().target)
        return _existing(name) if isinstance(error, FileExistsError) else _unwritable(name, error)


def _collision(output: Output, name: str, other: str) -> OutputError:
    what = f"the {output.what}" if name == output.target and not output.is_result else "it"
    return OutputError(name, f"{what} would replace {other}", "choose another name")


def _existing(name: str) -> OutputError:
    return OutputError(name, "exists already", "choose another name, or allow overwriting (--overwrite)")


def _unwritable(name: str, error: OSError) -> OutputError:
    return OutputError(name, f"cannot be written ({error.strerror})", "free space or choose another place")


def canonical_path(path: Path) -> str:
    """Return the path that all names of a file share: absolute, without links, in one case."""
    place = os.path.normcase(os.path.realpath(path.parent) + os.sep + path.name)
    return place.casefold() if sys.platform == "darwin" else place


def is_special(path: Path) -> bool:
    """Whether a path is neither a file nor a folder, such as a device or a pipe."""
    return os.access(path, os.F_OK) and not (path.is_file() or path.is_dir())
