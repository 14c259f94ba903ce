"""A surface in chunks, which are worked on one after another, in processes, or on other machines.

A chunk is a part of a surface with the samples around it that one operation reads: an iteration of the kernel, or an
estimate by patches. Of its result only the samples of the chunk itself are kept. What depends on more than a
neighbourhood is found on the whole between two operations: noise, parameters, limits that cut noise off, how channels
are mixed, and the weights of the blend. So the result does not depend on who works on a chunk, and on the cuts only in
patches of meshes: groups of one chunk also estimate samples of the next, and sums in another order round otherwise.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from dataclasses import dataclass
from functools import partial, reduce
from itertools import pairwise
from typing import Any, Protocol

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int32s, Int64s
from beltrami_cli.surface import large_arrays

Figures = tuple[float, int]
"""How many samples the kernels of a chunk held, and how many kernels were cut short."""

Operation = Callable[..., tuple[Sequence[Float32s], Figures]]
"""Called with a part, a list of its stacks, which it may change, the number of threads and further arguments.

Returns stacks of the part.
"""


Piece = tuple[Any, Any]
"""A part, and the index of the samples of the chunk in it."""


@dataclass(frozen=True, eq=False)
class Chunk:
    """A part of a surface, with the samples around it that an operation reads."""

    # Makes the part, which stays the same in all operations of a kind: geometry, and not colours.
    cut: Callable[[], Any]
    around: Any = None  # index of the samples of the part in a stack of the whole
    place: Any = None  # index of the samples of the chunk in a stack of the whole, and of the part
    kept: Any = None

    def piece(self) -> Piece:
        """Return what a worker needs of it."""
        return self.cut(), self.kept


@dataclass(frozen=True)
class Work:
    """An operation on all chunks of a surface."""

    operation: Operation
    arguments: tuple[Any, ...]
    adds: bool = False  # to what other chunks find for the same samples

    def on(self, piece: Piece, stacks: list[Float32s], threads: int) -> tuple[list[Float32s], Figures]:
        """Return the results of the samples of a chunk; the stacks may change."""
        part, kept = piece
        results, figures = self.operation(part, stacks, threads, *self.arguments)
        return [stack[kept] for stack in results], figures


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
            stacks = [np.array(stack) for stack in stacks_of(chunk)]
            yield number, *work.on(chunk.piece(), stacks, self._threads)


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


# Bytes of memory that a mesh in one piece takes for each sample: a million points at the peak of `smooth`, see
# docs/performance.md.
_BYTES_OF_SAMPLE = 1000
# Of memory that is too small for that, what a chunk may take. A choice: what one step does with the whole takes more.
_SHARE_OF_CHUNK = 1 / 8


def chunk_memory(samples: int, memory: int) -> int | None:
    """Return the bytes that a chunk of a mesh may take; None: all of it fits into memory in one piece."""
    return None if _BYTES_OF_SAMPLE * samples <= memory else int(_SHARE_OF_CHUNK * memory)


def chunking_of_mesh(samples: int, threads: int) -> Chunking | None:
    """Return how a mesh, or clusters of it, are cut: as wanted, or else so that chunks fit into little memory."""
    chunk = large_arrays.chunk_memory()
    if chunking() is not None or chunk is None or _BYTES_OF_SAMPLE * samples <= chunk:
        return chunking()
    return Chunking(math.ceil(_BYTES_OF_SAMPLE * samples / chunk), InTurn(threads))


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


def chunk_of(cut: Callable[[], Any], core: Rectangle, around: Rectangle) -> Chunk:
    """Return the chunk of a rectangle of a canvas, whose part is a rectangle around it."""
    return Chunk(cut, around.index, core.index, core.within(around))


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


def entries(offsets: Int64s, rows: Array) -> tuple[Int64s, Int64s]:
    """Return where some rows of a table have their entries, row after row, and how many each has."""
    starts, counts = offsets[rows], offsets[rows + 1] - offsets[rows]
    return np.arange(int(counts.sum())) + np.repeat(starts - (np.cumsum(counts) - counts), counts), counts


class RowsOfSamples:
    """Rows of numbers of samples, such as edges and triangles, which are found by the samples."""

    # Blocks of samples whose numbers have 16 bits, by which NumPy sorts in linear time.
    _BLOCKS = 1 << 16

    def __init__(self, rows: Int32s, size: int) -> None:
        """Take rows that are sorted already, or in no order."""
        self._size, self._width = size, 1 + size // self._BLOCKS
        block = (reduce(np.minimum, rows.T) // self._width).astype(np.uint16)
        if np.any(block[1:] < block[:-1]):
            rows = large_arrays.kept(rows[np.argsort(block, kind="stable")])
        self._rows, counts = rows, np.bincount(block, minlength=self._BLOCKS)
        self._offsets = np.concatenate([[0], np.cumsum(counts)])

    def among(self, samples: Array) -> tuple[Int32s, Int64s]:
        """Return the rows of some samples, ascending, in the numbers of these; and the place of each row."""
        rank = np.full(self._size, -1, np.int32)
        rank[samples] = np.arange(len(samples))
        blocks = np.flatnonzero(np.bincount(samples // self._width))
        places, _ = entries(self._offsets, blocks)
        rows = rank[self._rows[places]]
        known = reduce(np.logical_and, (rows >= 0).T)
        return rows[known], places[known]


class Neighbours:
    """The neighbours of every sample along edges, shape (E, 2), and how far samples are from others."""

    def __init__(self, count: int, edges: Int32s, lengths_of: Callable[[Int32s], Float32s]) -> None:
        """Take what returns the lengths of edges, shape (K, 2)."""
        both = large_arrays.empty((2, len(edges)), np.int64)
        for own, this, other in zip(both, edges.T, edges.T[::-1], strict=True):
            own[:] = this
            own <<= 32
            own |= other
        both = both.reshape(-1)
        both.sort()
        self._targets = large_arrays.kept(both.astype(np.int32))  # their lower half
        self._offsets = np.zeros(count + 1, np.int64)
        for ends in edges.T:
            self._offsets[1:] += np.bincount(ends, minlength=count)
        np.cumsum(self._offsets, out=self._offsets)
        self._lengths_of = lengths_of

    def distances(self, first: int, last: int, limit: float) -> Float32s:
        """Return how far samples are from the ones in [first, last) along edges; infinite: beyond the limit."""
        found = np.full(len(self._offsets) - 1, np.inf, np.float32)
        found[first:last] = 0
        front: Array = np.arange(first, last, dtype=np.int32)
        while len(front):
            places, counts = entries(self._offsets, front)
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


def chunk_of_run(part_of: Callable[[Array, slice], Any], near: Bools, first: int, last: int) -> Chunk:
    """Return the chunk of a run of samples, with the samples near it, marked in an array of all."""
    from beltrami_cli._native import PATCH_BLOCK_SIZE

    # Samples from anywhere before, so that what the core takes together is the same as in the whole.
    missing = -int(np.count_nonzero(near[:first])) % PATCH_BLOCK_SIZE
    near[np.flatnonzero(~near[:first])[:missing]] = True
    samples = np.flatnonzero(near).astype(np.int32)
    begin, end = np.searchsorted(samples, [first, last]).tolist()
    return Chunk(partial(part_of, samples, kept := slice(begin, end)), samples, slice(first, last), kept)
