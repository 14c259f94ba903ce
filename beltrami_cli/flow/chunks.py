"""A surface in chunks, which are worked on one after another, in processes, or on other machines.

A chunk is a part of a surface with the samples around it that one operation reads: an iteration of the kernel, or an
estimate by patches. Of its result only the samples of the chunk itself are kept. What depends on more than a
neighbourhood is found on the whole between two operations: noise, parameters, limits that cut noise off, how channels
are mixed, and the weights of the blend. So the result does not depend on who works on a chunk, and on the cuts only in
patches of meshes: groups of one chunk also estimate samples of the next, and sums in another order round otherwise.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Protocol

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int32s, Int64s

Figures = tuple[float, int]
"""How many samples the kernels of a chunk held, and how many kernels were cut short."""

Operation = Callable[..., tuple[Sequence[Float32s], Figures]]
"""Called with a part, a list of its stacks, which it may change, the number of threads and further arguments.

Returns stacks of the part.
"""


@dataclass(frozen=True, eq=False)
class Chunk:
    """A part of a surface, with the samples around it that an operation reads."""

    part: Any  # what stays the same in all operations of a kind: geometry, and not colours
    around: Any = None  # index of the samples of the part in a stack of the whole
    place: Any = None  # index of the samples of the chunk in a stack of the whole, and of the part
    kept: Any = None

    def without_whole(self) -> Chunk:
        """Return what another process needs of it."""
        return Chunk(self.part, kept=self.kept)


@dataclass(frozen=True)
class Work:
    """An operation on all chunks of a surface."""

    operation: Operation
    arguments: tuple[Any, ...]
    adds: bool = False  # to what other chunks find for the same samples

    def on(self, chunk: Chunk, stacks: list[Float32s], threads: int) -> tuple[list[Float32s], Figures]:
        """Return the results of the samples of a chunk; the stacks may change."""
        results, figures = self.operation(chunk.part, stacks, threads, *self.arguments)
        return [stack[chunk.kept] for stack in results], figures


Done = tuple[int, Sequence[Float32s], Figures]


class Runner(Protocol):
    """Does the work on chunks."""

    def run(
        self, chunks: Sequence[Chunk], work: Work, stacks_of: Callable[[Chunk], list[Float32s]]
    ) -> Iterator[Done]:
        """Yield the number of each chunk and its results, in any order; the same chunks may come again.

        Results last until the next ones are asked for. `stacks_of` gives views, which work must not change.
        """


class InTurn:
    """Works on chunks one after another, here."""

    def __init__(self, threads: int = 1) -> None:
        self._threads = threads

    def run(
        self, chunks: Sequence[Chunk], work: Work, stacks_of: Callable[[Chunk], list[Float32s]]
    ) -> Iterator[Done]:
        for number, chunk in enumerate(chunks):
            yield number, *work.on(chunk, [np.array(stack) for stack in stacks_of(chunk)], self._threads)


@dataclass(frozen=True)
class Chunking:
    """Surfaces are cut into up to `count` chunks for a runner."""

    count: int
    runner: Runner

    def apply(
        self,
        chunks: Sequence[Chunk],
        work: Work,
        stacks: Sequence[Float32s],
        results: Sequence[Float32s],
        progress: Callable[[int], None] | None,
        *,
        size: int,
        threads: int,
    ) -> Figures:
        """Write the results of all chunks to stacks of the whole, or add them; `stacks` stay as they are.

        `size`: of the whole, for its progress; `threads`: for a single chunk, which is done here.
        """

        def stacks_of(chunk: Chunk) -> list[Float32s]:
            return [stack[chunk.around] for stack in stacks]

        samples, truncated, added = 0.0, 0, 0
        # To be added in the order of the chunks, on which rounding depends.
        waiting: dict[int, Sequence[Float32s]] = {}
        runner = self.runner if len(chunks) > 1 else InTurn(threads)
        for done, (number, values, figures) in enumerate(runner.run(chunks, work, stacks_of), 1):
            if work.adds:
                waiting[number] = [own.copy() for own in values]
                while added in waiting:
                    for result, own in zip(results, waiting.pop(added), strict=True):
                        result[chunks[added].place] += own
                    added += 1
            else:
                for result, own in zip(results, values, strict=True):
                    result[chunks[number].place] = own
            samples, truncated = samples + figures[0], truncated + figures[1]
            if progress is not None:
                progress(size * done // len(chunks))
        return samples, truncated


_WANTED: ContextVar[Chunking | None] = ContextVar("chunking", default=None)


@contextlib.contextmanager
def in_chunks(count: int, runner: Runner) -> Iterator[None]:
    """Within this context and thread, smooth every surface in up to `count` chunks."""
    token = _WANTED.set(Chunking(count, runner))
    try:
        yield
    finally:
        _WANTED.reset(token)


def chunking() -> Chunking | None:
    """Return how surfaces are cut in this context; None: not at all."""
    return _WANTED.get()


# ---- canvases
# Cells of a chunk at least: patches around a square as large repeat less than half of the work.
LEAST_CELLS = 1 << 18


@dataclass(frozen=True)
class Rectangle:
    """The cells [top, bottom) x [left, right) of a canvas."""

    top: int
    bottom: int
    left: int
    right: int

    def grown(self, before: int, after: int, shape: tuple[int, int]) -> Rectangle:
        """Return it with cells added above and on the left, and below and on the right, within a canvas."""
        top, left = max(0, self.top - before), max(0, self.left - before)
        return Rectangle(top, min(shape[0], self.bottom + after), left, min(shape[1], self.right + after))

    def within(self, other: Rectangle) -> tuple[Any, ...]:
        """Return the index of its cells in stacks of another rectangle."""
        rows = slice(self.top - other.top, self.bottom - other.top)
        return ..., rows, slice(self.left - other.left, self.right - other.left)

    @property
    def index(self) -> tuple[Any, ...]:
        """The index of its cells in stacks of the canvas."""
        return ..., slice(self.top, self.bottom), slice(self.left, self.right)

    @property
    def shape(self) -> tuple[int, int]:
        return self.bottom - self.top, self.right - self.left


def chunk_of(part: Any, core: Rectangle, around: Rectangle) -> Chunk:
    """Return the chunk of a rectangle of a canvas, whose part is a rectangle around it."""
    return Chunk(part, around.index, core.index, core.within(around))


def rectangles(owned: Bools, count: int, unit: int) -> list[Rectangle]:
    """Cut a canvas into rectangles that are about square and hold about as many owned cells.

    They begin at multiples of `unit`, at which the order of sums repeats itself.
    """
    rows, columns = owned.shape
    count = min(count, max(1, int(np.count_nonzero(owned)) // LEAST_CELLS))
    bands = int(np.clip(round((count * rows / max(1, columns)) ** 0.5), 1, count))
    shares = np.linspace(0, count, bands + 1).round().astype(int)
    found = []
    borders = _even(owned.sum(axis=1), shares / count, unit)
    for (top, bottom), parts in zip(pairwise(borders), np.diff(shares).tolist(), strict=True):
        across = _even(owned[top:bottom].sum(axis=0), np.linspace(0, 1, parts + 1), unit)
        for left, right in pairwise(across):
            if owned[top:bottom, left:right].any():
                found.append(Rectangle(top, bottom, left, right))
    return found


def _even(counts: Int64s, shares: Float64s, unit: int) -> list[int]:
    """Return borders between entries so that the sum before each is about its share of the total."""
    totals = np.concatenate([[0], np.cumsum(counts)])
    borders = np.searchsorted(totals, shares * totals[-1])
    borders = np.minimum((borders + unit // 2) // unit * unit, len(counts))
    borders[0], borders[-1] = 0, len(counts)
    return np.maximum.accumulate(borders).tolist()  # type: ignore[no-any-return]


# ---- meshes
# Samples of a chunk at least, as above.
LEAST_SAMPLES = 1 << 14


class Neighbours:
    """The neighbours of every sample along edges, shape (E, 2), and how far samples are from others."""

    def __init__(self, count: int, edges: Int32s, lengths_of: Callable[[Int32s], Float32s]) -> None:
        """Take what returns the lengths of edges, shape (K, 2)."""
        low, high = edges.T.astype(np.int64)
        both = np.concatenate([low << 32 | high, high << 32 | low])
        both.sort()
        self._targets = both.astype(np.int32)  # their lower half
        self._offsets = np.concatenate([[0], np.cumsum(np.bincount(edges.reshape(-1), minlength=count))])
        self._lengths_of = lengths_of

    def distances(self, first: int, last: int, limit: float) -> Float32s:
        """Return how far samples are from the ones in [first, last) along edges; infinite: beyond the limit."""
        found = np.full(len(self._offsets) - 1, np.inf, np.float32)
        found[first:last] = 0
        front: Array = np.arange(first, last, dtype=np.int32)
        while len(front):
            starts, counts = self._offsets[front], self._offsets[front + 1] - self._offsets[front]
            # Entry i of a row of `counts` numbers that begins at `starts`.
            places = np.arange(int(counts.sum())) + np.repeat(starts - (np.cumsum(counts) - counts), counts)
            sources, targets = np.repeat(front, counts), self._targets[places]
            leads_on = found[sources] < found[targets]
            sources, targets = sources[leads_on], targets[leads_on]
            after = found[sources] + self._lengths_of(np.stack([sources, targets], axis=1))
            nearer = (after <= limit) & (after < found[targets])
            np.minimum.at(found, targets[nearer], after[nearer])
            front = np.unique(targets[nearer])
        return found


def runs(size: int, count: int) -> list[tuple[int, int]]:
    """Cut samples, in an order in which neighbours are near each other, into runs of whole blocks."""
    from beltrami_cli._native import PATCH_BLOCK_SIZE

    blocks = -(-size // PATCH_BLOCK_SIZE)
    count = min(count, max(1, size // LEAST_SAMPLES), blocks)
    borders = np.linspace(0, blocks, count + 1).round().astype(int) * PATCH_BLOCK_SIZE
    return list(pairwise(np.minimum(borders, size).tolist()))


def chunk_of_run(part_of: Callable[[Int64s], Any], near: Bools, first: int, last: int) -> Chunk:
    """Return the chunk of a run of samples, with the samples near it, marked in an array of all."""
    from beltrami_cli._native import PATCH_BLOCK_SIZE

    # Samples from anywhere before, so that what the core takes together is the same as in the whole.
    missing = -int(np.count_nonzero(near[:first])) % PATCH_BLOCK_SIZE
    near[np.flatnonzero(~near[:first])[:missing]] = True
    samples = np.flatnonzero(near)
    begin, end = np.searchsorted(samples, [first, last]).tolist()
    return Chunk(part_of(samples), samples, slice(first, last), slice(begin, end))
