"""Files one after the other, each with its surfaces in pieces on the workers."""

from __future__ import annotations

import queue
import threading
import time
from typing import TYPE_CHECKING, Any

from beltrami_cli.batch.cluster.pieces import OnCluster
from beltrami_cli.batch.doing import do_job
from beltrami_cli.batch.job import Attempt
from beltrami_cli.flow.partitions import in_partitions

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from beltrami_cli.batch.job import Job

_PAUSE = 0.1  # seconds between two messages on progress
_PATIENCE = 5.0  # seconds that a file has to be given up


class _GivenUp(BaseException):
    """Nobody wants the result any more."""


class SplittingCrew:
    """Reads, cuts, joins and writes every file on this machine, and has its pieces smoothed by workers; a `Crew`.

    Parameters
    ----------
    client : distributed.Client
        Connected.
    count : int
        Pieces of every surface.
    memory : int or None
        Bytes for a file on this machine.
    """

    queues = False
    threads: int | None = None

    def __init__(self, client: Any, count: int, memory: int | None) -> None:
        self._runner, self._count, self._memory = OnCluster(client), count, memory
        self._told: queue.SimpleQueue[tuple[int, Attempt | tuple[str, int, int]]] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self._ended = threading.Event()

    def __enter__(self) -> SplittingCrew:
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        if self._thread is not None:
            self._thread.join(_PATIENCE)  # it waits for workers, of which there may be none

    @property
    def is_full(self) -> bool:
        """Whether a file is in work."""
        return self._thread is not None

    @property
    def is_busy(self) -> bool:
        """The same."""
        return self._thread is not None

    def start(self, key: int, job: Job) -> None:
        """Begin with a file, in a thread, so that progress can be told of it."""
        self._thread = threading.Thread(target=self._do, args=(key, job), daemon=True)
        self._thread.start()

    def answers(self, jobs: Callable[[int], Job]) -> Iterator[tuple[int, Attempt | tuple[str, int, int]]]:
        """Wait, and tell of a key either how far it is, or what came of it."""
        key, told = self._told.get()
        if isinstance(told, Attempt) and self._thread is not None:
            self._thread.join()
            self._thread = None
        yield key, told

    def _do(self, key: int, job: Job) -> None:
        last = 0.0

        def progress(label: str, done: int, total: int) -> None:
            nonlocal last
            if self._ended.is_set():
                raise _GivenUp
            if time.monotonic() - last >= _PAUSE:
                last = time.monotonic()
                self._told.put((key, (label, done, total)))

        try:
            with in_partitions(self._count, self._runner):
                self._told.put((key, do_job(job, self._memory, progress, is_alone=False)))
        except _GivenUp:
            pass
