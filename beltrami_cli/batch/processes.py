"""Worker processes of this machine.

The pool of the standard library fails everything when a process dies, as it does when the system runs out of memory.
Each worker has a pipe to the process that leads, which alone decides, in one thread; one that dies loses only its task.
"""

from __future__ import annotations

import contextlib
import copy
import mmap
import multiprocessing
import os
import pickle
import signal
import sys
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from beltrami_cli.batch.pool import Lost, Pool, Task
from beltrami_cli.errors import ProcessingError
from beltrami_cli.formats.image.opening import scratch_file
from beltrami_cli.jobs.progress import at_intervals
from beltrami_cli.signals import end_with_parent, unhandled_signals

_TERMINATION_TIMEOUT = 5.0  # seconds: enough to remove files that were not finished
_PROGRESS_INTERVAL = 0.1  # seconds between two messages on progress
_ALIGNMENT = 64  # bytes: arrays begin at multiples of it, as C++ may ask of them


@dataclass(frozen=True)
class Order:
    """A task for a worker process; its part, if it has one, is its first argument."""

    task: Task
    arguments: tuple[Any, ...] = ()
    key: int | None = None  # of its part; None: no part
    made: Any = None  # the part, unless the worker has it from an earlier order
    kept: frozenset[int] = frozenset()  # keys of the parts that the worker continues to keep


class Channel:
    """Messages between two processes, with arrays in a file that both map: a pipe would copy them four times."""

    def __init__(self, pipe: Connection[Any, Any], path: Path) -> None:
        self.pipe, self._path, self._pages = pipe, path, memoryview(b"")

    def send(self, message: object) -> None:
        """Send a message; arrays that are not contiguous go through the pipe."""
        buffers: list[pickle.PickleBuffer] = []
        head = pickle.dumps(message, 5, buffer_callback=buffers.append)
        contents = [buffer.raw() for buffer in buffers]
        sizes = [content.nbytes for content in contents]
        for content, place in zip(contents, self._places(sizes), strict=True):
            place[:] = content
        self.pipe.send((head, sizes))

    def receive(self) -> Any:
        """Receive a message; its arrays are valid until the next one, in either direction."""
        head, sizes = self.pipe.recv()
        return pickle.loads(head, buffers=self._places(sizes))

    def _places(self, sizes: Sequence[int]) -> list[memoryview]:
        """Return the offsets in the file of arrays with these sizes in bytes."""
        *begins, end = accumulate((size + -size % _ALIGNMENT for size in sizes), initial=0)
        if end > len(self._pages):
            with self._path.open("r+b") as file:
                if hasattr(os, "posix_fallocate"):
                    # Reserves the space: otherwise a full disk would kill the process when it writes a page.
                    os.posix_fallocate(file.fileno(), 0, end)
                else:
                    file.truncate(end)
                self._pages = memoryview(mmap.mmap(file.fileno(), 0))
        return [self._pages[begin : begin + size] for begin, size in zip(begins, sizes, strict=True)]


class _Worker:
    """A worker process, seen from the leading process."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")  # a fork would copy locks that other threads hold
        self._file = contextlib.ExitStack()
        path = self._file.enter_context(scratch_file())
        ours, theirs = context.Pipe()
        self.process = context.Process(target=serve, args=(theirs, path), daemon=True)
        with _without_interrupts():
            self.process.start()
        theirs.close()  # so that the pipe closes when the process ends
        self.channel = Channel(ours, path)
        self.key, self.held = -1, set[int]()  # of the task in work, and of parts

    def end(self, seconds: float | None = 0) -> None:
        """End the process within some seconds; None: wait until it ends by itself."""
        self.process.join(seconds)
        self.process.kill()
        self.process.join()
        self.channel.pipe.close()
        self._file.close()


class Processes(Pool):
    """Worker processes of this machine; one that died is replaced when it is needed."""

    def __init__(self, count: int) -> None:
        self._count, self._busy = count, list[_Worker]()
        self._idle = [_Worker() for _ in range(count)]

    @property
    def is_full(self) -> bool:
        return len(self._busy) >= self._count

    def start(self, key: int, task: Task, *arguments: Any, part: Callable[[], Any] | None = None) -> None:
        while True:
            if not self._idle:
                self._idle.append(_Worker())
            worker = self._idle[-1]
            made = part() if part is not None and key not in worker.held else None
            try:
                of_part = None if part is None else key
                worker.channel.send(Order(task, arguments, of_part, made, frozenset(worker.held)))
                break
            except ConnectionError:  # it died while it was idle
                self._idle.pop().end()
            except OSError as error:
                cause = f"there is no room for a piece in work ({error.strerror})"
                raise ProcessingError(f"{cause}; lower --jobs, or raise --pieces") from error
        worker.key = key
        if part is not None:
            worker.held.add(key)
        self._busy.append(self._idle.pop())

    def events(self) -> Iterator[tuple[int, Any]]:
        ready = wait([worker.channel.pipe for worker in self._busy])
        for worker in [worker for worker in self._busy if worker.channel.pipe in ready]:
            try:
                is_done, event = worker.channel.receive()
            except (EOFError, OSError):
                self._busy.remove(worker)
                event = _lost(worker)
            else:
                if is_done:
                    self._busy.remove(worker)
                    self._idle.append(worker)
            yield worker.key, event

    def held(self) -> Collection[int]:
        return self._idle[-1].held if self._idle else ()

    def forget(self) -> None:
        for worker in self._idle:
            worker.held.clear()

    def give_up(self) -> None:
        for worker in self._busy:
            worker.end()
        self._busy.clear()

    def close(self) -> None:
        workers, deadline = [*self._idle, *self._busy], time.monotonic() + _TERMINATION_TIMEOUT
        for worker in workers:
            worker.process.terminate()
        for worker in workers:
            worker.end(max(0.0, deadline - time.monotonic()))


def _lost(worker: _Worker) -> Lost:
    worker.end(None)
    code = worker.process.exitcode or 0
    how = f"by signal {-code}" if code < 0 else f"with code {code}"
    return Lost(f"the process that worked on it ended {how}; there may be too little memory", True)


@contextlib.contextmanager
def _without_interrupts() -> Iterator[None]:
    """Block Ctrl-C, which reaches all processes, in new ones until they have loaded their modules."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # starting it later would unblock the signal
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


# ---- in a worker process
def serve(pipe: Connection[Any, Any], path: Path) -> None:
    """Run the tasks from a channel until it is closed."""
    for number in unhandled_signals():
        signal.signal(number, lambda number, _: sys.exit(128 + number))
    if (leader := multiprocessing.parent_process()) is not None and leader.pid is not None:
        end_with_parent(leader.pid, signal.SIGTERM)  # a signal on which it removes its files
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes; the leading one decides
    channel, cached = Channel(pipe, path), dict[int, Any]()

    def report(*event: object) -> None:
        try:
            channel.send((False, event))
        except ConnectionError:  # the leading process is gone, which is not an error of the task
            sys.exit()

    progress = at_intervals(_PROGRESS_INTERVAL, report)
    with contextlib.suppress(EOFError, ConnectionError):
        while True:
            order: Order = channel.receive()
            cached = {key: cached[key] for key in order.kept}
            if order.key is not None and order.made is not None:
                cached[order.key] = copy.deepcopy(
                    order.made
                )  # the arrays of a message are valid until the next one
            parts = () if order.key is None else (cached[order.key],)
            channel.send((True, order.task(*parts, *order.arguments, progress)))
