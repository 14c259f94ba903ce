"""One file of a batch: the task, its execution, and the outcome."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import time
import traceback
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from beltrami_cli.batch.storage import hash_at, is_url, staged
from beltrami_cli.errors import BeltramiError, InputError
from beltrami_cli.formats.access import Access
from beltrami_cli.jobs.job import Job, Progress, limited_memory
from beltrami_cli.jobs.output import FileSet
from beltrami_cli.jobs.settings import BakeSettings, NoiseSettings

if TYPE_CHECKING:
    from beltrami_cli.jobs.file_job import FileReport
    from beltrami_cli.layers.settings import SmoothSettings

Status = Literal["started", "done", "skipped", "failed", "not started"]


@dataclass(frozen=True)
class Item:
    """A file to be smoothed; it can be sent to another process."""

    source: str
    target: str
    settings: SmoothSettings
    unwrap: BakeSettings | None = None
    noise: NoiseSettings | None = None  # that is added to the colours, which are not smoothed then
    outside: bool = False  # whether files are followed that the model names beyond its own folder
    overwrite: bool = False
    columns: tuple[str, ...] = ()  # names of the columns of points in text files
    # Whether an attempt that was cut off may have written files; existing ones must then be equal.
    again: bool = False

    @property
    def parameters(self) -> str:
        """Hash of all that the result depends on besides the files: the settings and the version of this program."""
        settings = dataclasses.asdict(self.settings)
        del settings["kernel"]["threads"]  # the result is the same for any number
        unwrap = None if self.unwrap is None else dataclasses.asdict(self.unwrap)
        everything = [version("beltrami-cli"), settings, unwrap, self.outside]
        if self.noise is not None:
            everything.append(dataclasses.asdict(self.noise))
        if self.columns:
            everything.append({"columns": self.columns})
        return hashlib.sha256(json.dumps(everything, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True)
class Outcome:
    """What came of one file; as JSON it is a line of the record."""

    input: str
    output: str
    status: Status  # "skipped": what an earlier run did still holds
    parameters_sha256: str = ""
    time: float = field(default_factory=time.time)  # when this was written, in seconds since 1970
    seconds: float = 0.0
    error: str = ""
    exit_code: int = 0  # that of `beltrami smooth` for the same file
    read: dict[str, str] = field(default_factory=dict)  # SHA-256 of every file that was read, by its name
    written: dict[str, str] = field(default_factory=dict)
    report: dict[str, object] | None = None  # of `beltrami smooth`, or of what `beltrami noise` added


@dataclass(frozen=True)
class Attempt:
    """What a worker answers: the outcome, whether more memory might help, and where an unforeseen error arose."""

    outcome: Outcome
    wants_memory: bool = False
    traceback: str = ""


def outcome_of(item: Item, status: Status, **values: Any) -> Outcome:
    """Return an outcome with the names and parameters of an item."""
    return Outcome(item.source, item.target, status, parameters_sha256=item.parameters, **values)


def failed(item: Item, error: str, exit_code: int, seconds: float = 0.0) -> Outcome:
    """Return the outcome of an item that failed."""
    return outcome_of(item, "failed", seconds=round(seconds, 3), error=error, exit_code=exit_code)


def do_item(
    item: Item, memory: int | None, progress: Progress | None = None, *, is_alone: bool = True
) -> Attempt:
    """Smooth one file; a failure is returned, not raised. Only if the process `is_alone` can its memory be limited."""
    start = time.monotonic()
    try:
        with limited_memory(memory if is_alone else None, item.source):
            done = _done(item, memory, progress)
        return Attempt(dataclasses.replace(done, seconds=round(time.monotonic() - start, 3)))
    except BeltramiError as error:
        # Whatever refuses a file for want of memory names the option as the way out.
        wants_memory = isinstance(error, InputError) and "--max-memory" in error.remedy
        message = str(error)
        if item.source not in message and item.target not in message:
            message = f"{item.source}: {message}"
        outcome = failed(item, message, error.exit_code, time.monotonic() - start)
        return Attempt(outcome, wants_memory)
    except Exception as error:  # even a mistake of ours is of this file only
        cause = " ".join(f"{item.source}: unexpected error: {type(error).__name__}: {error}".split())
        message = f"{cause}; run again with -vv and report it"
        return Attempt(failed(item, message, 1, time.monotonic() - start), traceback=traceback.format_exc())


def _done(item: Item, memory: int | None, progress: Progress | None) -> Outcome:
    to_url = is_url(item.target)
    with staged(item.source, item.target) as stage:
        copy = dataclasses.replace(
            item, source=stage.source, target=stage.target,
            overwrite=item.overwrite or to_url, again=item.again and not to_url,
        )  # fmt: skip
        try:
            access = dataclasses.replace(stage.access(item.outside, memory), columns=item.columns)
            report = _made(copy, access, progress)
        except BeltramiError as error:
            error.args = (str(error).replace(stage.source, item.source).replace(stage.target, item.target),)
            raise
        sidecars = report.written[1:]
        names = [item.target, *sidecars]
        report = dataclasses.replace(report, input=item.source, output=item.target, written=names)
        if to_url:
            written = stage.send(sidecars, overwrite=item.overwrite, again=item.again)
        else:
            output = Path(os.path.realpath(item.target))
            files = (output, *(output.parent / name for name in sidecars))
            written = {str(file): hash_at(str(file)) for file in files}
        return outcome_of(item, "done", read=stage.read, written=written, report=dataclasses.asdict(report))


def _made(item: Item, access: Access, progress: Progress | None) -> FileReport:
    from beltrami_cli.jobs.noise import noise_file
    from beltrami_cli.jobs.smooth import smooth_file

    with FileSet() as files:
        job = Job(access, progress, item.overwrite or item.again, files=files)
        report: FileReport
        if item.noise is not None:
            report = noise_file(item.source, item.target, item.noise, item.settings, job)
        else:
            report = smooth_file(item.source, item.target, item.settings, job, unwrap=item.unwrap)
        if item.again and not item.overwrite:
            files.keep_equal()
        files.put_in_place()
    return report
