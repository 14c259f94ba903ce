"""What a worker does with a file."""

from __future__ import annotations

import dataclasses
import time
from importlib.metadata import version
from typing import TYPE_CHECKING

from beltrami_cli.batch.doing import do_job
from beltrami_cli.batch.job import Attempt, failed

if TYPE_CHECKING:
    from beltrami_cli.batch.job import Job

_PAUSE = 0.3  # seconds between two messages on progress


class _GivenUp(BaseException):
    """Nobody wants the result any more."""


def do_on_worker(job: Job, memory: int | None, topic: str, key: int, told_version: str) -> Attempt:
    """Smooth one file in the process of a worker.

    Parameters
    ----------
    job : Job
        With absolute paths, or URLs.
    memory : int or None
        Bytes that it may take; None: the worker's share of its own limit.
    topic : str
        Under which progress is told to the client: the key, a label, and the work done and to do.
    key : int
        Of the job.
    told_version : str
        Of the program that sent it: another one might not give the same bytes.
    """
    from distributed import get_client, get_worker

    worker = get_worker()
    if version("beltrami-cli") != told_version:
        cause = f"the worker {worker.address} has version {version('beltrami-cli')}"
        return Attempt(
            failed(job, f"{job.source}: {cause}, not {told_version}; install the same everywhere", 1)
        )
    # A worker that died may have written the file already, which was not there when the job was given out.
    client, place = get_client(), [topic, str(key)]
    again = client.get_metadata(place, default=None) is not None
    client.set_metadata(place, worker.address)
    limit = worker.memory_manager.memory_limit
    if memory is None and limit:
        memory = limit // worker.state.nthreads
    last, task = 0.0, worker.get_current_task()

    def progress(label: str, done: int, total: int) -> None:
        nonlocal last
        if time.monotonic() - last < _PAUSE:
            return
        last = time.monotonic()
        state = worker.state.tasks.get(task)
        if state is None or state.state == "cancelled":
            raise _GivenUp
        worker.log_event(topic, [key, label, done, total])

    mine = dataclasses.replace(job, overwrite=job.overwrite or again)
    # Threads share the memory of a process, which can then not be limited for one of them.
    try:
        return do_job(mine, memory, progress, is_alone=worker.state.nthreads == 1)
    except _GivenUp:
        return Attempt(failed(job, f"{job.source}: given up", 1))
