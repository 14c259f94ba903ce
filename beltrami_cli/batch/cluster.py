"""The connection to a Dask scheduler, and files on its workers: one task for each."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import logging
import queue
import socket
import uuid
from collections.abc import Callable, Iterator
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self
from urllib.parse import urlsplit

from beltrami_cli.batch.item import Attempt, Item, do_item, failed
from beltrami_cli.batch.run import Executor
from beltrami_cli.batch.storage import is_url, place_of
from beltrami_cli.errors import ProcessingError
from beltrami_cli.fields import with_files
from beltrami_cli.formats.access import CONFIGURATION, is_file, parse_json, read_bounded
from beltrami_cli.jobs.job import at_intervals

LOST = "the connection to the scheduler was lost"
_PATIENCE = 10.0  # seconds for a scheduler to accept a connection, and again to say what it is
_POLL = 1.0  # seconds between two checks that the scheduler is still there
_PAUSE = 0.3  # seconds between two messages on progress


@contextlib.contextmanager
def connected(address: str) -> Iterator[Any]:
    """Give a distributed.Client of a scheduler: at tcp://HOST:PORT, or where a file (.json) that it wrote says."""
    try:
        from distributed import Client
        from distributed.security import Security
    except ImportError as error:
        message = "--scheduler needs Dask, which is not installed; pip install 'beltrami-cli[cluster]'"
        raise ProcessingError(message) from error
    # What goes wrong is reported by us, in one line.
    for name in ("asyncio", "distributed", "distributed.client", "distributed.comm", "distributed.core"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        where = address
        if address.endswith(".json"):  # in which a scheduler wrote where it is
            where = str(parse_json(read_bounded(Path(address), CONFIGURATION))["address"])
        _require_listener(where)
        security = Security()  # certificates, and whether they are required, from Dask's own configuration
        _require_encryption(where, security)
        asyncio.run(_require_scheduler(where, security))
        client = Client(where, timeout=_PATIENCE, set_as_default=False, security=security)
    except Exception as error:  # Dask raises whatever comes of bytes that are not its own
        cause = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise ProcessingError(
            f"{address}: no Dask scheduler answers there ({cause}); start one with dask scheduler, or check the address"
        ) from error
    try:
        yield client
    finally:
        client.close()


def _require_encryption(address: str, security: Any) -> None:
    """Raise ValueError if encryption is asked for without certificates, or required and not asked for."""
    is_encrypted = address.startswith("tls://")
    if is_encrypted and security.get_connection_args("client").get("ssl_context") is None:
        needed = "ca-file, client.cert and client.key"
        raise ValueError(f"TLS needs distributed.comm.tls in Dask's configuration: {needed}")
    if security.require_encryption and not is_encrypted:
        raise ValueError("encryption is required by Dask's configuration, and the address is not tls://")


def _require_listener(address: str) -> None:
    """Raise ValueError or OSError at once if nothing listens at an address; a client would keep trying."""
    parts = urlsplit(address if "://" in address else f"tcp://{address}")
    if parts.scheme == "inproc" and parts.path.count("/") == 2:  # one of this process
        return
    if not parts.hostname or not parts.port:
        raise ValueError("an address is like tcp://HOST:PORT")
    socket.create_connection((parts.hostname, parts.port), timeout=_PATIENCE).close()


async def _require_scheduler(address: str, security: Any) -> None:
    """Raise an exception of any kind if what listens at an address is no scheduler, where a client would hang."""
    from distributed.comm import connect

    async def identity() -> str:
        connection = await connect(address, timeout=_PATIENCE, **security.get_connection_args("client"))
        try:
            await connection.write({"op": "identity", "reply": True})
            return str((await connection.read())["type"])
        finally:
            connection.abort()

    try:
        found = await asyncio.wait_for(identity(), _PATIENCE)
    except TimeoutError as error:
        raise TimeoutError(f"it accepts connections, and says nothing for {_PATIENCE:g} s") from error
    if found != "Scheduler":
        raise ValueError(f"it is a {found}")


class ClusterExecutor(Executor):
    """Has every file done by some worker.

    A file whose worker dies is given to another one by the scheduler, until that happened too often (its setting
    distributed.scheduler.allowed-failures). `at_once` None: all files are given to the scheduler, whose workers do one
    for each of their threads. `memory` (bytes for each file) None: by the limits of the workers.
    """

    queues = True
    threads = 1  # a worker does as many files at once as it has threads

    def __init__(self, client: Any, at_once: int | None, memory: int | None) -> None:
        self._client, self._at_once, self._memory = client, at_once, memory
        self._topic = f"beltrami-{uuid.uuid4().hex}"
        self._events: queue.SimpleQueue[tuple[int, tuple[str, int, int] | None]] = queue.SimpleQueue()
        self._futures: dict[int, Any] = {}

    def __enter__(self) -> Self:
        self._client.subscribe_topic(self._topic, self._note)
        return self

    def __exit__(self, *_: object) -> None:
        self._client.cancel(list(self._futures.values()), force=True)
        self._client.unsubscribe_topic(self._topic)

    @property
    def is_full(self) -> bool:
        return self._at_once is not None and len(self._futures) >= self._at_once

    def start(self, key: int, item: Item) -> None:
        future = self._client.submit(
            _do_on_worker, _portable(item), self._memory, self._topic, key, version("beltrami-cli"),
            key=f"{self._topic}-{key}", pure=False,
        )  # fmt: skip
        self._futures[key] = future
        future.add_done_callback(partial(self._end, key))

    def events(self, items: Callable[[int], Item]) -> Iterator[tuple[int, Attempt | tuple[str, int, int]]]:
        try:
            key, progress = self._events.get(timeout=_POLL)
        except queue.Empty:
            if self._client.status not in ("running", "connecting"):
                for key in list(self._futures):
                    yield key, self._lost(key, items(key), LOST)
            return
        if key not in self._futures:
            return
        yield key, progress or self._attempt(key, items(key))

    def _attempt(self, key: int, item: Item) -> Attempt:
        from distributed import CancelledError, KilledWorker

        future = self._futures[key]
        try:
            attempt: Attempt = future.result(timeout=60)
        except KilledWorker as error:
            # The last of them died with this file in work: it may be what they died of.
            cause = f"every worker that had it in work died, the last one at {error.last_worker.address}"
            return self._lost(key, item, f"{cause}; there may be too little memory")
        except CancelledError:
            return self._lost(key, item, f"{LOST}, or the work was cancelled there")
        except Exception as error:
            return self._lost(key, item, " ".join(f"{type(error).__name__}: {error}".split()))
        del self._futures[key]
        sent = _portable(item)
        message = attempt.outcome.error.replace(sent.source, item.source).replace(sent.target, item.target)
        outcome = dataclasses.replace(
            attempt.outcome, input=item.source, output=item.target, parameters_sha256=item.parameters, error=message
        )  # fmt: skip
        return dataclasses.replace(attempt, outcome=outcome)

    def _lost(self, key: int, item: Item, cause: str) -> Attempt:
        del self._futures[key]
        return Attempt(failed(item, f"{item.source}: {cause}", 1))

    def _note(self, event: tuple[float, list[Any]]) -> None:
        key, label, done, total = event[1]
        self._events.put((key, (label, done, total)))

    def _end(self, key: int, future: Any) -> None:
        self._events.put((key, None))


def _portable(item: Item) -> Item:
    """Return the item with paths that mean the same everywhere, if the files are on shared storage."""
    source = item.source if is_url(item.source) else str(Path(item.source).absolute())
    # A guide may be something else than a file.
    settings = with_files(item.settings, lambda name: str(Path(name).absolute()) if is_file(name) else name)
    return dataclasses.replace(item, source=source, target=place_of(item.target), settings=settings)


# ---- on a worker
class Cancelled(BaseException):
    """The result is no longer wanted."""


def _do_on_worker(item: Item, memory: int | None, topic: str, key: int, client_version: str) -> Attempt:
    """Smooth one file in the process of a worker; `memory` None: the worker's share of its own limit."""
    from distributed import get_client, get_worker

    worker = get_worker()
    if version("beltrami-cli") != client_version:  # which might not give the same bytes
        cause = f"the worker {worker.address} has version {version('beltrami-cli')}"
        error = f"{item.source}: {cause}, not {client_version}; install the same everywhere"
        return Attempt(failed(item, error, 1))
    # A worker that died may have written the file already, which was not there when the item was given out.
    client, place = get_client(), [topic, str(key)]
    again = client.get_metadata(place, default=None) is not None
    client.set_metadata(place, worker.address)
    limit = worker.memory_manager.memory_limit
    if memory is None and limit:
        memory = limit // worker.state.nthreads
    task = worker.get_current_task()

    def progress(label: str, done: int, total: int) -> None:
        state = worker.state.tasks.get(task)
        if state is None or state.state == "cancelled":
            raise Cancelled
        worker.log_event(topic, [key, label, done, total])

    own = dataclasses.replace(item, again=item.again or again)
    # Threads share the memory of a process, which can then not be limited for one of them.
    try:
        return do_item(own, memory, at_intervals(_PAUSE, progress), is_alone=worker.state.nthreads == 1)
    except Cancelled:
        return Attempt(failed(item, f"{item.source}: given up", 1))
