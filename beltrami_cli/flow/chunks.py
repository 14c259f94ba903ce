"""Surfaces in chunks, which are worked on one after another, in processes, or on other machines.

A chunk is a part of a surface with the samples around it that one operation reads: an iteration of the kernel, or an
estimate by patches. Of its result only the samples of the chunk itself are kept. What depends on more than a
neighbourhood is found on the whole between two operations: noise, parameters, limits that cut noise off, how channels
are mixed, and the weights of the blend. So the result does not depend on who works on a chunk, and on the cuts only in
patches of meshes: groups of one chunk also estimate samples of the next, and sums in another order round otherwise.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np

from beltrami_cli._native import PATCH_BLOCK_SIZE
from beltrami_cli.arrays import Bools, Float32s, Float64s, Int64s

Figures = tuple[float, int]
"""How many samples the kernels of a chunk held, and how many kernels were cut short."""

Operation = Callable[[Any, list[Float32s], int], tuple[Sequence[Float32s], Figures]]
"""Called with a part, a list of its stacks, which it may change, and the number of threads.

Returns stacks of the samples of the chunk.
"""


@dataclass(frozen=True, eq=False)
class Chunk:
    """A part of a surface, with the samples around it that an operation reads."""

    # Makes the part, which stays the same in all operations of a kind: geometry, and not colours.
    cut: Callable[[], Any]
    around: Any  # index of the samples of the part in a stack of the whole
    place: Any  # index of the samples of the chunk in a stack of the whole


Answers = Generator[tuple[int, Sequence[Float32s], Figures], None, None]
"""The number of each chunk and its results, in any order; results last until the next ones are asked for."""

Runner = Callable[[Sequence[Chunk], Operation, Sequence[Float32s]], Answers]
"""Called with chunks, which may come again, an operation, and stacks of the whole, which must not change."""


def in_turn(
    chunks: Sequence[Chunk], operation: Operation, stacks: Sequence[Float32s], threads: int = 1
) -> Answers:
    """Work on chunks one after another, here; a `Runner`."""
    for number, chunk in enumerate(chunks):
        copies = [np.array(stack[chunk.around]) for stack in stacks]
        yield number, *operation(chunk.cut(), copies, threads)


@dataclass(frozen=True)
class Chunking:
    """Surfaces are cut into up to `count` chunks for a runner."""

    count: int
    runner: Runner

    def apply(
        self, chunks: Sequence[Chunk], operation: Operation, stacks: Sequence[Float32s],
        results: Sequence[Float32s], progress: Callable[[int], None] | None, *,
        size: int, threads: int, adds: bool = False,
    ) -> Figures:  # fmt: skip
        """Write the results of all chunks to stacks of the whole, or add them; `stacks` stay as they are.

        `size`: of the whole, for its progress; `threads`: for a single chunk, which is done here.
        """
        samples, truncated, added = 0.0, 0, 0
        # To be added in the order of the chunks, on which rounding depends.
        waiting: dict[int, Sequence[Float32s]] = {}
        run = self.runner if len(chunks) > 1 else partial(in_turn, threads=threads)
        # Workers stop at once if this does.
        with contextlib.closing(run(chunks, operation, stacks)) as answers:
            for done, (number, values, figures) in enumerate(answers, 1):
                if adds:
                    waiting[number] = [own.copy() for own in values]
                else:
                    for result, own in zip(results, values, strict=True):
                        result[chunks[number].place] = own
                while added in waiting:
                    for result, own in zip(results, waiting.pop(added), strict=True):
                        result[chunks[added].place] += own
                    added += 1
                samples, truncated = samples + figures[0], truncated + figures[1]
                if progress is not None:
                    progress(size * done // len(chunks))
        return samples, truncated


# Bytes of memory that a mesh in one piece takes for each sample: a million points at the peak of `smooth`, see
# docs/performance.md.
_BYTES_OF_SAMPLE = 1000
# Share of the memory for a chunk, where it is too small for that; steps on the whole mesh need the rest.
_SHARE_OF_CHUNK = 1 / 8


def chunk_memory(samples: int, memory: int) -> int | None:
    """Return the bytes that a chunk of a mesh may take; None: all of it fits into memory in one piece."""
    return None if _BYTES_OF_SAMPLE * samples <= memory else int(_SHARE_OF_CHUNK * memory)


@dataclass(frozen=True)
class Resources:
    """Who works on a surface, and on how much of it at a time."""

    chunking: Chunking | None = None  # of every surface; None: here, as a whole
    # Bytes that a chunk of a mesh may take: larger ones are cut, and done here chunk by chunk; None: they are not.
    chunk_memory: int | None = None

    def chunking_of_mesh(self, samples: int, threads: int) -> Chunking | None:
        """Return how a mesh, or a graph of its clusters, is cut; None: not at all."""
        chunk = self.chunk_memory
        if self.chunking is not None or chunk is None or _BYTES_OF_SAMPLE * samples <= chunk:
            return self.chunking
        return Chunking(math.ceil(_BYTES_OF_SAMPLE * samples / chunk), partial(in_turn, threads=threads))


IN_ONE_PIECE = Resources()


# ---- canvases
# Cells of a chunk at least: patches around a square as large repeat less than half of the work.
MIN_CELLS = 1 << 18

Rectangle: TypeAlias = tuple[Any, ...]
"""The index of some cells in stacks of a canvas: an ellipsis, a slice of rows, and one of columns."""


def grown(cells: Rectangle, before: int, after: int, shape: tuple[int, ...]) -> Rectangle:
    """Return a rectangle with cells added above and on the left, and below and on the right, within a canvas."""
    sides = zip(cells[1:], shape, strict=True)
    return ..., *(slice(max(0, side.start - before), min(most, side.stop + after)) for side, most in sides)


def chunks_of_canvas(
    cut: Callable[[Rectangle, Rectangle], Any], owned: Bools, count: int, unit: int, before: int, after: int
) -> list[Chunk]:
    """Cut a canvas into rectangles that are about square and hold about as many owned cells.

    They begin at multiples of `unit`, at which the order of sums repeats itself. A part has some cells more before and
    after; `cut` is called with the index of all of them, and with that of the rectangle among them.
    """
    count = min(count, max(1, int(np.count_nonzero(owned)) // MIN_CELLS))
    bands = int(np.clip(round((count * owned.shape[0] / max(1, owned.shape[1])) ** 0.5), 1, count))
    shares = np.linspace(0, count, bands + 1).round().astype(int)
    heights, chunks = _even(owned.sum(axis=1), shares / count, unit), []
    for rows, parts in zip(heights, np.diff(shares).tolist(), strict=True):
        for columns in _even(owned[rows].sum(axis=0), np.linspace(0, 1, parts + 1), unit):
            place = ..., rows, columns
            around = grown(place, before, after, owned.shape)
            sides = zip(place[1:], around[1:], strict=True)
            own = ..., *(slice(side.start - first.start, side.stop - first.start) for side, first in sides)
            if owned[place].any():
                chunks.append(Chunk(partial(cut, around, own), around, place))
    return chunks


def _even(counts: Int64s, shares: Float64s, unit: int) -> list[slice]:
    """Cut entries into parts whose sums are about the differences of shares of the total."""
    totals = np.concatenate([[0], np.cumsum(counts)])
    borders = np.searchsorted(totals, shares * totals[-1])
    borders = np.minimum((borders + unit // 2) // unit * unit, len(counts))
    borders[-1] = len(counts)
    return [slice(*each) for each in pairwise(borders.tolist())]


# ---- meshes
# Samples of a chunk at least, as above.
MIN_SAMPLES = 1 << 14


def runs(size: int, count: int) -> list[tuple[int, int]]:
    """Cut samples, in an order in which neighbours are near each other, into runs of whole blocks."""
    blocks = -(-size // PATCH_BLOCK_SIZE)
    count = min(count, max(1, size // MIN_SAMPLES), blocks)
    borders = np.linspace(0, blocks, count + 1).round().astype(int) * PATCH_BLOCK_SIZE
    return list(pairwise(np.minimum(borders, size).tolist()))
