"""Smooth many files at once, whatever happens to some of them, in processes that do one file at a time.

The pool of the standard library fails everything when a process dies, as it does when the system runs out of memory.
Here each has a pipe of its own to the process that leads, which alone decides, in one thread; one that dies fails only
its own file.
"""

from __future__ import annotations

import contextlib
import dataclasses
import multiprocessing
import signal
import sys
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from types import FrameType
from typing import Any, NoReturn, Protocol, Self, cast

from beltrami_cli.batch.item import (
    Attempt,
    Item,
    Outcome,
    Record,
    do_item,
    failed,
    is_done,
    is_ours,
    outcome_of,
)
from beltrami_cli.batch.storage import exists, make_folder_of
from beltrami_cli.errors import OutputError, unhandled_endings
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.jobs.job import at_intervals

_GRACE = 5.0  # seconds that a process has to clean up when it is asked to end
_PAUSE = 0.1  # seconds between two messages on progress


class Watcher(Protocol):
    """Shows how a batch goes; a key is the place of an item in it."""

    def started(self, key: int) -> None: ...
    def advanced(self, key: int, label: str, done: int, total: int) -> None: ...
    def postponed(self, key: int) -> None: ...  # to the end, when it is tried alone with all memory
    def finished(self, key: int, attempt: Attempt) -> None: ...


class Executor(ABC):
    """Does items, to be used as a context; items still in work at its end are given up."""

    threads: int | None = None  # for each file whose settings leave it open; None: as many as there are
    queues = False  # whether items may wait after `start`; then a file begins with its first progress

    def __enter__(self) -> Self:
        return self

    @abstractmethod
    def __exit__(self, *error: object) -> None: ...

    @property
    @abstractmethod
    def is_full(self) -> bool:
        """Whether it takes no more items for now."""

    @abstractmethod
    def start(self, key: int, item: Item) -> None: ...

    @abstractmethod
    def events(self, items: Callable[[int], Item]) -> Iterator[tuple[int, Attempt | tuple[str, int, int]]]:
        """Wait, and give for a key either its progress or its result; `items` gives the item of a key."""


class Batch:
    """Files that are smoothed as by `smooth_file`, but for what `record` says to be done, and still holds."""

    def __init__(
        self, items: Sequence[Item], record: Record, watcher: Watcher, *, fail_fast: bool = False
    ) -> None:
        self._items, self._record, self._watcher = items, record, watcher
        self._fail_fast, self._stopped = fail_fast, False
        self._earlier = [record.latest(item) for item in items]
        self._outcomes: dict[int, Outcome] = {}
        self._writers: dict[str, tuple[int, str]] = {}  # who wrote a file, and its hash

    def run(self, at_once: int, memory: int | None, executor: Executor | None = None) -> list[Outcome]:
        """Return one outcome an item, in their order; without an executor by `at_once` processes at a time.

        Each has an equal share of `memory` (bytes); what that is not enough for is done alone at the end, with all.
        """
        waiting: deque[int] = deque()
        for key, (item, earlier) in enumerate(zip(self._items, self._earlier, strict=True)):
            if earlier is not None and is_done(item, earlier):
                self._finish(key, Attempt(dataclasses.replace(earlier, status="skipped")))
            else:
                waiting.append(key)
        if executor is not None:
            self._work(waiting, executor, is_last=True)
        else:
            count = max(1, min(at_once, len(waiting)))
            share = None if memory is None else memory // count
            threads = KernelParameters().thread_count
            larger = self._work(waiting, Workers(count, share, max(1, threads // count)), is_last=count == 1)
            self._work(larger, Workers(1, memory, threads), is_last=True)
        for key in set(range(len(self._items))) - self._outcomes.keys():  # left undone by --fail-fast
            written = _written(self._earlier[key])
            self._outcomes[key] = outcome_of(self._items[key], "not started", written=written)
        outcomes = [self._outcomes[key] for key in range(len(self._items))]
        self._record.close(outcomes)
        return outcomes

    def _work(self, waiting: deque[int], executor: Executor, *, is_last: bool) -> deque[int]:
        """Do what waits; return what wants more memory, unless `is_last`."""
        larger: deque[int] = deque()
        in_work = set[int]()
        with executor as workers:
            while not self._stopped and (waiting or in_work):
                while waiting and not workers.is_full and not self._stopped:
                    in_work |= self._started(waiting.popleft(), workers)
                for key, event in workers.events(self._items.__getitem__) if in_work else ():
                    if not isinstance(event, Attempt):
                        self._watcher.advanced(key, *event)
                        continue
                    in_work.discard(key)
                    if event.wants_memory and not is_last:
                        self._watcher.postponed(key)
                        larger.append(key)
                    else:
                        self._finish(key, event)
        return larger

    def _started(self, key: int, executor: Executor) -> set[int]:
        """Begin with an item; return it, unless it failed already."""
        item, earlier = self._items[key], self._earlier[key]
        overwrite = item.overwrite or is_ours(earlier)
        # By an earlier run, or by this one in a process that died.
        latest = self._record.latest(item)
        again = latest is not None and latest.status == "started"
        try:
            if exists(item.target) and not (overwrite or again):
                remedy = "choose another --out-dir or --suffix, or --overwrite"
                raise OutputError(item.target, "exists already", remedy)
            make_folder_of(item.target)
        except OutputError as error:
            self._finish(key, Attempt(failed(item, str(error), error.exit_code)))
            return set()
        if item.settings.kernel.threads is None:
            kernel = dataclasses.replace(item.settings.kernel, threads=executor.threads)
            item = dataclasses.replace(item, settings=dataclasses.replace(item.settings, kernel=kernel))
        self._record.add(outcome_of(item, "started", written=_written(earlier)))
        executor.start(key, dataclasses.replace(item, overwrite=overwrite, again=again))
        if not executor.queues:
            self._watcher.started(key)
        return {key}

    def _finish(self, key: int, attempt: Attempt) -> None:
        outcome = self._checked(key, attempt.outcome)
        earlier = self._earlier[key]
        if outcome.status == "failed":
            outcome = dataclasses.replace(outcome, written=_written(earlier))
            self._stopped = self._stopped or self._fail_fast
        self._outcomes[key] = outcome
        self._record.add(outcome)
        self._watcher.finished(key, dataclasses.replace(attempt, outcome=outcome))

    def _checked(self, key: int, outcome: Outcome) -> Outcome:
        """Fail an item that wrote over what another one has written, such as a texture of the same name."""
        if outcome.status == "failed":
            return outcome
        for name, digest in outcome.written.items():
            other, theirs = self._writers.setdefault(name, (key, digest))
            if theirs != digest:
                cause = f"{name} is of {self._items[other].source}, too, with another content"
                remedy = "give them different folders as OUTPUT, in a manifest"
                error = OutputError(self._items[key].source, cause, remedy)
                return failed(self._items[key], str(error), error.exit_code, outcome.seconds)
        return outcome


def _written(earlier: Outcome | None) -> dict[str, str]:
    """Return the files of an earlier run, which are still there if a later attempt fails or is cut off."""
    return {} if earlier is None else earlier.written


class _Stopped(BaseException):
    """The process that this one works for is gone."""


@dataclass
class _Worker:
    process: SpawnProcess
    pipe: Connection[Any, Any]
    key: int = -1


class Workers(Executor):
    """Up to `count` processes, each with `memory` bytes; what still runs at its end is stopped."""

    def __init__(self, count: int, memory: int | None, threads: int) -> None:
        self._count, self._memory, self.threads = count, memory, threads
        self._idle: list[_Worker] = []
        self._busy: dict[Connection[Any, Any], _Worker] = {}

    def __exit__(self, *_: object) -> None:
        workers = [*self._idle, *self._busy.values()]
        for worker in workers:
            worker.process.terminate()
        deadline = time.monotonic() + _GRACE
        for worker in workers:
            worker.process.join(max(0.0, deadline - time.monotonic()))
            if worker.process.is_alive():
                worker.process.kill()
                worker.process.join()
            worker.pipe.close()

    @property
    def is_full(self) -> bool:
        return len(self._busy) >= self._count

    def start(self, key: int, item: Item) -> None:
        while True:
            worker = self._idle.pop() if self._idle else _Worker(*start_worker(_work))
            try:
                worker.pipe.send((item, self._memory))
                break
            except OSError:  # it died while it had nothing to do
                worker.process.join()
        worker.key = key
        self._busy[worker.pipe] = worker

    def events(self, items: Callable[[int], Item]) -> Iterator[tuple[int, Attempt | tuple[str, int, int]]]:
        for pipe in wait(list(self._busy)):
            worker = self._busy[cast("Connection[Any, Any]", pipe)]
            try:
                event: Attempt | tuple[str, int, int] = worker.pipe.recv()
            except (EOFError, OSError):
                event = self._remove_dead(worker, items(worker.key))
            else:
                if isinstance(event, Attempt):
                    self._idle.append(self._busy.pop(worker.pipe))
            yield worker.key, event

    def _remove_dead(self, worker: _Worker, item: Item) -> Attempt:
        self._busy.pop(worker.pipe).pipe.close()
        worker.process.join()
        code = worker.process.exitcode or 0
        how = f"by signal {-code}" if code < 0 else f"with code {code}"
        cause = f"{item.source}: the process that worked on it ended {how}; there may be too little memory"
        return Attempt(failed(item, cause, 1), wants_memory=True)


def start_worker(work: Callable[[Connection[Any, Any]], None]) -> tuple[SpawnProcess, Connection[Any, Any]]:
    """Start a process that is called with one end of a pipe; return it with the other end."""
    context = multiprocessing.get_context("spawn")  # a fork would copy locks of threads as they are
    ours, theirs = context.Pipe()
    process = context.Process(target=work, args=(theirs,), daemon=True)
    with _without_interrupts():
        process.start()
    theirs.close()  # so that the pipe ends with the process
    return process, ours


@contextlib.contextmanager
def _without_interrupts() -> Iterator[None]:
    """Start processes that Ctrl-C, which reaches all, does not end with a traceback while they load their modules."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # which would let the signal through again when it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _work(pipe: Connection[Any, Any]) -> None:
    """Be a worker for files."""
    progress = at_intervals(_PAUSE, lambda *event: _send(pipe, event))
    answer_until_closed(pipe, lambda item, memory: do_item(item, memory, progress))


def answer_until_closed(pipe: Connection[Any, Any], answer: Callable[..., object]) -> None:
    """Answer the arguments that come through a pipe until it is closed."""
    for number in unhandled_endings():
        signal.signal(number, _end)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all; who leads decides
    with contextlib.suppress(EOFError, ConnectionError, _Stopped):
        while True:
            _send(pipe, answer(*pipe.recv()))


def _send(pipe: Connection[Any, Any], message: object) -> None:
    try:
        pipe.send(message)
    except OSError:  # the other end is closed, which is no error of a file
        raise _Stopped from None


def _end(number: int, frame: FrameType | None) -> NoReturn:
    sys.exit(128 + number)
