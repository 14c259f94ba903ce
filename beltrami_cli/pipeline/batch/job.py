"""One file of a batch: what is to be done, doing it, and what came of it."""

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

from beltrami_cli.errors import BeltramiError, InputError
from beltrami_cli.formats.access import Access
from beltrami_cli.pipeline.batch.storage import hash_at, is_url
from beltrami_cli.pipeline.memory import limited_memory

if TYPE_CHECKING:
    from collections.abc import Callable

    from beltrami_cli.pipeline.settings.bake import BakeSettings
    from beltrami_cli.pipeline.settings.smooth import SmoothSettings

Status = Literal["started", "done", "skipped", "failed", "not started"]


@dataclass(frozen=True)
class Job:
    """What is to be done with one file; it can be sent to another process.

    Attributes
    ----------
    source, target : str
        Where from, where to.
    settings : SmoothSettings
        What smoothing is told.
    unwrap : BakeSettings or None
        How a new texture is made; None: none is wanted.
    outside : bool
        Whether files are followed that the model names beyond its own folder.
    overwrite : bool
        Whether existing files may be replaced.
    """

    source: str
    target: str
    settings: SmoothSettings
    unwrap: BakeSettings | None = None
    outside: bool = False
    overwrite: bool = False

    @property
    def parameters(self) -> str:
        """Hash of all that the result depends on besides the files: the settings and the version of this program."""
        settings = dataclasses.asdict(self.settings)
        del settings["kernel"]["threads"]  # the result is the same for any number
        unwrap = None if self.unwrap is None else dataclasses.asdict(self.unwrap)
        told = [version("beltrami-cli"), settings, unwrap, self.outside]
        return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True)
class Outcome:
    """What came of one file; as JSON it is a line of the report.

    Attributes
    ----------
    input, output : str
        Where from, where to.
    status : {"started", "done", "skipped", "failed", "not started"}
        What was done; "skipped": what an earlier run did still holds.
    parameters_sha256 : str
        See `Job.parameters`.
    time : float
        When it was written, in seconds since 1970.
    seconds : float
        How long it took.
    error : str
        What went wrong.
    exit_code : int
        What `smooth` would have exited with.
    read, written : dict of str to str
        SHA-256 of every file that was read, and that was written.
    report : dict or None
        The report of `smooth`.
    """

    input: str
    output: str
    status: Status
    parameters_sha256: str = ""
    time: float = field(default_factory=time.time)
    seconds: float = 0.0
    error: str = ""
    exit_code: int = 0
    read: dict[str, str] = field(default_factory=dict)
    written: dict[str, str] = field(default_factory=dict)
    report: dict[str, object] | None = None


@dataclass(frozen=True)
class Attempt:
    """What a worker answers: the outcome, whether more memory might help, and where an unforeseen error arose."""

    outcome: Outcome
    wants_memory: bool = False
    traceback: str = ""


def do_job(
    job: Job,
    memory: int | None,
    progress: Callable[[str, int, int], None] | None = None,
    *,
    is_alone: bool = True,
) -> Attempt:
    """Smooth one file, as `smooth_file` does.

    Parameters
    ----------
    job : Job
        What is to be done.
    memory : int or None
        Bytes that the job may take; None: as many as there are.
    progress : callable, optional
        As for `smooth_file`.
    is_alone : bool
        Whether the process has nothing else to do, so that its memory can be limited; if not, only what is refused
        beforehand is refused.

    Returns
    -------
    Attempt
        Whatever goes wrong with the file is told in it, and not raised.
    """
    start = time.monotonic()
    try:
        with limited_memory(memory if is_alone else None, job.source):
            at_urls = is_url(job.source) or is_url(job.target)
            done = (_done_at_urls if at_urls else _done)(job, memory, progress)
        return Attempt(dataclasses.replace(done, seconds=round(time.monotonic() - start, 3)))
    except BeltramiError as error:
        # Whatever refuses a file for want of memory names the option as the way out.
        wants_memory = isinstance(error, InputError) and "--max-memory" in error.remedy
        told = str(error)
        if job.source not in told and job.target not in told:
            told = f"{job.source}: {told}"
        outcome = failed(job, told, error.exit_code, time.monotonic() - start)
        return Attempt(outcome, wants_memory)
    except Exception as error:  # even a mistake of ours is of this file only
        cause = " ".join(f"{job.source}: unexpected error: {type(error).__name__}: {error}".split())
        told = f"{cause}; run again with -vv and report it"
        return Attempt(failed(job, told, 1, time.monotonic() - start), traceback=traceback.format_exc())


def _done(job: Job, memory: int | None, progress: Callable[[str, int, int], None] | None) -> Outcome:
    from beltrami_cli.pipeline.smooth.file import smooth_file

    read: dict[str, str] = {}

    def note(path: Path, data: bytes) -> None:
        read[str(path.absolute())] = hashlib.sha256(data).hexdigest()

    report = smooth_file(
        job.source, job.target, job.settings, unwrap=job.unwrap, overwrite=job.overwrite, progress=progress,
        access=Access(outside=job.outside, memory=memory, note=note),
    )  # fmt: skip
    written = _hashes(job.target, report.written[1:])
    return _outcome(job, "done", read=read, written=written, report=dataclasses.asdict(report))


def _done_at_urls(job: Job, memory: int | None, progress: Callable[[str, int, int], None] | None) -> Outcome:
    from beltrami_cli.pipeline.batch.staging import staged
    from beltrami_cli.pipeline.smooth.file import smooth_file

    with staged(job) as stage:
        here = stage.job
        try:
            report = smooth_file(
                here.source, here.target, job.settings, unwrap=job.unwrap, overwrite=here.overwrite,
                progress=progress, access=stage.access(memory),
            )  # fmt: skip
        except BeltramiError as error:
            error.args = (stage.in_words(error),)
            raise
        report = dataclasses.replace(
            report, input=job.source, output=job.target, written=[job.target, *report.written[1:]]
        )
        beside = report.written[1:]
        written = stage.send(beside) if is_url(job.target) else _hashes(job.target, beside)
        return _outcome(job, "done", read=stage.read, written=written, report=dataclasses.asdict(report))


def _hashes(target: str, beside: list[str]) -> dict[str, str]:
    output = Path(os.path.realpath(target))
    return {str(file): hash_at(str(file)) for file in [output, *(output.parent / name for name in beside)]}


def _outcome(job: Job, status: Status, **told: Any) -> Outcome:
    return Outcome(job.source, job.target, status, parameters_sha256=job.parameters, **told)


def failed(job: Job, error: str, exit_code: int, seconds: float = 0.0) -> Outcome:
    """Return the outcome of a job that failed."""
    return _outcome(job, "failed", seconds=round(seconds, 3), error=error, exit_code=exit_code)
