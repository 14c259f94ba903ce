"""Doing the job of one file, here or at URLs."""

from __future__ import annotations

import dataclasses
import hashlib
import os
import time
import traceback
from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.batch.job import Attempt, failed, outcome_of
from beltrami_cli.batch.storage import hash_at, is_url
from beltrami_cli.errors import BeltramiError, InputError
from beltrami_cli.formats.access import Access
from beltrami_cli.jobs.memory import limited_memory

if TYPE_CHECKING:
    from collections.abc import Callable

    from beltrami_cli.batch.job import Job, Outcome


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
    from beltrami_cli.jobs.smooth.file import smooth_file

    read: dict[str, str] = {}

    def note(path: Path, data: bytes) -> None:
        read[str(path.absolute())] = hashlib.sha256(data).hexdigest()

    report = smooth_file(
        job.source, job.target, job.settings, unwrap=job.unwrap, overwrite=job.overwrite, progress=progress,
        access=Access(outside=job.outside, memory=memory, note=note),
    )  # fmt: skip
    written = _hashes(job.target, report.written[1:])
    return outcome_of(job, "done", read=read, written=written, report=dataclasses.asdict(report))


def _done_at_urls(job: Job, memory: int | None, progress: Callable[[str, int, int], None] | None) -> Outcome:
    from beltrami_cli.batch.staging import staged
    from beltrami_cli.jobs.smooth.file import smooth_file

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
        return outcome_of(job, "done", read=stage.read, written=written, report=dataclasses.asdict(report))


def _hashes(target: str, beside: list[str]) -> dict[str, str]:
    output = Path(os.path.realpath(target))
    return {str(file): hash_at(str(file)) for file in [output, *(output.parent / name for name in beside)]}
