"""Copies of files at URLs.

A file at a URL is smoothed on a copy: it is downloaded into a folder of this machine, with the files that it names, and
the results are uploaded.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import uuid
from collections.abc import Iterator
from pathlib import Path

from beltrami_cli.batch.storage import exists, filesystem, hash_at
from beltrami_cli.errors import InputError, OutputError
from beltrami_cli.formats.files.paths import is_url
from beltrami_cli.surface.temporary_files import temporary_folder

# Protocols whose files appear only when complete; otherwise files are uploaded under another name and renamed.
_ATOMIC_UPLOADS = frozenset({"s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "adl", "memory"})


class Stage:
    """The files of an item, with copies of URLs in `folder`; `read`: SHA-256 of the files read, by name."""

    def __init__(self, source: str, target: str, folder: Path) -> None:
        self._source, self._target = source, target
        self._from, _, source_name = source.rpartition("/")
        self._to, _, target_name = target.rpartition("/")
        self._inputs = folder / "in"
        # Files of one folder stay together, so that files of a model are kept or copied as in a local run.
        self._outputs = self._inputs if self._from == self._to else folder / "out"
        if is_url(target):
            self._outputs.mkdir()
        self.source = str(self._inputs / source_name) if is_url(source) else source
        self.target = str(self._outputs / target_name) if is_url(target) else target
        self.read: dict[str, str] = {}

    def download(self, path: Path) -> None:
        """Download a sidecar file of the source, if it exists, to the path where it is expected."""
        if not path.is_relative_to(self._inputs) or path.exists():
            return
        files, there = filesystem(self._url_of(path))
        try:
            if files.isfile(there):
                path.parent.mkdir(parents=True, exist_ok=True)
                files.get_file(there, str(path))
        except OSError as error:
            raise InputError(self._source, f"cannot be downloaded ({error})", "try again") from error

    def upload(self, names: list[str], *, overwrite: bool, is_retry: bool) -> dict[str, str]:
        """Upload the new files, the model last, and return their hashes by URL; `is_retry`: equal ones may exist."""
        paths = [*(self._outputs / name for name in names), Path(self.target)]
        urls = {path: f"{self._to}/{path.relative_to(self._outputs).as_posix()}" for path in paths}
        hashes = {url: hash_at(str(path)) for path, url in urls.items()}
        for url, digest in hashes.items():
            if not overwrite and exists(url) and not (is_retry and hash_at(url) == digest):
                remedy = "choose another --out-dir or --suffix, or --overwrite"
                raise OutputError(url, "exists already", remedy)
        try:
            for path, url in urls.items():
                _upload(path, url)
        except OSError as error:
            raise OutputError(self._target, f"cannot be written ({error})", "try again") from error
        return hashes

    def _url_of(self, path: Path) -> str:
        return f"{self._from}/{path.relative_to(self._inputs).as_posix()}"

    def note(self, path: Path, data: bytes) -> None:
        """Record the hash of a file that was read."""
        is_copy = is_url(self._source) and path.is_relative_to(self._inputs)
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
            stage.download(Path(stage.source))
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
