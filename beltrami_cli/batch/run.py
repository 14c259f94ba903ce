"""Smooth many files, whatever happens to some of them: each by a worker, or one after another in pieces."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, Protocol, Self

from beltrami_cli.arrays import Float32s
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
from beltrami_cli.batch.workers import Lost, Pool, Processes
from beltrami_cli.errors import OutputError, ProcessingError
from beltrami_cli.flow.chunks import Chunk, Done, Figures, Work, in_chunks
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.jobs.job import at_intervals

# Attempts at a chunk before its file fails: a machine that restarts loses a few workers, and a chunk that is too large
# for the memory kills every worker. A choice.
_TRIES = 5
_PAUSE = 0.1  # seconds between two messages on progress

Advanced = Callable[[int, str, int, int], None]  # called with a key and its progress


class Watcher(Protocol):
    """Shows how a batch goes; a key is the place of an item in it."""

    def advanced(self, key: int, label: str, done: int, total: int) -> None: ...
    def postponed(self, key: int) -> None: ...  # to the end, when it is tried alone with all memory
    def finished(self, key: int, attempt: Attempt) -> None: ...


class Executor(ABC):
    """Does items, to be used as a context; items still in work at its end are given up."""

    threads: int | None = None  # for each file whose settings leave it open; None: as many as there are

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
    def attempts(self, advanced: Advanced) -> Iterator[tuple[int, Attempt]]:
        """Wait for a while, call `advanced` with what comes of progress, and give by key what came of items."""


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
            larger = self._work(
                waiting, in_processes(count, share, max(1, threads // count)), is_last=count == 1
            )
            self._work(larger, in_processes(1, memory, threads), is_last=True)
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
                for key, attempt in workers.attempts(self._watcher.advanced) if in_work else ():
                    in_work.discard(key)
                    if attempt.wants_memory and not is_last:
                        self._watcher.postponed(key)
                        larger.append(key)
                    else:
                        self._finish(key, attempt)
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


class OnWorkers(Executor):
    """Does files on the workers of a pool; `call` gives the task of an item, and its arguments."""

    def __init__(
        self, pool: Pool, call: Callable[[Item], tuple[Any, ...]], threads: int | None = None
    ) -> None:
        self._pool, self._call, self.threads = pool, call, threads
        self._items: dict[int, Item] = {}

    def __exit__(self, *_: object) -> None:
        self._pool.close()

    @property
    def is_full(self) -> bool:
        return self._pool.is_full

    def start(self, key: int, item: Item) -> None:
        self._items[key] = item
        self._pool.start(key, *self._call(item))

    def attempts(self, advanced: Advanced) -> Iterator[tuple[int, Attempt]]:
        for key, event in self._pool.events():
            if isinstance(event, tuple):
                advanced(key, *event)
                continue
            item = self._items.pop(key)
            if isinstance(event, Lost):
                outcome = failed(item, f"{item.source}: {event.cause}", 1)
                event = Attempt(outcome, wants_memory=event.wants_memory)
            yield key, event


def in_processes(count: int, memory: int | None, threads: int) -> Executor:
    """Return what does up to `count` files at the same time in processes, each with `memory` bytes."""
    return OnWorkers(Processes(count), lambda item: (do_item, item, memory), threads)


class InPieces(Executor):
    """Does one file at a time here, and has up to `count` chunks of each surface done by the workers of a pool."""

    def __init__(self, pool: Pool, count: int, memory: int | None) -> None:
        self._pool, self._count, self._memory = pool, count, memory
        self._waiting: tuple[int, Item] | None = None

    def __exit__(self, *_: object) -> None:
        self._pool.close()

    @property
    def is_full(self) -> bool:
        return self._waiting is not None

    def start(self, key: int, item: Item) -> None:
        self._waiting = key, item

    def attempts(self, advanced: Advanced) -> Iterator[tuple[int, Attempt]]:
        assert self._waiting is not None
        (key, item), self._waiting = self._waiting, None
        runner, progress = ChunkRunner(self._pool), at_intervals(_PAUSE, partial(advanced, key))
        with in_chunks(self._count, runner):
            attempt = do_item(item, self._memory, progress, is_alone=False)
        yield key, dataclasses.replace(attempt, pieces=runner.most)


class ChunkRunner:
    """Works on chunks with workers that may die; a `Runner`."""

    def __init__(self, pool: Pool) -> None:
        self._pool = pool
        self._chunks: Sequence[Chunk] = ()
        # Shared parts of the chunks, so that only colours are sent from one operation to the next.
        self._parts: dict[int, Any] = {}
        self.most = 0  # chunks that a surface was cut into

    def run(
        self, chunks: Sequence[Chunk], work: Work, stacks_of: Callable[[Chunk], list[Float32s]]
    ) -> Iterator[Done]:
        if chunks is not self._chunks:
            self._chunks, self._parts, self.most = chunks, {}, max(self.most, len(chunks))
        waiting, failures, in_work = list(range(len(chunks))), Counter[int](), set[int]()
        try:
            while waiting or in_work:
                while waiting and not self._pool.is_full:
                    number = self._pool.choose(waiting, self._parts)
                    waiting.remove(number)
                    in_work.add(number)
                    self._start(number, work, stacks_of(chunks[number]))
                for number, answer in self._pool.events():
                    in_work.discard(number)
                    if isinstance(answer, Exception):
                        raise answer
                    if not isinstance(answer, Lost):
                        yield number, *answer
                        continue
                    failures[number] += 1
                    if failures[number] == _TRIES:
                        what = f"workers died or failed {_TRIES} times with one piece of the surface"
                        remedy = "if there is too little memory for it, raise --pieces"
                        raise ProcessingError(f"{what}: {answer.cause}; {remedy}")
                    self._parts.pop(number, None)  # it may be what was lost
                    waiting.append(number)
        finally:
            self._pool.give_up()

    def _start(self, number: int, work: Work, stacks: list[Float32s]) -> None:
        if number not in self._parts:
            self._parts[number] = self._pool.share(self._chunks[number].without_whole())
        self._pool.start(number, do_chunk, self._parts[number], work, stacks)


def do_chunk(
    chunk: Chunk, work: Work, stacks: list[Float32s], progress: object
) -> tuple[Float32s, Figures] | Exception:
    """Return the result of a chunk in a worker."""
    del progress
    try:
        return work.on(chunk, stacks, 1)
    except Exception as error:  # other than the death of a worker, it would come again elsewhere
        return error
