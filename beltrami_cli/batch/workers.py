"""Processes that smooth one file at a time; one that dies takes only its file with it.

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

from beltrami_cli.batch.doing import do_job
from beltrami_cli.batch.job import Attempt, failed

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from multiprocessing.connection import Connection
    from multiprocessing.context import SpawnProcess
    from types import FrameType

    from beltrami_cli.batch.job import Job

_PATIENCE = 5.0  # seconds that a process has to tidy up when it is asked to end
_PAUSE = 0.1  # seconds between two messages on progress


class _Ending(BaseException):
    """The worker shall end, or the process that leads it is gone."""


@dataclass
class _Worker:
    process: SpawnProcess
    pipe: Connection[Any, Any]
    key: int = -1


class Workers:
    """Up to a number of processes, to be used as a context; what still runs at its end is stopped.

    Parameters
    ----------
    count : int
        Processes at once.
    memory : int or None
        Bytes that each may take; None: as many as there are.
    threads : int
        For each file.
    """

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
        everybody = [*self._idle, *self._busy.values()]
        for worker in everybody:
            worker.process.terminate()
        deadline = time.monotonic() + _PATIENCE
        for worker in everybody:
            worker.process.join(max(0.0, deadline - time.monotonic()))
            if worker.process.is_alive():
                worker.process.kill()
                worker.process.join()
            worker.pipe.close()

    @property
    def is_full(self) -> bool:
        """Whether every process has something to do."""
        return len(self._busy) >= self._count

    @property
    def is_busy(self) -> bool:
        """Whether any process has something to do."""
        return bool(self._busy)

    def start(self, key: int, job: Job) -> None:
        """Give a job to a process that has none."""
        while True:
            worker = self._idle.pop() if self._idle else self._hire()
            try:
                worker.pipe.send((job, self._memory))
                break
            except OSError:  # it died while it had nothing to do
                worker.process.join()
        worker.key = key
        self._busy[worker.pipe] = worker

    def answers(self, jobs: Callable[[int], Job]) -> Iterator[tuple[int, Attempt | tuple[str, int, int]]]:
        """Wait, and give what processes tell: of a key either how far it is, or what came of it.

        Parameters
        ----------
        jobs : callable
            Gives the job of a key.
        """
        for pipe in wait(list(self._busy)):
            worker = self._busy[cast("Connection[Any, Any]", pipe)]
            try:
                told: Attempt | tuple[str, int, int] = worker.pipe.recv()
            except (EOFError, OSError):
                told = self._bury(worker, jobs(worker.key))
            else:
                if isinstance(told, Attempt):
                    self._idle.append(self._busy.pop(worker.pipe))
            yield worker.key, told

    def _hire(self) -> _Worker:
        ours, theirs = self._context.Pipe()
        process = self._context.Process(target=_work, args=(theirs,), daemon=True)
        process.start()
        theirs.close()  # so that the end of the process is the end of the pipe
        return _Worker(process, ours)

    def _bury(self, worker: _Worker, job: Job) -> Attempt:
        self._busy.pop(worker.pipe).pipe.close()
        worker.process.join()
        code = worker.process.exitcode or 0
        how = f"by signal {-code}" if code < 0 else f"with code {code}"
        cause = f"{job.source}: the process that worked on it ended {how}; there may be too little memory"
        return Attempt(failed(job, cause, 1), wants_memory=True)


def _work(pipe: Connection[Any, Any]) -> None:
    """Be a worker: do what comes through the pipe until it is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all; who leads decides
    signal.signal(signal.SIGTERM, _end)
    last = 0.0

    def progress(label: str, done: int, total: int) -> None:
        nonlocal last
        if time.monotonic() - last >= _PAUSE:
            last = time.monotonic()
            _tell(pipe, (label, done, total))

    with contextlib.suppress(EOFError, ConnectionError, _Ending):
        while True:
            job, memory = pipe.recv()
            _tell(pipe, do_job(job, memory, progress))


def _tell(pipe: Connection[Any, Any], message: object) -> None:
    try:
        pipe.send(message)
    except OSError:  # Nobody is left to work for, and no error of a file.
        raise _Ending from None


def _end(number: int, frame: FrameType | None) -> NoReturn:
    sys.exit(128 + number)
