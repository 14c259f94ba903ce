"""Workers of a Dask scheduler: the connection, the pool of its workers, and tasks on a worker."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import logging
import queue
import socket
import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from importlib.metadata import version
from math import inf
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from beltrami_cli.batch.item import Attempt, Item
from beltrami_cli.batch.pool import Advance, Lost, Pool, Task
from beltrami_cli.batch.storage import canonical_name
from beltrami_cli.batch.work import do_item
from beltrami_cli.errors import ProcessingError, install_hint
from beltrami_cli.fields import with_files
from beltrami_cli.formats.files.bounded_text import CONFIGURATION, parse_json, read_bounded
from beltrami_cli.formats.files.paths import is_file, is_url
from beltrami_cli.jobs.progress import Progress, at_intervals

_LOST = "the connection to the scheduler was lost"
_CONNECT_TIMEOUT = 10.0  # seconds for a scheduler to accept a connection, and again to say what it is
_PROGRESS_INTERVAL = 0.3  # seconds between two messages on progress from a worker
_POLL = 0.1  # seconds between two checks of the connection and of the number of workers


@contextlib.contextmanager
def connected(address: str) -> Iterator[Any]:
    """Connect to a scheduler, at tcp://HOST:PORT or by its file (.json), and return the distributed.Client."""
    try:
        from distributed import Client
        from distributed.security import Security
    except ImportError as error:
        message = f"--scheduler needs Dask, which is not installed; {install_hint('beltrami-cli[cluster]')}"
        raise ProcessingError(message) from error
    # Errors are reported by this program, in one line.
    for name in ("asyncio", "distributed", "distributed.client", "distributed.comm", "distributed.core"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        where = address
        if address.endswith(".json"):  # written by a scheduler, with its address
            where = str(parse_json(read_bounded(Path(address), CONFIGURATION))["address"])
        _require_listener(where)
        security = Security()  # certificates, and whether they are required, from Dask's own configuration
        asyncio.run(_require_scheduler(where, security))
        client = Client(where, timeout=_CONNECT_TIMEOUT, set_as_default=False, security=security)
    except Exception as error:  # Dask raises errors of any kind for bytes of other protocols
        cause = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise ProcessingError(
            f"{address}: no Dask scheduler answers there ({cause}); start one with dask scheduler, or check the address"
        ) from error
    try:
        yield client
    finally:
        client.close()


def _require_listener(address: str) -> None:
    """Raise ValueError or OSError at once if nothing listens at an address; a client would keep trying."""
    parts = urlsplit(address if "://" in address else f"tcp://{address}")
    if parts.scheme == "inproc" and parts.path.count("/") == 2:  # a scheduler in this process
        return
    if not parts.hostname or not parts.port:
        raise ValueError("an address is like tcp://HOST:PORT")
    socket.create_connection((parts.hostname, parts.port), timeout=_CONNECT_TIMEOUT).close()


async def _require_scheduler(address: str, security: Any) -> None:
    """Raise an exception (of any kind) if the listener is not a scheduler; a client would hang there."""
    from distributed.core import rpc

    arguments = security.get_connection_args("client")
    async with rpc(address, timeout=_CONNECT_TIMEOUT, connection_args=arguments) as peer:
        try:
            identity = await asyncio.wait_for(peer.identity(), _CONNECT_TIMEOUT)
        except TimeoutError as error:
            raise TimeoutError(
                f"it accepts connections, and says nothing for {_CONNECT_TIMEOUT:g} s"
            ) from error
    if identity["type"] != "Scheduler":
        raise ValueError(f"it is a {identity['type']}")


class OnDask(Pool):
    """The workers of a scheduler, which gives the task of one that died to another until that happened too often.

    `at_once`: most tasks that are given to the scheduler at the same time, `per_worker`: most for each worker.
    """

    def __init__(self, client: Any, at_once: int | None = None, per_worker: int | None = None) -> None:
        self._client, self._at_once, self._per_worker = client, at_once, per_worker
        self._topic = f"beltrami-{uuid.uuid4().hex}"  # of progress
        self._events = queue.SimpleQueue[tuple[int, Any]]()
        self._futures, self._parts = dict[int, Any](), dict[int, Any]()
        client.subscribe_topic(self._topic, self._note)

    @property
    def is_full(self) -> bool:
        most = inf if self._at_once is None else self._at_once
        if self._per_worker is not None:
            try:
                most = min(most, self._per_worker * len(self._client.nthreads()))
            except (OSError, TimeoutError) as error:
                raise ProcessingError(_LOST) from error
        return len(self._futures) >= most

    def start(self, key: int, task: Task, *arguments: Any, part: Callable[[], Any] | None = None) -> None:
        if part is not None:
            if key not in self._parts:
                self._parts[key] = self._scattered(part())
            arguments = self._parts[key], *arguments
        # Arguments of the task itself would go through the scheduler.
        sent = [self._scattered(each) if isinstance(each, list) else each for each in arguments]
        try:
            future = self._client.submit(
                run_on_worker, task, self._topic, key, version("beltrami-cli"), *sent, pure=False
            )
        except Exception as error:  # of various kinds, if a worker or the scheduler is gone
            future = Future[Any]()
            future.set_exception(error)
        self._futures[key] = future
        future.add_done_callback(lambda done: self._events.put((key, done)))

    def events(self) -> Iterator[tuple[int, Any]]:
        try:
            key, event = self._events.get(timeout=_POLL)
        except queue.Empty:
            if self._client.status not in ("running", "connecting"):
                raise ProcessingError(_LOST) from None
            return
        if isinstance(event, Advance):
            if key in self._futures:
                yield key, event
        elif self._futures.get(key) is event:  # otherwise the task was cancelled
            del self._futures[key]
            result = _result(event)
            if isinstance(result, Lost):
                self._parts.pop(key, None)  # it may have been lost with a worker
            yield key, result

    def forget(self) -> None:
        self._parts.clear()

    def _scattered(self, value: Any) -> Any:
        try:
            return self._client.scatter(value, hash=False)
        except Exception:  # of various kinds, if a worker is gone; then the value is sent with the task
            return value

    def give_up(self) -> None:
        with contextlib.suppress(Exception):  # if the scheduler is gone, there is nothing to cancel
            self._client.cancel([each for each in self._futures.values() if not each.done()], force=True)
        self._futures.clear()

    def close(self) -> None:
        super().close()
        self._client.unsubscribe_topic(self._topic)

    def _note(self, event: tuple[float, list[Any]]) -> None:
        key, label, done, total = event[1]
        self._events.put((key, Advance(label, done, total)))


def _result(future: Any) -> Any:
    from distributed import CancelledError, KilledWorker

    try:
        return future.result()
    except KilledWorker as error:
        # The last worker died during this task, which may be the cause.
        cause = f"every worker that had it in work died, the last one at {error.last_worker.address}"
        return Lost(f"{cause}; there may be too little memory")
    except CancelledError:
        return Lost(f"{_LOST}, or the work was cancelled there")
    except Exception as error:
        return Lost(" ".join(f"{type(error).__name__}: {error}".split()))


def portable(item: Item) -> Item:
    """Return the item with absolute paths, which are the same on all machines with shared storage."""
    source = item.source if is_url(item.source) else str(Path(item.source).absolute())
    # A guide is not always a file.
    settings = with_files(item.settings, lambda name: str(Path(name).absolute()) if is_file(name) else name)
    return dataclasses.replace(item, source=source, target=canonical_name(item.target), settings=settings)


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
