"""Chunks of one surface in worker processes, or on the workers of a Dask scheduler.

A worker keeps the parts of the chunks that it has had, so that only colours are sent from one operation to the next. If
a worker dies, its chunk is sent to another.
"""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any, cast

from beltrami_cli.arrays import Float32s
from beltrami_cli.batch.cluster import LOST, Cancelled
from beltrami_cli.batch.item import Attempt, Item, do_item
from beltrami_cli.batch.run import Executor, answer_until_closed, start_worker
from beltrami_cli.errors import ProcessingError
from beltrami_cli.flow.chunks import Chunk, Done, Figures, Work, in_chunks
from beltrami_cli.jobs.job import at_intervals

_TRIES = 5  # of a chunk, after workers died with it
_POLL = 0.1  # seconds between two checks that there still are workers
_PAUSE = 0.1  # seconds between two messages on progress
_GRACE = 0.5  # seconds that a file has to end when it is given up

StacksOf = Callable[[Chunk], list[Float32s]]
Answer = tuple[Float32s, Figures] | Exception | None


class WorkerRunner(ABC):
    """Works on chunks with workers that may die; a `Runner`."""

    def __init__(self) -> None:
        self._chunks: Sequence[Chunk] = ()
        self._is_closed = False

    def close(self) -> None:
        """End the work, now; `run` raises Cancelled."""
        self._is_closed = True

    def run(self, chunks: Sequence[Chunk], work: Work, stacks_of: StacksOf) -> Iterator[Done]:
        if chunks is not self._chunks:
            self._chunks = chunks
            self._forget()
        waiting, deaths, pending = list(range(len(chunks))), Counter[int](), set[int]()
        try:
            while waiting or pending:
                if self._is_closed:
                    raise Cancelled
                while waiting and (number := self._next(waiting, len(pending))) is not None:
                    waiting.remove(number)
                    pending.add(number)
                    self._send(number, work, stacks_of(chunks[number]))
                for number, answer in self._answers():
                    pending.discard(number)
                    if isinstance(answer, Exception):
                        raise answer
                    if answer is not None:
                        yield number, *answer
                        continue
                    deaths[number] += 1
                    if deaths[number] == _TRIES:
                        cause = f"workers died {_TRIES} times with one piece of the surface"
                        raise ProcessingError(
                            f"{cause}; there may be too little memory for it: raise --pieces"
                        )
                    waiting.append(number)
        finally:
            self._give_up()

    @abstractmethod
    def _forget(self) -> None:
        """Other chunks follow than before."""

    @abstractmethod
    def _next(self, waiting: Sequence[int], pending: int) -> int | None:
        """Choose the chunk to be sent next; None: there are enough at work."""

    @abstractmethod
    def _send(self, number: int, work: Work, stacks: list[Float32s]) -> None: ...

    @abstractmethod
    def _answers(self) -> Iterator[tuple[int, Answer]]:
        """Wait for a while, and yield what came of chunks; None: the worker died."""

    @abstractmethod
    def _give_up(self) -> None:
        """Stop the workers that still have a chunk: their answers are not wanted any more."""


class ChunkExecutor(Executor):
    """Does one file at a time here, and has up to `count` chunks of each surface done by a runner."""

    def __init__(self, runner: WorkerRunner, count: int, memory: int | None) -> None:
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


# ---- processes
@dataclass
class _Worker:
    process: SpawnProcess
    pipe: Connection[Any, Any]
    held: set[int] = field(default_factory=set)  # numbers of the chunks whose parts it has
    number: int | None = None  # of the chunk in work


class ProcessRunner(WorkerRunner):
    """Works on chunks in `count` processes of this machine, with a thread each."""

    def __init__(self, count: int) -> None:
        super().__init__()
        self._count, self._generation = count, 0
        self._workers: list[_Worker] = []

    def close(self) -> None:
        super().close()
        for worker in self._workers:
            worker.process.kill()

    def _forget(self) -> None:
        self._generation += 1
        for worker in self._workers:
            worker.held.clear()

    def _idle(self) -> _Worker | None:
        return next((worker for worker in self._workers if worker.number is None), None)

    def _next(self, waiting: Sequence[int], pending: int) -> int | None:
        if pending == self._count:
            return None
        worker, held = self._idle(), set[int]().union(*(each.held for each in self._workers))
        own = set[int]() if worker is None else worker.held
        return min(waiting, key=lambda number: (number not in own, number in held, number))

    def _send(self, number: int, work: Work, stacks: list[Float32s]) -> None:
        worker = self._idle()
        if worker is None:
            worker = _Worker(*start_worker(_work_on_chunks))
            self._workers.append(worker)
        chunk = None if number in worker.held else self._chunks[number].without_whole()
        worker.held.add(number)
        worker.number = number
        with contextlib.suppress(OSError):  # if it is dead, its pipe says so
            worker.pipe.send((self._generation, number, chunk, work, stacks))

    def _answers(self) -> Iterator[tuple[int, Answer]]:
        busy = {worker.pipe: worker for worker in self._workers if worker.number is not None}
        for pipe in wait(list(busy), _POLL):
            worker = busy[cast("Connection[Any, Any]", pipe)]
            number, worker.number = cast("int", worker.number), None
            try:
                answer: Answer = worker.pipe.recv()
            except (EOFError, OSError):
                answer = None
                self._remove(worker)
            yield number, answer

    def _give_up(self) -> None:
        for worker in self._workers[:]:
            if worker.number is not None:
                self._remove(worker)

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
class DaskRunner(WorkerRunner):
    """Works on chunks on the workers of a scheduler."""

    def __init__(self, client: Any) -> None:
        super().__init__()
        self._client = client
        self._sent: dict[int, Any] = {}  # parts on workers, by the numbers of their chunks
        self._futures: dict[int, Any] = {}  # of the chunks in work; None: the worker is gone
        self._ended = queue.SimpleQueue[tuple[int, Any]]()

    def _forget(self) -> None:
        self._sent.clear()

    def _workers(self) -> list[str]:
        """Return the addresses of workers, once there is one."""
        while not (workers := sorted(self._client.nthreads())):
            self._require_scheduler()
            if self._is_closed:
                raise Cancelled
            time.sleep(_POLL)
        return workers

    def _require_scheduler(self) -> None:
        if self._client.status not in ("running", "connecting"):
            raise ProcessingError(LOST)

    def _next(self, waiting: Sequence[int], pending: int) -> int | None:
        return waiting[0] if pending < 2 * len(self._workers()) else None  # one in work and one on its way

    def _send(self, number: int, work: Work, stacks: list[Float32s]) -> None:
        workers = self._workers()
        try:
            place = workers[number % len(workers)]
            if number not in self._sent:
                self._sent[number] = self._scatter(self._chunks[number].without_whole(), place)
            future = self._client.submit(
                _do_on_worker, self._sent[number], self._scatter((work, stacks), place),
                version("beltrami-cli"), workers=[place], allow_other_workers=True, pure=False,
            )  # fmt: skip
        except (
            Exception
        ):  # of many kinds where a worker is gone, KeyError, OSError and TimeoutError among them
            future = None
            self._ended.put((number, future))
        self._futures[number] = future
        if future is not None:
            future.add_done_callback(lambda done: self._ended.put((number, done)))

    def _scatter(self, value: Any, place: str) -> Any:
        return self._client.scatter(value, workers=[place], hash=False)

    def _answers(self) -> Iterator[tuple[int, Answer]]:
        from distributed import CancelledError

        try:
            number, future = self._ended.get(timeout=_POLL)
        except queue.Empty:
            self._require_scheduler()
            return
        if number not in self._futures or self._futures[number] is not future:  # of an operation before
            return
        del self._futures[number]
        try:
            answer: Answer = None if future is None else future.result()
        except (Exception, CancelledError):  # what the work itself raises is its answer
            answer = None
        if answer is None:
            self._sent.pop(number, None)  # it may be what was lost
        yield number, answer

    def _give_up(self) -> None:
        self._client.cancel([future for future in self._futures.values() if future is not None], force=True)
        self._futures.clear()


def _do_on_worker(
    chunk: Chunk, job: tuple[Work, list[Float32s]], client_version: str
) -> tuple[Float32s, Figures] | Exception:
    if version("beltrami-cli") != client_version:
        return ProcessingError(f"a worker has version {version('beltrami-cli')}, not {client_version}")
    return _result(chunk, *job)
