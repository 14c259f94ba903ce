"""Tasks on a worker of a Dask scheduler."""

from __future__ import annotations

import dataclasses
from importlib.metadata import version
from typing import Any

import numpy as np

from beltrami_cli.batch.item import Attempt, Item
from beltrami_cli.batch.pool import Lost, Task
from beltrami_cli.batch.work import do_item
from beltrami_cli.jobs.progress import Progress, at_intervals

_PROGRESS_INTERVAL = 0.3  # seconds between two messages on progress


class _Cancelled(BaseException):
    """The result is no longer wanted."""


def run_on_worker(task: Task, topic: str, key: int, client_version: str, *arguments: Any) -> Any:
    from distributed import get_worker

    worker = get_worker()
    if version("beltrami-cli") != client_version:  # other versions may give other bytes
        cause = f"the worker {worker.address} has version {version('beltrami-cli')}, not {client_version}"
        return Lost(f"{cause}; install the same everywhere")
    running = worker.get_current_task()

    def progress(label: str, done: float, total: float) -> None:
        state = worker.state.tasks.get(running)
        if state is None or state.state == "cancelled":
            raise _Cancelled
        worker.log_event(topic, [key, str(label), done, total])  # a plain string: Dask sends no subclasses

    # Writable copies: arrays from Dask may be read-only, and another attempt needs them unchanged.
    values = [[np.array(each) for each in value] if isinstance(value, list) else value for value in arguments]
    try:
        return task(*values, at_intervals(progress, _PROGRESS_INTERVAL))
    except _Cancelled:
        return Lost("given up")


def do_on_worker(item: Item, local: Item, memory: int | None, progress: Progress) -> Attempt:
    """Smooth one file by its names on this machine, in `local`; `memory` None: the worker's share of its own limit."""
    from distributed import get_client, get_worker

    # A worker that died may already have written the file after the item was sent.
    worker, client = get_worker(), get_client()
    running = str(worker.get_current_task())
    is_retry = client.get_metadata([running], default=None) is not None
    client.set_metadata([running], worker.address)
    threads, limit = worker.state.nthreads, worker.memory_manager.memory_limit
    if memory is None and limit:
        memory = limit // threads
    local = dataclasses.replace(local, is_retry=item.is_retry or is_retry)
    # Threads share the memory of their process, so it cannot be limited for one of them.
    return do_item(item, memory, progress, is_alone=threads == 1, local=local)
