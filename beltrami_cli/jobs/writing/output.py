"""A result of a run with its sidecar files: OUTPUT, a report, a preview.

They are checked before anything is computed, written under temporary names in the folders of their targets, and put in
place together with the other files of the run: all or none. A name that must be free is taken by an operation that
fails if it is not, so of two simultaneous runs only one succeeds.
"""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Literal

from beltrami_cli.errors import OutputError
from beltrami_cli.formats.files.paths import is_url
from beltrami_cli.jobs.writing.file_set import FileSet, PlannedFile, existing, unwritable
from beltrami_cli.jobs.writing.journal import recover
from beltrami_cli.jobs.writing.sidecars import NO_SIDECARS, SidecarNames
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
    ) -> None:
        if not target:
            raise OutputError(what, "its name is empty", "name a file, or - for standard output")
        if is_url(target):
            raise OutputError(target, "it is a URL, which batch alone writes to", "name a file")
        self.target, self.overwrite = target, bool(overwrite)
        self._is_stdout = target == "-"
        self.is_device = not self._is_stdout and is_special(Path(target))
        # A link is followed, so that its target is replaced and the link stays; links to pipes lead nowhere.
        self.path = Path(target if self.is_device else os.path.realpath(target))
        # None for standard output and devices, which take one file only.
        self.folder = None if self._is_stdout or self.is_device else self.path.parent
        self._main = PlannedFile(self.path, target, what, is_result=what == "OUTPUT")
        self._sidecars: dict[str, PlannedFile] = {}  # by path relative to its folder
        self._is_alone = files is None
        self.files = FileSet(reads) if files is None else files
        if self.folder is not None:
            self.files.plan(self._main)
            self._check_folder(self.folder)
            self._check_file(self.path)
            if overwrite == "own":
                self._require_own(is_own)
        elif self._is_stdout and sys.stdout.isatty() and not is_text:
            cause = "a model is not written to a terminal"
            raise OutputError("<stdout>", cause, "redirect it to a file or pipe")

    def reserve_sidecars(self, names: Iterable[str]) -> None:
        """Add sidecar files, by paths relative to its folder, to the planned files; OutputError if one is refused."""
        for name in names:
            if self.folder is None:
                cause = "there is no folder for its sidecar files"
                remedy = "choose a file as OUTPUT, or --format glb (of OBJ and PLY with --unwrap)"
                raise OutputError("<stdout>" if self._is_stdout else self.target, cause, remedy)
            path = PurePosixPath(name)
            # Readers never return such names; this is a second line of defence.
            if path.is_absolute() or ".." in path.parts:
                raise OutputError(name, "would be written outside the output's folder")
            self._check_file(self.folder / name)
            if name not in self._sidecars:
                self._sidecars[name] = self._sidecar(self.folder / name)
            self.files.plan(self._sidecars[name])

    def _sidecar(self, path: Path) -> PlannedFile:
        what = f"a sidecar file of {self._main.what}"
        return PlannedFile(path, self._named(path), what, self._main.is_result, is_sidecar=True)

    def write(self, written: Written, sidecars: SidecarNames = NO_SIDECARS) -> None:
        """Write all files, under temporary names if it is in a set; on OutputError all files are as before.

        `sidecars` says which existing files its sidecar files may replace, if it may be overwritten.
        """
        if not self._is_alone:
            self._stage(written, sidecars)
            return
        with self.files:
            self._stage(written, sidecars)
            self.files.commit()
        self.overwrite = True  # the existing file is its own

    def _stage(self, written: Written, sidecars: SidecarNames) -> None:
        self.reserve_sidecars(written.sidecars)
        if self.folder is None:
            self.files.add_stream(lambda: self._write_stream(written.main))
            return
        try:
            for name, data in written.sidecars.items():
                self.files.stage(
                    self._sidecars[name], [data],
                    overwrite=self.overwrite and sidecars.replaces(name),
                    may_replace=partial(self._may_replace, name, sidecars),
                )  # fmt: skip
            self.files.stage(self._main, written.main, overwrite=self.overwrite)
        except OSError as error:
            raise unwritable(self.target, error) from error

    def _may_replace(self, name: str, sidecars: SidecarNames) -> bool:
        """Whether another run with the same OUTPUT has written a sidecar file meanwhile, which this run may replace."""
        return self.overwrite and name in sidecars.read()

    def _write_stream(self, pieces: Iterable[Bytes]) -> None:
        try:
            if self._is_stdout:
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
            raise unwritable(self.target, error) from error

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
            raise existing(name)

    def _require_own(self, is_own: Callable[[bytes], bool]) -> None:
        try:
            with self.path.open("rb") as file:
                head = file.read(_SIGNATURE_BYTES)
        except FileNotFoundError:
            return
        except OSError:
            head = b"?"
        if head and not is_own(head):
            cause = f"exists, and is not a {self._main.what} of this program as far as can be seen"
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


def is_special(path: Path) -> bool:
    """Whether a path is neither a file nor a folder, such as a device or a pipe."""
    return os.access(path, os.F_OK) and not (path.is_file() or path.is_dir())
