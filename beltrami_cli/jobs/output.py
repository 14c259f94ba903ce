"""The files of one run: OUTPUT, its sidecar files, a report, a preview.

They are checked for collisions before anything is computed, written under temporary names in the folders of their
targets, and put in place together: all or none. A name that must be free is taken by an operation that fails if it is
not, so of two simultaneous runs only one succeeds.

Other models in the output's folder that refer to a file which is replaced are named in a notice. The heads of their
files are searched for its name, and not parsed, so that a folder of large models takes little time.
"""

from __future__ import annotations

import contextlib
import dataclasses
import filecmp
import logging
import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import takewhile
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Literal
from urllib.parse import quote

from beltrami_cli.errors import OutputError
from beltrami_cli.formats.access import DEFAULT_ACCESS, Access, is_url, read_regular
from beltrami_cli.formats.registry import OUTPUT_FORMATS, READ_ONLY
from beltrami_cli.jobs import replacing
from beltrami_cli.jobs.file_rights import take_over

if TYPE_CHECKING:
    from beltrami_cli.formats.changes import Bytes, Written

LOG = logging.getLogger(__name__)
# "own": only files with the signature of this program.
Overwrite = bool | Literal["own"]
_SIGNATURE_BYTES = 1 << 16  # bytes searched for the signature


class Output:
    """The destination of a result, a report or a picture: `target` is a path, or "-" for standard output.

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
        self.target, self.overwrite, self.what = target, bool(overwrite), what
        self.is_result = what == "OUTPUT"
        self.is_stdout = target == "-"
        if not target:
            raise OutputError(what, "its name is empty", "name a file, or - for standard output")
        if is_url(target):
            raise OutputError(target, "it is a URL, which batch alone writes to", "name a file")
        self.is_device = not self.is_stdout and replacing.is_special(Path(target))
        # A link is followed, so that its target is replaced and the link stays; links to pipes lead nowhere.
        self.path = Path(target if self.is_device else os.path.realpath(target))
        # None for standard output and devices, which take one file only.
        self.folder = None if self.is_stdout or self.is_device else self.path.parent
        self._sidecars: tuple[str, ...] = ()
        self.replaceable: frozenset[str] = frozenset()  # sidecar files of the existing OUTPUT
        # Reads the names of the sidecar files of the existing OUTPUT.
        self.references: Callable[[], frozenset[str]] = frozenset
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
            self.files.streams.append(lambda: self._write_stream(written.main))
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
            with replacing.signals_deferred(), tempfile.TemporaryFile(dir=folder):
                pass  # it is writable
            replacing.recover(folder)
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
    """The files that one run writes; as a context manager it removes those that were not moved into place."""

    # `reads`: inputs, which only the result may replace: OUTPUT may be INPUT, but a report may not.

    def __init__(self, reads: Iterable[str] = ()) -> None:
        self._outputs: list[Output] = []
        self._reads = {replacing.canonical_path(Path(name)) for name in reads if name != "-"}
        self._guarded: set[str] = set()
        self._staged: dict[Path, replacing.TemporaryFile] = {}
        self._names: dict[Path, str] = {}  # for messages
        self._replacing: dict[Path, Output] = {}  # outputs that replace files, by path
        # Writes to standard output and devices, before files are moved into place.
        self.streams: list[Callable[[], None]] = []
        self._journal: replacing.Journal | None = None
        self._made_folders: list[Path] = []  # innermost first

    def __enter__(self) -> FileSet:
        return self

    def __exit__(self, *error: object) -> None:
        with replacing.signals_deferred():
            self._remove_temporary()
            for folder in self._made_folders:
                with contextlib.suppress(OSError):  # it may contain other files by now
                    folder.rmdir()
            self._made_folders.clear()
        self.streams.clear()

    def _remove_temporary(self) -> None:
        """Remove the temporary files; it is not a failure if some stay, since all outputs are complete."""
        stay = [] if self._journal is None else self._journal.close()
        self._journal = None
        self._staged.clear()
        for error in stay:
            LOG.warning("the temporary file %s cannot be removed (%s)", error.filename, error.strerror)

    def add(self, output: Output) -> None:
        """Add an output to the set; OutputError if it collides with another one."""
        self._outputs.append(output)
        self.check()

    def guard(self, names: Iterable[str]) -> None:
        """Protect files, such as guides, from being replaced."""
        self._guarded |= {replacing.canonical_path(Path(name)) for name in names}
        self.check()

    def watching(self, access: Access) -> Access:
        """Return an access that records files as read, so that only the result may replace them."""

        def note(path: Path, data: bytes) -> None:
            if access.note is not None:
                access.note(path, data)
            self._reads.add(replacing.canonical_path(path))
            self.check()

        return dataclasses.replace(access, note=note)

    def with_staged_files(self, access: Access) -> Access:
        """Return an access that reads temporary files as if they were already in place."""
        instead = {
            Path(os.path.realpath(path.parent), path.name): staged.temporary
            for path, staged in self._staged.items()
        }
        return dataclasses.replace(access, note=None, instead=instead)

    def check(self) -> None:
        """Raise OutputError if two outputs are the same file, or one is a file that must not be replaced."""
        taken: dict[str, str] = {}
        for output in sorted(self._outputs, key=lambda each: not each.is_result):
            for name, path in output.paths():
                place = replacing.canonical_path(path)
                if place in taken:
                    raise _collision(output, name, taken[place])
                if place in self._guarded or (place in self._reads and not output.is_result):
                    raise _collision(output, name, "a file that this run reads or writes")
                taken[place] = output.what if name == output.target else f"a sidecar file of {output.what}"

    def stage(self, output: Output, files: Mapping[Path, Iterable[Bytes]]) -> None:
        from beltrami_cli.surface.large_arrays import release_pages

        output_paths = {output.path, *(output.path.parent / name for name in output.replaceable)}
        # The journal is where the next run with the same OUTPUT looks first.
        main = min(
            (each for each in self._outputs if each.folder is not None), key=lambda each: not each.is_result
        )
        self._names |= {path: name for name, path in output.paths()}
        for path, pieces in files.items():
            may_replace = output.overwrite and path in output_paths
            try:
                if self._journal is None:
                    with replacing.folders_locked([main.path.parent]), replacing.signals_deferred():
                        self._journal = replacing.Journal(main.path.parent)
                self._make_folder(path.parent)
                self._staged[path] = self._journal.write_aside(path, pieces, overwrite=may_replace)
                if output.overwrite:
                    self._replacing[path] = output
            except OSError as error:
                raise _unwritable(output.target, error) from error
            release_pages()

    def _make_folder(self, folder: Path) -> None:
        missing = takewhile(lambda each: not each.exists(), (folder, *folder.parents))
        self._made_folders = [*missing, *self._made_folders]
        folder.mkdir(parents=True, exist_ok=True)

    def keep_equal(self) -> None:
        """Keep existing files that have the same bytes; OutputError if one differs."""
        self._replacing.clear()
        for path, staged in list(self._staged.items()):
            try:
                if path.exists():
                    if not filecmp.cmp(path, staged.temporary, shallow=False):
                        raise _existing(self._names[path])
                    del self._staged[path]
                    continue
            except OSError as error:
                raise _unwritable(self._names[path], error) from error
            self._staged[path] = dataclasses.replace(staged, overwrite=False)

    def commit(self) -> None:
        """Move all files into place; OutputError if that fails, with all files as before."""
        for write in self.streams:
            write()
        # Files come before the files that refer to them, so OUTPUT is last.
        ranks = {output.path: output.is_result for output in self._outputs}
        order = sorted(self._staged, key=lambda path: (path in ranks, ranks.get(path, False), str(path)))
        try:
            with replacing.folders_locked(path.parent for path in order), replacing.signals_deferred():
                if self._journal is not None:
                    self._journal.rename_all([self._replacing_newer(self._staged[path]) for path in order])
                self._made_folders.clear()
                self._remove_temporary()
        except OSError as error:
            blamed = next((path for path in order if str(path) == error.filename), order[-1])
            if isinstance(error, FileExistsError):
                raise _existing(self._names[blamed]) from error
            raise _unwritable(self._names[blamed], error) from error
        self.streams.clear()

    def _replacing_newer(self, file: replacing.TemporaryFile) -> replacing.TemporaryFile:
        """Allow a file to replace one that another run with the same OUTPUT has written meanwhile."""
        output = self._replacing.get(file.path)
        if file.overwrite or output is None or not os.path.lexists(file.path):
            return file
        if file.path not in {output.path.parent / name for name in output.references()}:
            return file
        take_over(file.path, file.temporary)
        return dataclasses.replace(file, overwrite=True)


def _collision(output: Output, name: str, other: str) -> OutputError:
    what = f"the {output.what}" if name == output.target and not output.is_result else "it"
    return OutputError(name, f"{what} would replace {other}", "choose another name")


def _existing(name: str) -> OutputError:
    return OutputError(name, "exists already", "choose another name, or --overwrite")


def _unwritable(name: str, error: OSError) -> OutputError:
    return OutputError(name, f"cannot be written ({error.strerror})", "free space or choose another place")


# Number of files of a folder that are searched.
_MAX_FILES = 1000
# Bytes of each file. OBJ and PLY list their files before the vertices; materials and the JSON of glTF are short,
# unless buffers are written into them.
_HEAD = 1 << 18


def shared_files(folder: Path, target: Path, names: Iterable[str]) -> list[str]:
    """Return a notice if models in a folder, other than the target, refer to existing files of these names."""
    replaced, heads = [name for name in names if os.path.lexists(folder / name)], dict[str, bytes]()
    if not replaced:
        return []
    files = list[str]()
    with contextlib.suppress(OSError), os.scandir(folder) as entries:  # some folders must not be listed
        files = sorted(entry.name for entry in entries if _may_refer(entry.name))
    for name in files[:_MAX_FILES]:
        with contextlib.suppress(OSError):
            heads[name] = read_regular(folder / name, DEFAULT_ACCESS, _HEAD)
    others = {target.name, *replaced}
    libraries = [name for name in _naming(heads, replaced) if name.endswith(".mtl") and name not in others]
    users = [name for name in _naming(heads, [*replaced, *libraries]) if name not in {*others, *libraries}]
    what = f"replaced {', '.join(replaced)}, which other models in the folder show, too"
    return [f"{what}: {', '.join(users)}."] if users else []


def _may_refer(name: str) -> bool:
    suffix = Path(name).suffix.lower().removeprefix(".")
    return suffix in (*OUTPUT_FORMATS, "mtl", *READ_ONLY)


def _naming(heads: Mapping[str, bytes], names: Iterable[str]) -> list[str]:
    """Return the files that contain one of some names as a whole word; in URIs they may be percent-encoded."""
    spelled = sorted({os.fsencode(each) for name in names for each in (name, quote(name))})
    named = re.compile(rb"(?:^|[\s\"'@>]|\./)(?:" + b"|".join(map(re.escape, spelled)) + rb")(?=$|[\s\"'@<])")
    # The expression alone takes 10 ms for the head of a binary file.
    holding = {name: head for name, head in heads.items() if any(each in head for each in spelled)}
    return [name for name, head in holding.items() if named.search(head)]
