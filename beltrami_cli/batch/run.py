"""Smooth many files, also if some of them fail, several at a time in workers."""

from __future__ import annotations

import contextlib
import dataclasses
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from beltrami_cli.batch.item import Attempt, Item, Outcome, failed, outcome_of
from beltrami_cli.batch.pool import Advance, Lost, Pool
from beltrami_cli.batch.processes import Processes
from beltrami_cli.batch.record import Record, is_done, is_own_output
from beltrami_cli.batch.storage import exists, make_folder_of
from beltrami_cli.batch.work import do_item
from beltrami_cli.errors import OutputError
from beltrami_cli.flow.parameters import KernelParameters


class Watcher(Protocol):
    """Shows the progress of a batch; keys are indices of its items."""

    def advanced(self, key: int, label: str, done: float, total: float) -> None: ...
    def postponed(self, key: int) -> None: ...  # to the end, when it is tried alone with the whole memory
    def finished(self, key: int, attempt: Attempt) -> None: ...


@dataclass(frozen=True)
class Workers:
    """A pool of workers for whole files: `call` returns the task of an item and its arguments."""

    pool: Pool
    call: Callable[[Item], tuple[Any, ...]]
    threads: int | None = None  # for each file without this setting; None: all processors
    has_all_memory: bool = True  # whether a file that needs more memory than it has would fail anywhere


Pass = Callable[[int], Workers]  # returns the workers for a number of files


class Batch:
    """Smooths files as `smooth_file` does, except those whose results in `record` are still valid."""

    def __init__(
        self, items: Sequence[Item], record: Record, watcher: Watcher, *, fail_fast: bool = False
    ) -> None:
        self._items, self._record, self._watcher = items, record, watcher
        self._fail_fast, self._stopped = fail_fast, False
        self._earlier = [record.latest(item) for item in items]  # outcomes of an earlier run
        self._outcomes: dict[int, Outcome] = {}
        self._writers: dict[str, tuple[int, str]] = {}  # by file: the item that wrote it, and its hash

    def run(self, passes: Iterable[Pass]) -> list[Outcome]:
        """Return the outcomes of the items, in their order; a pass does what needed more memory in the one before."""
        waiting = self._unfinished()
        for workers_for in passes:
            if waiting:
                waiting = self._work(waiting, workers_for(len(waiting)))
        for key in set(range(len(self._items))) - self._outcomes.keys():  # not tried because of --fail-fast
            written = _written(self._earlier[key])
            self._outcomes[key] = outcome_of(self._items[key], "not started", written=written)
        outcomes = [self._outcomes[key] for key in range(len(self._items))]
        self._record.close(outcomes)
        return outcomes

    def _unfinished(self) -> deque[int]:
        """Finish the items that an earlier run has done, and return the others."""
        waiting: deque[int] = deque()
        for key, (item, earlier) in enumerate(zip(self._items, self._earlier, strict=True)):
            if earlier is not None and is_done(item, earlier):
                self._finish(key, Attempt(dataclasses.replace(earlier, status="skipped")))
            else:
                waiting.append(key)
        return waiting

    def _work(self, waiting: deque[int], workers: Workers) -> deque[int]:
        """Run the waiting items; return the items that need more memory, if others have more."""
        larger: deque[int] = deque()
        in_work = set[int]()
        with contextlib.closing(workers.pool) as pool:
            while not self._stopped and (waiting or in_work):
                while waiting and not pool.is_full and not self._stopped:
                    key = waiting.popleft()
                    if self._start(key, workers):
                        in_work.add(key)
                for key, event in pool.events() if in_work else ():
                    if isinstance(event, Advance):
                        self._watcher.advanced(key, event.label, event.done, event.total)
                        continue
                    in_work.discard(key)
                    attempt = self._lost(key, event) if isinstance(event, Lost) else event
                    if attempt.wants_memory and not workers.has_all_memory:
                        self._watcher.postponed(key)
                        larger.append(key)
                    else:
                        self._finish(key, attempt)
        return larger

    def _lost(self, key: int, lost: Lost) -> Attempt:
        item = self._items[key]
        return Attempt(failed(item, f"{item.source}: {lost.cause}", 1), wants_memory=lost.wants_memory)

    def _start(self, key: int, workers: Workers) -> bool:
        """Start an item; False if it failed at once."""
        item, earlier = self._items[key], self._earlier[key]
        overwrite = item.overwrite or is_own_output(earlier)
        # Written by an earlier run, or by a process of this run that died.
        latest = self._record.latest(item)
        is_retry = latest is not None and latest.status == "started"
        try:
            if exists(item.target) and not (overwrite or is_retry):
                remedy = "choose another --out-dir or --suffix, or --overwrite"
                raise OutputError(item.target, "exists already", remedy)
            make_folder_of(item.target)
        except OutputError as error:
            self._finish(key, Attempt(failed(item, str(error), error.exit_code)))
            return False
        if item.settings.kernel.threads is None:
            kernel = dataclasses.replace(item.settings.kernel, threads=workers.threads)
            item = dataclasses.replace(item, settings=dataclasses.replace(item.settings, kernel=kernel))
        self._record.add(outcome_of(item, "started", written=_written(earlier)))
        workers.pool.start(
            key, *workers.call(dataclasses.replace(item, overwrite=overwrite, is_retry=is_retry))
        )
        return True

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
        """Fail an item that replaced a file of another item, such as a texture of the same name."""
        if outcome.status == "failed":
            return outcome
        for name, digest in outcome.written.items():
            other, other_digest = self._writers.setdefault(name, (key, digest))
            if other_digest != digest:
                cause = f"{name} is of {self._items[other].source}, too, with another content"
                remedy = "give them different folders as OUTPUT, in a manifest"
                error = OutputError(self._items[key].source, cause, remedy)
                return failed(self._items[key], str(error), error.exit_code, outcome.seconds)
        return outcome


def _written(earlier: Outcome | None) -> dict[str, str]:
    """Return the files of an earlier run, which stay if the attempt of this run fails or is interrupted."""
    return {} if earlier is None else earlier.written


def in_processes(at_once: int, memory: int | None) -> tuple[Pass, Pass]:
    """Return passes in processes of this machine: several with equal shares of `memory` (bytes), then one with all."""
    threads = KernelParameters().thread_count

    def several(files: int) -> Workers:
        count = min(at_once, files)
        return process_workers(count, None if memory is None else memory // count, max(1, threads // count))

    return several, lambda files: process_workers(1, memory, threads)


def process_workers(count: int, memory: int | None, threads: int) -> Workers:
    """Return a pool for up to `count` files at a time in processes with `memory` bytes each."""
    return Workers(Processes(count), lambda item: (do_item, item, memory), threads, has_all_memory=count == 1)
