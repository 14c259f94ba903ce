"""Chunks of one surface in worker processes, or on the workers of a Dask scheduler.

A worker keeps the parts of the chunks that it has had, so that only colours are sent from one operation to the next. If
a worker dies, its chunk is sent to another.
"""

from __future__ import annotations

import queue
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any, Protocol, cast

from beltrami_cli.arrays import Float32s
from beltrami_cli.batch.cluster import LOST, Cancelled
from beltrami_cli.batch.item import Attempt, Item, do_item
from beltrami_cli.batch.run import Executor, answer_until_closed, start_worker
from beltrami_cli.errors import ProcessingError
from beltrami_cli.flow.chunks import Chunk, Done, Figures, Work, in_chunks
from beltrami_cli.jobs.job import at_intervals

_TRIES = 5  # of a chunk, after workers died with it
_POLL = 0.1  # seconds between two checks that nobody waits in vain
_PAUSE = 0.1  # seconds between two messages on progress
_GRACE = 0.5  # seconds that a file has to end when it is given up

StacksOf = Callable[[Chunk], list[Float32s]]


class ClosableRunner(Protocol):
    """A `Runner` that can be told to end."""

    def run(self, chunks: Sequence[Chunk], work: Work, stacks_of: StacksOf) -> Iterator[Done]: ...

    def close(self) -> None:
        """End what is in work; `run` raises Cancelled."""


class ChunkExecutor(Executor):
    """Does one file at a time here, and has up to `count` chunks of each surface done by a runner."""

    def __init__(self, runner: ClosableRunner, count: int, memory: int | None) -> None:
        self._runner, self._count, self._memory = runner, count, memory
        self._events: queue.SimpleQueue[tuple[int, Attempt | tuple[str, int, int]]] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self._ended = threading.Event()

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._runner.close()
        if self._thread is not None:
            self._thread.join(_GRACE)

    @property
    def is_full(self) -> bool:
        return self._thread is not None

    def start(self, key: int, item: Item) -> None:
        self._thread = threading.Thread(target=self._do, args=(key, item), daemon=True)
        self._thread.start()

    def events(self, items: Callable[[int], Item]) -> Iterator[tuple[int, Attempt | tuple[str, int, int]]]:
        key, event = self._events.get()
        if isinstance(event, Attempt) and self._thread is not None:
            self._thread.join()
            self._thread = None
        yield key, event

    def _do(self, key: int, item: Item) -> None:
        report = at_intervals(_PAUSE, lambda *event: self._events.put((key, event)))

        def progress(label: str, done: int, total: int) -> None:
            if self._ended.is_set():
                raise Cancelled
            report(label, done, total)

        try:
            with in_chunks(self._count, self._runner):
                self._events.put((key, do_item(item, self._memory, progress, is_alone=False)))
        except Cancelled:
            pass


def _require_few(deaths: int) -> None:
    if deaths >= _TRIES:
        cause = f"workers died {_TRIES} times with one piece of the surface"
        raise ProcessingError(f"{cause}; there may be too little memory for it: raise --pieces")


# ---- processes
@dataclass
class _Worker:
    process: SpawnProcess
    pipe: Connection[Any, Any]
    held: set[int] = field(default_factory=set)  # numbers of the chunks whose parts it has


class ProcessRunner:
    """Works on chunks in `count` processes of this machine, with a thread each."""

    def __init__(self, count: int) -> None:
        self._count, self._generation, self._is_closed = count, 0, False
        self._chunks: Sequence[Chunk] = ()
        self._workers: list[_Worker] = []

    def close(self) -> None:
        self._is_closed = True
        for worker in self._workers:
            worker.process.kill()

    def run(self, chunks: Sequence[Chunk], work: Work, stacks_of: StacksOf) -> Iterator[Done]:
        if chunks is not self._chunks:
            self._chunks, self._generation = chunks, self._generation + 1
            for worker in self._workers:
                worker.held.clear()
        waiting, deaths, busy = list(range(len(chunks))), Counter[int](), dict[Any, tuple[_Worker, int]]()
        try:
            while waiting or busy:
                while waiting and len(busy) < self._count:
                    worker = self._idle(busy)
                    number = self._next_for(worker, waiting)
                    if self._send(worker, number, work, stacks_of(chunks[number])):
                        waiting.remove(number)
                        busy[worker.pipe] = worker, number
                for pipe in wait(list(busy), _POLL):
                    worker, number = busy.pop(cast("Connection[Any, Any]", pipe))
                    try:
                        answer: tuple[Float32s, Figures] | Exception = worker.pipe.recv()
                    except (EOFError, OSError):
                        self._remove(worker)
                        deaths[number] += 1
                        _require_few(deaths[number])
                        waiting.append(number)
                        continue
                    if isinstance(answer, Exception):
                        raise answer
                    yield number, *answer
                if self._is_closed:
                    raise Cancelled
        finally:  # whoever is still at work has nobody to answer
            for worker, _ in busy.values():
                self._remove(worker)

    def _idle(self, busy: dict[Any, tuple[_Worker, int]]) -> _Worker:
        for worker in self._workers:
            if worker.pipe not in busy:
                return worker
        worker = _Worker(*start_worker(_work_on_chunks))
        self._workers.append(worker)
        return worker

    def _next_for(self, worker: _Worker, waiting: Sequence[int]) -> int:
        """Choose a chunk whose part a worker has, or else no other one has."""
        held = set[int]().union(*(each.held for each in self._workers if each is not worker))
        return min(waiting, key=lambda number: (number not in worker.held, number in held, number))

    def _send(self, worker: _Worker, number: int, work: Work, stacks: list[Float32s]) -> bool:
        """Send a chunk to a worker; return whether it lives."""
        chunk = None if number in worker.held else self._chunks[number].without_whole()
        try:
            worker.pipe.send((self._generation, number, chunk, work, stacks))
        except OSError:
            self._remove(worker)
            return False
        worker.held.add(number)
        return True

    def _remove(self, worker: _Worker) -> None:
        self._workers.remove(worker)
        worker.process.kill()
        worker.process.join()
        worker.pipe.close()


def _work_on_chunks(pipe: Connection[Any, Any]) -> None:
    """Be a worker process."""
    held, before = dict[int, Chunk](), 0

    def answer(generation: int, number: int, chunk: Chunk | None, work: Work, stacks: list[Float32s]) -> Any:
        nonlocal before
        if generation != before:
            held.clear()
            before = generation
        if chunk is not None:
            held[number] = chunk
        return _result(held[number], work, stacks)

    answer_until_closed(pipe, answer)


def _result(chunk: Chunk, work: Work, stacks: list[Float32s]) -> tuple[Float32s, Figures] | Exception:
    try:
        return work.on(chunk, stacks, 1)
    except Exception as error:  # other than the death of a worker, it would come again elsewhere
        return error


# ---- Dask
class DaskRunner:
    """Works on chunks on the workers of a scheduler."""

    def __init__(self, client: Any) -> None:
        self._client, self._is_closed = client, False
        self._chunks: Sequence[Chunk] = ()
        self._sent: dict[int, Any] = {}  # parts on workers, by the numbers of their chunks

    def close(self) -> None:
        self._is_closed = True

    def run(self, chunks: Sequence[Chunk], work: Work, stacks_of: StacksOf) -> Iterator[Done]:
        if chunks is not self._chunks:
            self._chunks, self._sent = chunks, {}
        waiting, deaths, pending = deque(range(len(chunks))), Counter[int](), dict[int, Any]()
        ended = queue.SimpleQueue[int]()
        try:
            while waiting or pending:
                workers = self._workers()
                while waiting and len(pending) < 2 * len(workers):  # one in work and one on its way
                    number = waiting.popleft()
                    place = workers[number % len(workers)]
                    pending[number] = self._submit(number, work, stacks_of(chunks[number]), place, ended)
                number = self._ended(ended)
                if number not in pending:
                    continue
                answer = self._answer(pending.pop(number))
                if answer is None:
                    self._sent.pop(number, None)  # it may be what was lost
                    deaths[number] += 1
                    _require_few(deaths[number])
                    waiting.append(number)
                elif isinstance(answer, Exception):
                    raise answer
                else:
                    yield number, *answer
        finally:
            self._client.cancel([future for future in pending.values() if future is not None], force=True)

    def _workers(self) -> list[str]:
        """Return the addresses of workers, once there is one."""
        while True:
            if self._is_closed:
                raise Cancelled
            if self._client.status not in ("running", "connecting"):
                raise ProcessingError(LOST)
            if workers := sorted(self._client.nthreads()):
                return workers
            threading.Event().wait(_POLL)

    def _submit(
        self, number: int, work: Work, stacks: list[Float32s], place: str, ended: queue.SimpleQueue[int]
    ) -> Any:
        """Send a chunk to a worker, or any other; return its future, None if the worker is gone."""
        try:
            if number not in self._sent:
                self._sent[number] = self._scatter(self._chunks[number].without_whole(), place)
            future = self._client.submit(
                _do_on_worker, self._sent[number], self._scatter((work, stacks), place),
                version("beltrami-cli"), workers=[place], allow_other_workers=True, pure=False,
            )  # fmt: skip
        except Exception:  # of many kinds, KeyError, OSError and TimeoutError among them
            ended.put(number)
            return None
        future.add_done_callback(lambda _: ended.put(number))
        return future

    def _scatter(self, value: Any, place: str) -> Any:
        return self._client.scatter(value, workers=[place], hash=False)

    def _ended(self, ended: queue.SimpleQueue[int]) -> int:
        """Wait for the number of a chunk that ended; -1: for none within a while."""
        try:
            return ended.get(timeout=_POLL)
        except queue.Empty:
            return -1

    def _answer(self, future: Any) -> tuple[Float32s, Figures] | Exception | None:
        """Return what a worker answered; None if it was lost."""
        from distributed import CancelledError

        try:
            return None if future is None else future.result()
        except (Exception, CancelledError):  # what the work itself raises is its answer
            return None


def _do_on_worker(
    chunk: Chunk, job: tuple[Work, list[Float32s]], client_version: str
) -> tuple[Float32s, Figures] | Exception:
    if version("beltrami-cli") != client_version:
        return ProcessingError(f"a worker has version {version('beltrami-cli')}, not {client_version}")
    return _result(chunk, *job)
