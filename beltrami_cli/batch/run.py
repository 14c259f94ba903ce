"""Smooth many files at once, whatever happens to some of them."""

from __future__ import annotations

import dataclasses
from collections import deque
from typing import TYPE_CHECKING, Protocol

from beltrami_cli.batch.item import Attempt, failed, outcome_of
from beltrami_cli.batch.record import is_done, is_ours
from beltrami_cli.batch.storage import exists, make_folder_of
from beltrami_cli.batch.workers import Workers
from beltrami_cli.errors import OutputError
from beltrami_cli.flow.parameters import KernelParameters

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from beltrami_cli.batch.item import Item, Outcome
    from beltrami_cli.batch.record import Record


class Watcher(Protocol):
    """Shows how a batch goes; a key is the place of an item in it."""

    def started(self, key: int) -> None: ...
    def advanced(self, key: int, label: str, done: int, total: int) -> None: ...
    def postponed(
        self, key: int
    ) -> None: ...  # it wants more memory than its share, and is tried alone at the end
    def finished(self, key: int, attempt: Attempt) -> None: ...


class Executor(Protocol):
    """Does items, to be used as a context; what is still in work at its end is given up."""

    threads: int | None
    """For each file whose settings leave it open; None: as many as there are."""
    queues: bool
    """Whether items may wait after `start`; then a file begins with its first progress."""

    def __enter__(self) -> Executor: ...
    def __exit__(self, *error: object) -> None: ...
    @property
    def is_full(self) -> bool: ...  # so that it takes no more items for now
    @property
    def is_busy(self) -> bool: ...  # with any item
    def start(self, key: int, item: Item) -> None: ...
    def events(self, items: Callable[[int], Item]) -> Iterator[tuple[int, Attempt | tuple[str, int, int]]]:
        """Wait, and give for a key either its progress or its result; `items` gives the item of a key."""


def run_batch(
    items: Sequence[Item],
    record: Record,
    watcher: Watcher,
    *,
    at_once: int,
    memory: int | None,
    fail_fast: bool = False,
    executor: Executor | None = None,
) -> list[Outcome]:
    """Smooth many files, each as `smooth_file` would alone; return one outcome an item, in their order.

    What `record` says to be done, and still holds, is not done again. `at_once` files are in work at the same
    time, each in a process of its own, with an equal share of `memory` (bytes); those for which that is not enough are
    done alone at the end, with all of it. With an `executor` both are its concern. `fail_fast` ends the batch at the
    first failure.
    """
    return _Batch(items, record, watcher, fail_fast=fail_fast).run(at_once, memory, executor)


class _Batch:
    def __init__(self, items: Sequence[Item], record: Record, watcher: Watcher, *, fail_fast: bool) -> None:
        self._items, self._record, self._watcher = items, record, watcher
        self._fail_fast, self._stopped = fail_fast, False
        self._earlier = [record.latest(item) for item in items]
        self._outcomes: dict[int, Outcome] = {}
        self._writers: dict[str, tuple[int, str]] = {}  # who wrote a file, and its hash

    def run(self, at_once: int, memory: int | None, executor: Executor | None) -> list[Outcome]:
        waiting = self._skip_done()
        if executor is not None:
            self._work(waiting, executor, is_last=True)
        else:
            count = max(1, min(at_once, len(waiting)))
            share = None if memory is None else memory // count
            threads = KernelParameters().thread_count
            larger = self._work(waiting, Workers(count, share, max(1, threads // count)), is_last=count == 1)
            self._work(larger, Workers(1, memory, threads), is_last=True)
        outcomes = [self._outcomes.get(key) or self._not_started(key) for key in range(len(self._items))]
        self._record.close(outcomes)
        return outcomes

    def _skip_done(self) -> deque[int]:
        """Return what is to be done, without what an earlier run has done."""
        waiting: deque[int] = deque()
        for key, (item, earlier) in enumerate(zip(self._items, self._earlier, strict=True)):
            if earlier is not None and is_done(item, earlier):
                self._finish(key, Attempt(dataclasses.replace(earlier, status="skipped")))
            else:
                waiting.append(key)
        return waiting

    def _work(self, waiting: deque[int], executor: Executor, *, is_last: bool) -> deque[int]:
        """Do what waits; return what wants more memory, unless `is_last`."""
        larger: deque[int] = deque()
        with executor as workers:
            while not self._stopped and (waiting or workers.is_busy):
                while waiting and not workers.is_full and not self._stopped:
                    self._start(waiting.popleft(), workers)
                for key, event in workers.events(self._items.__getitem__) if workers.is_busy else ():
                    if not isinstance(event, Attempt):
                        self._watcher.advanced(key, *event)
                    elif event.wants_memory and not is_last:
                        self._watcher.postponed(key)
                        larger.append(key)
                    else:
                        self._finish(key, event)
        return larger

    def _start(self, key: int, executor: Executor) -> None:
        item, earlier = self._items[key], self._earlier[key]
        overwrite = item.overwrite or is_ours(earlier)
        again = earlier is not None and earlier.status == "started"
        try:
            if exists(item.target) and not (overwrite or again):
                remedy = "choose another --out-dir or --suffix, or --overwrite"
                raise OutputError(item.target, "exists already", remedy)
            make_folder_of(item.target)
        except OutputError as error:
            self._finish(key, Attempt(failed(item, str(error), error.exit_code)))
            return
        if item.settings.kernel.threads is None:
            kernel = dataclasses.replace(item.settings.kernel, threads=executor.threads)
            item = dataclasses.replace(item, settings=dataclasses.replace(item.settings, kernel=kernel))
        self._record.add(outcome_of(item, "started", written=_written(earlier)))
        executor.start(key, dataclasses.replace(item, overwrite=overwrite, again=again))
        if not executor.queues:
            self._watcher.started(key)

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

    def _not_started(self, key: int) -> Outcome:
        """Return the outcome of a file that --fail-fast left undone; what was known of it stays known."""
        return outcome_of(self._items[key], "not started", written=_written(self._earlier[key]))


def _written(earlier: Outcome | None) -> dict[str, str]:
    """Return the files of an earlier run, which are still there if a later attempt fails or is cut off."""
    return {} if earlier is None else earlier.written
