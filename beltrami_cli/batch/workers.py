"""Processes that smooth one file at a time; one that dies fails only its own file.

The pool of the standard library fails everything when a process dies, as it does when the system runs out of memory.
Here each has a pipe of its own to the process that leads, which alone decides, in one thread.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
import sys
import time
from dataclasses import dataclass
from multiprocessing.connection import wait
from typing import TYPE_CHECKING, Any, NoReturn, cast

from beltrami_cli.batch.item import Attempt, do_item, failed

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from multiprocessing.connection import Connection
    from multiprocessing.context import SpawnProcess
    from types import FrameType

    from beltrami_cli.batch.item import Item

_GRACE = 5.0  # seconds that a process has to clean up when it is asked to end
_PAUSE = 0.1  # seconds between two messages on progress


class _Stopped(BaseException):
    """The process that this one works for is gone."""


@dataclass
class _Worker:
    process: SpawnProcess
    pipe: Connection[Any, Any]
    key: int = -1


class Workers:
    """Up to `count` processes, each with `memory` bytes, as an `Executor`; what still runs at its end is stopped."""

    queues = False

    def __init__(self, count: int, memory: int | None, threads: int) -> None:
        self._count, self._memory = count, memory
        self.threads: int | None = threads
        self._idle: list[_Worker] = []
        self._busy: dict[Connection[Any, Any], _Worker] = {}
        self._context = multiprocessing.get_context("spawn")  # a fork would copy locks of threads as they are

    def __enter__(self) -> Workers:
        return self

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

    @property
    def is_busy(self) -> bool:
        return bool(self._busy)

    def start(self, key: int, item: Item) -> None:
        while True:
            worker = self._idle.pop() if self._idle else self._start_process()
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

    def _start_process(self) -> _Worker:
        ours, theirs = self._context.Pipe()
        process = self._context.Process(target=_work, args=(theirs,), daemon=True)
        with _without_interrupts():
            process.start()
        theirs.close()  # so that the pipe ends with the process
        return _Worker(process, ours)

    def _remove_dead(self, worker: _Worker, item: Item) -> Attempt:
        self._busy.pop(worker.pipe).pipe.close()
        worker.process.join()
        code = worker.process.exitcode or 0
        how = f"by signal {-code}" if code < 0 else f"with code {code}"
        cause = f"{item.source}: the process that worked on it ended {how}; there may be too little memory"
        return Attempt(failed(item, cause, 1), wants_memory=True)


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
    """Be a worker: do what comes through the pipe until it is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all; who leads decides
    signal.signal(signal.SIGTERM, _end)
    last = 0.0

    def progress(label: str, done: int, total: int) -> None:
        nonlocal last
        if time.monotonic() - last >= _PAUSE:
            last = time.monotonic()
            _send(pipe, (label, done, total))

    with contextlib.suppress(EOFError, ConnectionError, _Stopped):
        while True:
            item, memory = pipe.recv()
            _send(pipe, do_item(item, memory, progress))


def _send(pipe: Connection[Any, Any], message: object) -> None:
    try:
        pipe.send(message)
    except OSError:  # the other end is closed, which is no error of a file
        raise _Stopped from None


def _end(number: int, frame: FrameType | None) -> NoReturn:
    sys.exit(128 + number)
