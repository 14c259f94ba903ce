"""Access to files by name: local paths, or URLs that fsspec opens.

A file at a URL is smoothed on a copy: it is downloaded into a folder of this machine, with the files that it names, and
the results are uploaded.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import uuid
from collections.abc import Iterator
from glob import has_magic
from pathlib import Path, PurePath, PurePosixPath
from typing import Any
from urllib.parse import unquote

from beltrami_cli.errors import InputError, OutputError, install_hint
from beltrami_cli.formats.access import is_file, is_there, is_url, open_regular
from beltrami_cli.surface.temporary_files import temporary_folder

_LOCAL_URL = re.compile(r"(?:file|local)://", re.IGNORECASE)
# Protocols whose files appear only when complete; otherwise files are uploaded under another name and renamed.
_ATOMIC_UPLOADS = frozenset({"s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "adl", "memory"})


def without_scheme(name: str) -> str:
    """Return the path of a file:// URL, and any other name unchanged."""
    found = _LOCAL_URL.match(name)
    return name if found is None else unquote(name[found.end() :])


def require_name(name: object) -> str:
    """Return a valid file name; ValueError if it is not text, or cannot name a file."""
    if not isinstance(name, str) or "\0" in name:
        raise ValueError("it cannot be the name of a file")
    os.fsencode(name)  # a UnicodeError is a ValueError
    return name


def canonical_path(name: str) -> str:
    """Return the canonical name of a file: its resolved path, or its URL."""
    return name if is_url(name) else os.path.realpath(name)


def fixed_part(pattern: PurePath) -> PurePath:
    """Return the innermost folder that contains all files of a glob."""
    fixed = next(number for number, part in enumerate(pattern.parts) if has_magic(part))
    return type(pattern)(*pattern.parts[:fixed])


def joined(folder: str, place: PurePath) -> str:
    """Return the name of a file in a folder; both may be URLs."""
    if is_url(folder):
        return f"{folder.rstrip('/')}/{PurePosixPath(place)}"
    return str(Path(folder) / place)


def filesystem(url: str) -> tuple[Any, str]:
    """Return the fsspec file system of a URL, and the path in it; InputError if the protocol is unknown."""
    try:
        from fsspec.core import url_to_fs
    except ImportError as error:
        cause = "URLs need fsspec, which is not installed"
        raise InputError(url, cause, install_hint("beltrami-cli[cluster]")) from error
    try:
        files, path = url_to_fs(url)
    except (ImportError, ValueError) as error:
        remedy = "install the package that it needs, or check the URL"
        raise InputError(url, f"cannot be opened ({error})", remedy) from error
    return files, path


def exists(name: str) -> bool:
    if not is_url(name):
        return is_there(name)
    files, path = filesystem(name)
    return bool(files.exists(path))


def make_folder_of(name: str) -> None:
    """Make the folder of a new file; OutputError if that fails."""
    try:
        if is_url(name):
            files, path = filesystem(name)
            files.makedirs(path.rpartition("/")[0], exist_ok=True)
        else:
            Path(name).parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        cause = f"its folder cannot be made ({error.strerror or error})"
        raise OutputError(name, cause, "choose another --out-dir") from error


def hash_at(name: str) -> str:
    """Return the SHA-256 of a file in hexadecimal digits; OSError if it cannot be read."""
    if is_url(name):
        files, path = filesystem(name)
        opened = files.open(path, "rb")
    else:
        opened = open_regular(Path(name))
    with opened as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def is_glob(name: str) -> bool:
    """Whether a name is a glob; existing files may have names that look like globs."""
    return has_magic(name) and (is_url(name) or not is_there(name))


def find(name: str) -> tuple[str, list[tuple[str, PurePath]]]:
    """Return the base folder of a folder or a glob (None for a file), and the files with their relative paths."""
    if is_url(name):
        return _find_at(name)
    path = Path(name)
    if is_file(path):
        return "", [(str(path), PurePath(path.name))]
    if not is_glob(name) and not is_there(path):
        raise InputError(name, "there is no such file", "check the path")
    root = Path(fixed_part(path)) if is_glob(name) else path
    paths = root.glob(str(path.relative_to(root))) if is_glob(name) else root.rglob("*")
    return str(root), [(str(each), each.relative_to(root)) for each in sorted(paths) if is_file(each)]


def _find_at(url: str) -> tuple[str, list[tuple[str, PurePath]]]:
    files, path = filesystem(url)
    try:
        if files.isfile(path):
            return "", [(url, PurePosixPath(path.rpartition("/")[2]))]
        root = str(fixed_part(PurePosixPath(path))) if has_magic(path) else path
        names = files.glob(path) if has_magic(path) else files.find(path)
        found = [name for name in sorted(names) if files.isfile(name)]
    except OSError as error:
        raise InputError(url, f"cannot be listed ({error})", "check the URL and your rights") from error
    places = ((name, PurePosixPath(name).relative_to(root or "")) for name in found)
    return files.unstrip_protocol(root), [(files.unstrip_protocol(name), place) for name, place in places]


class Stage:
    """The files of an item, with copies of URLs in `folder`; `read`: SHA-256 of the files read, by name."""

    def __init__(self, source: str, target: str, folder: Path) -> None:
        self._original_source, self._original_target = source, target
        self._from, _, source_name = source.rpartition("/")
        self._to, _, target_name = target.rpartition("/")
        self._inside = folder / "in"
        # Files of one folder stay together, so that files of a model are kept or copied as in a local run.
        self._outside = self._inside if self._from == self._to else folder / "out"
        if is_url(target):
            self._outside.mkdir()
        self.source = str(self._inside / source_name) if is_url(source) else source
        self.target = str(self._outside / target_name) if is_url(target) else target
        self.read: dict[str, str] = {}

    def bring(self, path: Path) -> None:
        """Download a sidecar file of the source, if it exists, to the path where it is expected."""
        if not path.is_relative_to(self._inside) or path.exists():
            return
        files, there = filesystem(self._url_of(path))
        try:
            if files.isfile(there):
                path.parent.mkdir(parents=True, exist_ok=True)
                files.get_file(there, str(path))
        except OSError as error:
            raise InputError(self._original_source, f"cannot be brought ({error})", "try again") from error

    def send(self, names: list[str], *, overwrite: bool, again: bool) -> dict[str, str]:
        """Upload the new files, the model last, and return the hashes by URL; `again`: files may already exist."""
        own = Path(self.target)
        made = [*(self._outside / name for name in names), own]
        urls = {path: f"{self._to}/{path.relative_to(self._outside).as_posix()}" for path in made}
        hashes = {url: hash_at(str(path)) for path, url in urls.items()}
        for url, digest in hashes.items():
            if not overwrite and exists(url) and not (again and hash_at(url) == digest):
                remedy = "choose another --out-dir or --suffix, or --overwrite"
                raise OutputError(url, "exists already", remedy)
        try:
            for path, url in urls.items():
                _upload(path, url)
        except OSError as error:
            raise OutputError(self._original_target, f"cannot be written ({error})", "try again") from error
        return hashes

    def _url_of(self, path: Path) -> str:
        return f"{self._from}/{path.relative_to(self._inside).as_posix()}"

    def note(self, path: Path, data: bytes) -> None:
        """Record the hash of a file that was read."""
        is_copy = is_url(self._original_source) and path.is_relative_to(self._inside)
        name = self._url_of(path) if is_copy else str(path.absolute())
        self.read[name] = hashlib.sha256(data).hexdigest()


@contextlib.contextmanager
def staged(source: str, target: str) -> Iterator[Stage]:
    """Download the source if it is a URL, and remove all copies at the end."""
    with contextlib.ExitStack() as stack:
        folder = Path(os.devnull)
        if is_url(source) or is_url(target):
            folder = stack.enter_context(temporary_folder())
        stage = Stage(source, target, folder.resolve())
        if is_url(source):
            stage.bring(Path(stage.source))
        yield stage


def _upload(path: Path, url: str) -> None:
    files, there = filesystem(url)
    files.makedirs(there.rpartition("/")[0], exist_ok=True)
    schemes = {files.protocol} if isinstance(files.protocol, str) else {*files.protocol}
    if _ATOMIC_UPLOADS & schemes:
        files.put_file(str(path), there)
        return
    folder, _, name = there.rpartition("/")
    temporary = f"{folder}/.{name}.{uuid.uuid4().hex[:12]}.tmp"
    files.put_file(str(path), temporary)
    files.mv(temporary, there)
