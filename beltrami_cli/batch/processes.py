"""Worker processes of this machine.

The pool of the standard library fails everything when a process dies, as it does when the system runs out of memory.
Each worker has a pipe to the process that leads, which alone decides, in one thread; one that dies loses only its task.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
import time
from collections.abc import Callable, Collection, Iterator
from multiprocessing.connection import wait
from typing import Any

from beltrami_cli.batch.pool import Advance, Lost, Pool, Task
from beltrami_cli.batch.worker import Channel, Order, serve
from beltrami_cli.errors import ProcessingError
from beltrami_cli.formats.image.opening import scratch_file

_TERMINATION_TIMEOUT = 5.0  # seconds: enough to remove files that were not finished


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
        self.key, self.kept = -1, set[int]()  # of the task in work, and of parts

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
            new_part = part() if part is not None and key not in worker.kept else None
            part_key = None if part is None else key
            try:
                worker.channel.send(Order(task, arguments, part_key, new_part, frozenset(worker.kept)))
                break
            except ConnectionError:  # it died while it was idle
                self._idle.pop().end()
            except OSError as error:
                cause = f"there is no room for a piece in work ({error.strerror})"
                raise ProcessingError(f"{cause}; lower --jobs, or raise --pieces") from error
        worker.key = key
        if part is not None:
            worker.kept.add(key)
        self._busy.append(self._idle.pop())

    def events(self) -> Iterator[tuple[int, Any]]:
        ready = wait([worker.channel.pipe for worker in self._busy])
        for worker in [worker for worker in self._busy if worker.channel.pipe in ready]:
            try:
                event = worker.channel.receive()
            except (EOFError, OSError):
                self._busy.remove(worker)
                event = _lost(worker)
            else:
                if not isinstance(event, Advance):
                    self._busy.remove(worker)
                    self._idle.append(worker)
            yield worker.key, event

    def kept(self) -> Collection[int]:
        return self._idle[-1].kept if self._idle else ()

    def forget(self) -> None:
        for worker in self._idle:
            worker.kept.clear()

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
