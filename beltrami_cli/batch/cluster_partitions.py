"""Partitions of one surface on the workers of a Dask scheduler.

Between iterations each borrows values from others, from worker to worker. If a worker dies, what it held is gone, and
the surface is begun again on the others.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from operator import attrgetter
from typing import Any

from beltrami_cli.arrays import Float32s, Int64s
from beltrami_cli.batch.cluster import LOST, Cancelled
from beltrami_cli.batch.item import Attempt, Item, do_item
from beltrami_cli.batch.run import Executor
from beltrami_cli.errors import ProcessingError
from beltrami_cli.flow.beltrami_flow import in_partitions
from beltrami_cli.flow.partitions import (
    Advance,
    Joined,
    Partition,
    TooNarrowError,
    Transfer,
    collect,
    joined,
    plan_transfers,
)
from beltrami_cli.jobs.job import at_intervals

Progress = Callable[[int, int], None] | None

_TRIES = 5  # of a surface, after workers died
_NOTICE = (
    2.0  # seconds in which the scheduler hears of a worker that died: its connections are closed at once
)
_POLL = 0.1  # seconds between two questions for its workers
_PAUSE = 0.1  # seconds between two messages on progress
_GRACE = 5.0  # seconds that a file has to end when it is given up


class PartitionExecutor(Executor):
    """Does one file at a time here, and has `count` partitions of each surface smoothed by workers."""

    def __init__(self, client: Any, count: int, memory: int | None) -> None:
        self._runner, self._count, self._memory = ClusterRunner(client), count, memory
        self._events: queue.SimpleQueue[tuple[int, Attempt | tuple[str, int, int]]] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self._ended = threading.Event()

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        if self._thread is not None:
            self._thread.join(_GRACE)  # it may wait for workers that never come

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
        tell = at_intervals(_PAUSE, lambda *event: self._events.put((key, event)))

        def progress(label: str, done: int, total: int) -> None:
            if self._ended.is_set():
                raise Cancelled
            tell(label, done, total)

        try:
            with in_partitions(self._count, self._runner):
                self._events.put((key, do_item(item, self._memory, progress, is_alone=False)))
        except Cancelled:
            pass


@dataclass(frozen=True)
class _Portion:
    """A partition, what it borrows, and the version of the program that cut it, as they are sent to a worker."""

    partition: Partition
    transfers: list[Transfer]
    version: str


class ClusterRunner:
    """Runs partitions on workers; a `Runner`, which raises ProcessingError if workers die again and again."""

    def __init__(self, client: Any) -> None:
        self._client = client
        self._places: list[str] = []  # the worker of each partition

    def run(
        self, partitions: Sequence[Partition], values: Float32s, iterations: int, progress: Progress
    ) -> Joined:
        from distributed import CancelledError, KilledWorker

        for _ in range(_TRIES):
            self._require_scheduler(None)
            try:
                return self._run(partitions, values, iterations, progress)
            except (ProcessingError, TooNarrowError):
                raise
            except (CancelledError, KilledWorker) as error:
                last: Exception = error
            except (
                Exception
            ) as error:  # Dask raises many kinds when a worker dies, KeyError and OSError among them
                self._require_scheduler(error)
                if not self._has_lost_worker():
                    raise
                last = error
        said = " ".join(f"{type(last).__name__}: {last}".split())
        cause = f"workers died {_TRIES} times with pieces of the surface ({said})"
        raise ProcessingError(f"{cause}; there may be too little memory there")

    def _require_scheduler(self, error: Exception | None) -> None:
        if self._client.status != "running":
            raise ProcessingError(LOST) from error

    def _has_lost_worker(self) -> bool:
        """Whether a worker with a partition is gone."""
        deadline = time.monotonic() + _NOTICE
        while self._client.nthreads().keys() >= set(self._places):
            if time.monotonic() > deadline:
                return False
            time.sleep(_POLL)
        return True

    def _run(
        self, partitions: Sequence[Partition], values: Float32s, iterations: int, progress: Progress
    ) -> Joined:
        while not (workers := sorted(self._client.nthreads())):
            self._client.wait_for_workers(1)
        self._places = places = [
            workers[number % len(workers)] for number in range(len(partitions))
        ]  # in turn
        transfers, own_version = plan_transfers(partitions, len(values)), version("beltrami-cli")
        sent, steps = [], []
        for partition, plan, place in zip(partitions, transfers, places, strict=True):
            sent.append(self._send(_Portion(partition, plan, own_version), place))
            steps.append(self._send(Advance(values[partition.owned], 0, 0), place))
        samples, truncated = 0.0, 0
        for iteration in range(iterations):
            # Small arrays, so that a worker is sent no more of a partition than it needs.
            received = [
                [self._submit(_rows_of, steps[transfer.source], transfer.rows) for transfer in plan]
                for plan in transfers
            ]
            steps = [
                self._submit(
                    _advance, sent[number], steps[number], received[number], iteration, values.shape[1],
                    workers=[places[number]], allow_other_workers=True,
                )
                for number in range(len(partitions))
            ]  # fmt: skip
            counts = self._wait(steps, iteration, iterations, progress)
            samples += sum(each[0] for each in counts)
            truncated += sum(each[1] for each in counts)
        own = self._client.gather([self._submit(attrgetter("values"), step) for step in steps])
        return Joined(joined(partitions, own, values), samples, truncated)

    def _wait(
        self, steps: Sequence[Any], iteration: int, iterations: int, progress: Progress
    ) -> list[tuple[float, int]]:
        """Wait for an iteration; return the samples held and the kernels cut short of every partition."""
        from distributed import as_completed

        counts = [self._submit(attrgetter("samples", "truncated", "is_exact"), step) for step in steps]
        ended = as_completed(counts, with_results=True, loop=self._client.loop)
        for number, (_, held) in enumerate(ended, 1):
            if isinstance(held, Exception):  # as Dask gives what was lost with a worker
                raise held
            _, _, is_exact = held
            if not is_exact:
                raise TooNarrowError
            if progress is not None:
                progress(iteration * len(steps) + number, iterations * len(steps))
        return [(samples, truncated) for samples, truncated, _ in self._client.gather(counts)]

    def _send(self, value: Any, place: str) -> Any:
        return self._client.scatter(value, workers=[place], hash=False)

    def _submit(self, function: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
        return self._client.submit(function, *arguments, pure=False, **options)


def _advance(sent: _Portion, step: Advance, received: list[Float32s], iteration: int, width: int) -> Advance:
    if version("beltrami-cli") != sent.version:
        raise ProcessingError(f"a worker has version {version('beltrami-cli')}, not {sent.version}")
    borrowed = collect(sent.transfers, received, width)
    return sent.partition.advance(step.values, borrowed, iteration, sent.partition.threads or 1)


def _rows_of(step: Advance, rows: Int64s) -> Float32s:
    return step.values[rows]
