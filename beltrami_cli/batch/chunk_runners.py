"""Chunks of one surface in worker processes, or on the workers of a Dask scheduler.

A worker keeps the parts of the chunks that it has had, so that only colours are sent from one operation to the next. If
a worker dies, its chunk is sent to another.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import mmap
import os
import queue
import threading
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import version
from itertools import pairwise
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any, cast

import numpy as np

from beltrami_cli.arrays import Float32s
from beltrami_cli.batch.cluster import LOST, Cancelled
from beltrami_cli.batch.item import Attempt, Item, do_item, failed
from beltrami_cli.batch.run import Executor, answer_until_closed, start_worker
from beltrami_cli.errors import ProcessingError
from beltrami_cli.flow.chunks import Chunk, Done, Figures, Work, in_chunks
from beltrami_cli.formats.image.reading import scratch_file
from beltrami_cli.jobs.job import at_intervals
from beltrami_cli.jobs.replacing import GATE, endings_held

# Attempts at a chunk before its file fails: a machine that restarts loses a few workers, and a chunk that is too large
# for the memory kills every worker. A choice, as are the times below.
_TRIES = 5
_POLL = 0.1  # seconds between two checks that there still are workers
_PAUSE = 0.1  # seconds between two messages on progress
_GRACE = 0.5  # seconds that a file has to stop, so that Ctrl-C ends within a second

StacksOf = Callable[[Chunk], list[Float32s]]
Answer = tuple[Float32s, Figures] | Exception | None


class WorkerRunner(ABC):
    """Works on chunks with workers that may die; a `Runner`."""

    def __init__(self) -> None:
        self._chunks: Sequence[Chunk] = ()
        self._is_closed = False
        self._cause = ""  # of the last failure of a worker, where it is known
        self.most = 0  # chunks that a surface was cut into

    def close(self) -> None:
        """End the work, now; `run` raises Cancelled."""
        self._is_closed = True

    def run(self, chunks: Sequence[Chunk], work: Work, stacks_of: StacksOf) -> Iterator[Done]:
        if chunks is not self._chunks:
            self.forget()
            self._chunks, self.most = chunks, max(self.most, len(chunks))
        waiting, deaths, pending = list(range(len(chunks))), Counter[int](), set[int]()
        try:
            while waiting or pending:
                if self._is_closed:
                    raise Cancelled
                while (
                    not self._is_closed
                    and waiting
                    and (number := self._next(waiting, len(pending))) is not None
                ):
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
                        cause = f"workers died or failed {_TRIES} times with one piece of the surface{self._cause}"
                        remedy = "if there is too little memory for it, raise --pieces"
                        raise ProcessingError(f"{cause}; {remedy}")
                    waiting.append(number)
        finally:
            self._give_up()

    def forget(self) -> None:
        """Let go of the chunks; others follow, or none."""
        self._chunks = ()

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


class _Gate:
    """Lets a thread write files; closing it waits for a write in progress, and forbids new ones."""

    def __init__(self) -> None:
        self._lock, self._is_closed = threading.Lock(), False

    def __enter__(self) -> None:
        self._lock.acquire()
        if self._is_closed:
            self._lock.release()
            raise Cancelled

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    def close(self) -> None:
        with endings_held(), self._lock:
            self._is_closed = True


class ChunkExecutor(Executor):
    """Does one file at a time here, and has up to `count` chunks of each surface done by a runner."""

    def __init__(self, runner: WorkerRunner, count: int, memory: int | None) -> None:
        self._runner, self._count, self._memory = runner, count, memory
        self._events: queue.SimpleQueue[tuple[int, Attempt | tuple[str, int, int]]] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self._ended, self._gate = threading.Event(), _Gate()

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._runner.close()
        if self._thread is not None:
            self._thread.join(_GRACE)
            self._gate.close()
            self._thread.join(_GRACE)  # for what it still removes

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

        GATE.set(self._gate)
        attempt = Attempt(failed(item, f"{item.source}: given up", 1))
        try:
            with in_chunks(self._count, self._runner):
                attempt = do_item(item, self._memory, progress, is_alone=False)
            attempt = dataclasses.replace(attempt, pieces=self._runner.most)
        except Cancelled:
            return
        finally:
            self._runner.forget()
            self._runner.most = 0
            self._events.put((key, attempt))


# ---- processes
class _Exchange:
    """A file in which two processes hand arrays to each other: through a pipe these would be copied four times."""

    def __init__(self, path: Path) -> None:
        self._path, self._pages = path, np.zeros(0, np.float32)

    def put(self, arrays: Sequence[Float32s]) -> list[tuple[int, ...]]:
        """Replace the arrays before; return the shapes of the new ones."""
        size = sum(array.nbytes for array in arrays)
        if size > self._pages.nbytes:
            with self._path.open("r+b") as file:
                if hasattr(
                    os, "posix_fallocate"
                ):  # else full storage would end the process as it writes a page
                    os.posix_fallocate(file.fileno(), 0, size)
                else:
                    file.truncate(size)
        shapes = [array.shape for array in arrays]
        for place, array in zip(self.take(shapes), arrays, strict=True):
            place[...] = array
        return shapes

    def take(self, shapes: Sequence[tuple[int, ...]]) -> list[Float32s]:
        """Return the arrays, which last until others are put."""
        borders = [0, *np.cumsum([math.prod(shape) for shape in shapes], dtype=int).tolist()]
        if borders[-1] > len(self._pages):
            with self._path.open("r+b") as file:
                self._pages = np.frombuffer(mmap.mmap(file.fileno(), 0), np.float32)
        parts = zip(pairwise(borders), shapes, strict=True)
        return [self._pages[begin:end].reshape(shape) for (begin, end), shape in parts]


@dataclass
class _Worker:
    process: SpawnProcess
    pipe: Connection[Any, Any]
    exchange: _Exchange
    file: contextlib.ExitStack  # of both
    held: set[int] = field(default_factory=set)  # numbers of the chunks whose parts it has
    number: int | None = None  # of the chunk in work

    @classmethod
    def started(cls) -> _Worker:
        with contextlib.ExitStack() as file:
            path = file.enter_context(scratch_file())
            return cls(*start_worker(partial(_work_on_chunks, path)), _Exchange(path), file.pop_all())

    def end(self) -> None:
        self.process.kill()
        self.process.join()
        self.pipe.close()
        self.file.close()


class ProcessRunner(WorkerRunner):
    """Works on chunks in `count` processes of this machine, with a thread each."""

    def __init__(self, count: int) -> None:
        super().__init__()
        self._count, self._generation = count, 0
        self._workers: list[_Worker] = []

    def close(self) -> None:
        super().close()
        for worker in self._workers[:]:  # the thread that works with them may add and remove some
            worker.process.kill()

    def forget(self) -> None:
        super().forget()
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
            worker = _Worker.started()
            self._workers.append(worker)
        chunk = None if number in worker.held else self._chunks[number].without_whole()
        try:
            shapes = worker.exchange.put(stacks)
        except OSError as error:
            cause = f"there is no room for a piece in work ({error.strerror})"
            raise ProcessingError(f"{cause}; lower --jobs, or raise --pieces") from error
        worker.held.add(number)
        worker.number = number
        with contextlib.suppress(OSError):  # if it is dead, its pipe says so
            worker.pipe.send((self._generation, number, chunk, work, shapes))

    def _answers(self) -> Iterator[tuple[int, Answer]]:
        busy = {worker.pipe: worker for worker in self._workers if worker.number is not None}
        for pipe in wait(list(busy), _POLL):
            worker = busy[cast("Connection[Any, Any]", pipe)]
            number, worker.number = cast("int", worker.number), None
            try:
                answer = worker.pipe.recv()
            except (EOFError, OSError):
                answer = None
                self._remove(worker)
            if isinstance(answer, tuple):
                shape, figures = answer
                answer = *worker.exchange.take([shape]), figures
            yield number, answer

    def _give_up(self) -> None:
        for worker in self._workers[:]:
            if worker.number is not None:
                self._remove(worker)

    def _remove(self, worker: _Worker) -> None:
        self._workers.remove(worker)
        worker.end()


def _work_on_chunks(path: Path, pipe: Connection[Any, Any]) -> None:
    """Be a worker process."""
    held, before, exchange = dict[int, Chunk](), 0, _Exchange(path)

    def answer(
        generation: int, number: int, chunk: Chunk | None, work: Work, shapes: list[tuple[int, ...]]
    ) -> tuple[tuple[int, ...], Figures] | Exception:
        nonlocal before
        if generation != before:
            held.clear()
            before = generation
        if chunk is not None:
            held[number] = chunk
        result = _result(held[number], work, exchange.take(shapes))
        if isinstance(result, Exception):
            return result
        values, figures = result
        return exchange.put([values])[0], figures

    answer_until_closed(pipe, answer)


def _result(chunk: Chunk, work: Work, stacks: list[Float32s]) -> tuple[Float32s, Figures] | Exception:
    try:
        return work.on(chunk, stacks, 1)
    except Exception as error:  # other than the death of a worker, it would come again elsewhere
        return error


# ---- Dask
class DaskRunner(WorkerRunner):
    """Works on chunks on the workers of a scheduler."""

    def __init__(self, client: Any, at_once: int | None = None) -> None:
        super().__init__()
        self._client, self._at_once = client, at_once
        self._sent: dict[int, Any] = {}  # parts on workers, by the numbers of their chunks
        self._futures: dict[int, Any] = {}  # of the chunks in work; None: the worker is gone
        self._ended = queue.SimpleQueue[tuple[int, Any]]()

    def forget(self) -> None:
        super().forget()
        self._sent.clear()

    def _workers(self) -> list[str]:
        """Return the addresses of workers, once there is one."""
        while not (workers := self._known_workers()):
            self._require_scheduler()
            if self._is_closed:
                raise Cancelled
            time.sleep(_POLL)
        return workers

    def _known_workers(self) -> list[str]:
        try:
            return sorted(self._client.nthreads())
        except (OSError, TimeoutError) as error:
            raise ProcessingError(LOST) from error

    def _require_scheduler(self) -> None:
        if self._client.status not in ("running", "connecting"):
            raise ProcessingError(LOST)

    def _next(self, waiting: Sequence[int], pending: int) -> int | None:
        most = 2 * len(self._workers())  # one in work and one on its way
        return waiting[0] if pending < min(most, self._at_once or most) else None

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
        except (Exception, CancelledError) as error:  # what the work itself raises is its answer
            # Dask raises exceptions of many kinds where a worker dies, so the chunk is tried again after all of them.
            answer, self._cause = None, f": {type(error).__name__}: {error}"
        if answer is None:
            self._sent.pop(number, None)  # it may be what was lost
        yield number, answer

    def _give_up(self) -> None:
        with contextlib.suppress(Exception):  # where the scheduler is gone, nothing is left to be cancelled
            self._client.cancel(
                [future for future in self._futures.values() if future is not None], force=True
            )
        self._futures.clear()


def _do_on_worker(
    chunk: Chunk, job: tuple[Work, list[Float32s]], client_version: str
) -> tuple[Float32s, Figures] | Exception:
    if version("beltrami-cli") != client_version:
        return ProcessingError(f"a worker has version {version('beltrami-cli')}, not {client_version}")
    work, stacks = job
    return _result(chunk, work, [np.array(stack) for stack in stacks])  # what Dask received may be read-only
