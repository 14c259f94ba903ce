"""Smoothing of files at URLs: brought into a folder of this machine, with what they name beside them, and sent back."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import tempfile
import uuid
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beltrami_cli.batch.storage import exists, filesystem, is_url
from beltrami_cli.errors import BeltramiError, InputError, OutputError
from beltrami_cli.formats.access import Access

if TYPE_CHECKING:
    from collections.abc import Iterator

    from beltrami_cli.batch.job import Job

# Where a file is there when it is whole, and not before; elsewhere it is renamed in the end.
_WHOLE_OR_NOT = frozenset({"s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "adl", "memory"})


class Stage:
    """Copies of a job's files.

    Parameters
    ----------
    job : Job
        With a URL as source, as target or both.
    folder : Path
        Empty, for the copies.

    Attributes
    ----------
    job : Job
        The same job on the copies.
    read : dict of str to str
        SHA-256 of what was read, by URL or path.
    """

    def __init__(self, job: Job, folder: Path) -> None:
        self._from, _, source = job.source.rpartition("/")
        self._to, _, target = job.target.rpartition("/")
        self._original, self._inside = job, folder / "in"
        # What lies in one folder stays in one, so that files beside a model are left alone or copied as they would be.
        self._outside = self._inside if self._from == self._to else folder / "out"
        for each in (self._inside, self._outside):
            each.mkdir(exist_ok=True)
        self.read: dict[str, str] = {}
        self.job = dataclasses.replace(
            job,
            source=str(self._inside / source) if is_url(job.source) else job.source,
            target=str(self._outside / target) if is_url(job.target) else job.target,
            overwrite=job.overwrite or is_url(job.target),
        )

    def access(self, memory: int | None) -> Access:
        """Return what the job may read: what it names is brought as soon as it is looked for."""
        bring = self.bring if is_url(self._original.source) else None
        return Access(self._original.outside, memory, self._note, bring)

    def bring(self, path: Path) -> None:
        """Copy a file to where it is looked for, if there is one at the source's place."""
        if not path.is_relative_to(self._inside) or path.exists():
            return
        files, there = filesystem(f"{self._from}/{path.relative_to(self._inside).as_posix()}")
        try:
            if files.isfile(there):
                path.parent.mkdir(parents=True, exist_ok=True)
                files.get_file(there, str(path))
        except OSError as error:
            raise InputError(self._original.source, f"cannot be brought ({error})", "try again") from error

    def send(self, names: list[str]) -> dict[str, str]:
        """Write what was made, the model last, to the place of the target; return the hashes by URL.

        Raises
        ------
        OutputError
            If a file is there that must not be replaced, or that fails.
        """
        own = Path(self.job.target)
        made = [*(self._outside / name for name in names), own]
        urls = {path: f"{self._to}/{path.relative_to(self._outside).as_posix()}" for path in made}
        for url in urls.values():
            if not self._original.overwrite and exists(url):
                raise OutputError(
                    url, "exists already", "choose another --out-dir or --suffix, or --overwrite"
                )
        try:
            for path, url in urls.items():
                _put(path, url)
        except OSError as error:
            raise OutputError(self._original.target, f"cannot be written ({error})", "try again") from error
        return {url: hashlib.sha256(path.read_bytes()).hexdigest() for path, url in urls.items()}

    def in_words(self, error: BeltramiError) -> str:
        """Return an error's message with the names that the user knows."""
        return (
            str(error)
            .replace(self.job.source, self._original.source)
            .replace(self.job.target, self._original.target)
        )

    def _note(self, path: Path, data: bytes) -> None:
        name = str(path.absolute())
        if path.is_relative_to(self._inside) and is_url(self._original.source):
            name = f"{self._from}/{path.relative_to(self._inside).as_posix()}"
        self.read[name] = hashlib.sha256(data).hexdigest()


@contextlib.contextmanager
def staged(job: Job) -> Iterator[Stage]:
    """Bring a job's source to this machine, and remove the copies in the end."""
    with tempfile.TemporaryDirectory(prefix="beltrami-") as name:
        stage = Stage(job, Path(name).resolve())
        if is_url(job.source):
            stage.bring(Path(stage.job.source))
        yield stage


def _put(path: Path, url: str) -> None:
    files, there = filesystem(url)
    files.makedirs(there.rpartition("/")[0], exist_ok=True)
    schemes: Any = files.protocol
    if _WHOLE_OR_NOT & {schemes, *schemes} if isinstance(schemes, str) else _WHOLE_OR_NOT & {*schemes}:
        files.put_file(str(path), there)
        return
    folder, _, name = there.rpartition("/")
    beside = f"{folder}/.{name}.{uuid.uuid4().hex[:12]}.tmp"
    files.put_file(str(path), beside)
    files.mv(beside, there)
