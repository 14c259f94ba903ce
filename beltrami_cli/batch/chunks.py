"""Smooth one file at a time, with the chunks of its surfaces in several workers."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np

from beltrami_cli.arrays import Float32s
from beltrami_cli.batch.item import Attempt, Item
from beltrami_cli.batch.pool import Lost, Pool, Task
from beltrami_cli.batch.run import Workers
from beltrami_cli.batch.work import do_item
from beltrami_cli.errors import ProcessingError
from beltrami_cli.flow.chunks import Answers, Chunk, Chunking, KernelCounts, Operation, Part
from beltrami_cli.jobs.progress import Progress, at_intervals

# Attempts at a chunk before its file fails: a machine that restarts loses a few workers, and a chunk that is too large
# for the memory kills every worker.
_MAX_ATTEMPTS = 5
Advanced = Callable[[int, str, float, float], None]  # called with a key and its progress


def chunk_workers(
    pool: Pool, count: int, memory: int | None, advanced: Advanced, threads: int | None
) -> Workers:
    """Return a pool for one file at a time in this process, with up to `count` chunks of each surface in workers.

    `threads`: for the work between two operations, in which the workers of this machine have nothing to do.
    """

    def do_in_chunks(item: Item, progress: Progress) -> Attempt:
        runner = ChunkRunner(pool)
        chunking = Chunking(count, runner)
        attempt = do_item(item, memory, progress, is_alone=False, chunking=chunking)
        return dataclasses.replace(attempt, chunks=runner.most_chunks)

    return Workers(InProcess(advanced), lambda item: (do_in_chunks, item), threads)


class InProcess(Pool):
    """Runs one task at a time in this process."""

    def __init__(self, advanced: Advanced) -> None:
        self._advanced = advanced
        self._waiting: list[tuple[int, Task, tuple[Any, ...]]] = []

    @property
    def is_full(self) -> bool:
        return bool(self._waiting)

    def start(self, key: int, task: Task, *arguments: Any, part: Callable[[], Any] | None = None) -> None:
        assert part is None
        self._waiting.append((key, task, arguments))

    def events(self) -> Iterator[tuple[int, Any]]:
        key, task, arguments = self._waiting.pop()
        yield key, task(*arguments, at_intervals(partial(self._advanced, key)))

    def give_up(self) -> None:
        self._waiting.clear()


class ChunkRunner:
    """A `Runner` for chunks whose workers may die."""

    def __init__(self, pool: Pool, tries: int = _MAX_ATTEMPTS) -> None:
        self._pool, self._tries = pool, tries
        self._chunks: Sequence[Chunk[Any]] = ()  # workers keep their geometry, so that only colours are sent
        self.most_chunks = 0  # of a surface

    def __call__(
        self, chunks: Sequence[Chunk[Part]], operation: Operation[Part], stacks: Sequence[Float32s]
    ) -> Answers:
        if chunks is not self._chunks:
            self._pool.forget()
            self._chunks, self.most_chunks = chunks, max(self.most_chunks, len(chunks))
        waiting, failures, in_work = list(range(len(chunks))), Counter[int](), set[int]()
        try:
            while waiting or in_work:
                while waiting and not self._pool.is_full:
                    kept = self._pool.kept()
                    number = next((each for each in waiting if each in kept), waiting[0])
                    waiting.remove(number)
                    in_work.add(number)
                    chunk = chunks[number]
                    around = [np.ascontiguousarray(stack[chunk.around]) for stack in stacks]
                    self._pool.start(number, do_chunk, operation, around, part=chunk.cut)
                for number, answer in self._pool.events():
                    in_work.discard(number)
                    if isinstance(answer, Exception):
                        raise answer
                    if not isinstance(answer, Lost):
                        yield number, *answer
                        continue
                    failures[number] += 1
                    if failures[number] == self._tries:
                        what = f"workers died or failed {self._tries} times with one piece of the surface"
                        remedy = "if there is too little memory for it, raise --pieces"
                        raise ProcessingError(f"{what}: {answer.cause}; {remedy}")
                    waiting.append(number)
        finally:
            self._pool.give_up()


def do_chunk(
    part: Part, operation: Operation[Part], stacks: list[Float32s], progress: object
) -> tuple[Sequence[Float32s], KernelCounts] | Exception:
    """Compute a chunk in a worker."""
    del progress
    try:
        values, counts = operation(part, stacks, 1)
        return [np.ascontiguousarray(each) for each in values], counts
    except Exception as error:  # unlike the death of a worker, it would recur elsewhere
        return error
