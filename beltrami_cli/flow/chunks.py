"""Chunks of a surface, processed one after another, in worker processes, or on other machines.

A chunk is a part of a surface together with the surrounding samples that one operation reads. An operation is an
iteration of the kernel or an estimate by patches. Only the results for the samples of the chunk itself are kept.
Everything that depends on more than a neighbourhood is computed for the whole surface between two operations: noise,
parameters, clipping limits, the mixing of channels, and the weights of the blend. The result therefore does not depend
on where a chunk is processed. It depends on the cuts only for patches on meshes, because groups of one chunk also
estimate samples of the next, and the order of sums changes their rounding.
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
"""The number of samples in all kernels of a chunk, and the number of kernels that were truncated."""

Operation = Callable[[Any, list[Float32s], int], tuple[Sequence[Float32s], Figures]]
"""Takes a part, a list of its stacks, which it may change, and the number of threads.

Returns stacks of the samples of the chunk.
"""


@dataclass(frozen=True, eq=False)
class Chunk:
    """A part of a surface with the surrounding samples that an operation reads."""

    # Makes the part. It holds geometry but no colours, so that all operations of a kind can share it.
    cut: Callable[[], Any]
    around: Any  # index of all samples of the part in a stack of the whole surface
    place: Any  # index of the chunk's own samples in such a stack


Answers = Generator[tuple[int, Sequence[Float32s], Figures], None, None]
"""The number of each chunk and its results, in any order. Results are valid until the next ones are requested."""

Runner = Callable[[Sequence[Chunk], Operation, Sequence[Float32s]], Answers]
"""Takes chunks, which may be used again, an operation, and stacks of the whole, which must not be changed."""


def in_turn(
    chunks: Sequence[Chunk], operation: Operation, stacks: Sequence[Float32s], threads: int = 1
) -> Answers:
    """Process chunks one after another in this process; a `Runner`."""
    for number, chunk in enumerate(chunks):
        copies = [np.array(stack[chunk.around]) for stack in stacks]
        yield number, *operation(chunk.cut(), copies, threads)


@dataclass(frozen=True)
class Chunking:
    """Division of surfaces into up to `count` chunks, which `runner` processes."""

    count: int
    runner: Runner

    def apply(
        self, chunks: Sequence[Chunk], operation: Operation, stacks: Sequence[Float32s],
        results: Sequence[Float32s], progress: Callable[[int], None] | None, *,
        size: int, threads: int, adds: bool = False,
    ) -> Figures:  # fmt: skip
        """Write the results of all chunks to stacks of the whole, or add them; `stacks` are not changed.

        `size`: number of samples of the whole, for its progress; `threads`: for a single chunk, which is processed
        here.
        """
        samples, truncated, added = 0.0, 0, 0
        # Results are added in the order of the chunks, since rounding depends on it.
        waiting: dict[int, Sequence[Float32s]] = {}
        run = self.runner if len(chunks) > 1 else partial(in_turn, threads=threads)
        # Closing the generator stops the workers at once when an exception is raised here.
        with contextlib.closing(run(chunks, operation, stacks)) as answers:
            for done, (number, values, figures) in enumerate(answers, 1):
                if adds:
                    waiting[number] = [part.copy() for part in values]
                else:
                    for result, part in zip(results, values, strict=True):
                        result[chunks[number].place] = part
                while added in waiting:
                    for result, part in zip(results, waiting.pop(added), strict=True):
                        result[chunks[added].place] += part
                    added += 1
                samples, truncated = samples + figures[0], truncated + figures[1]
                if progress is not None:
                    progress(size * done // len(chunks))
        return samples, truncated


# Peak memory of a mesh in one piece, in bytes per sample: `smooth` of a million points, see docs/performance.md.
_BYTES_OF_SAMPLE = 1000
# Share of the memory for one chunk where that is too little; steps on the whole mesh need the rest.
_SHARE_OF_CHUNK = 1 / 8


def chunk_memory(samples: int, memory: int) -> int | None:
    """Return the bytes that a chunk of a mesh may take; None if the whole mesh fits into memory."""
    return None if _BYTES_OF_SAMPLE * samples <= memory else int(_SHARE_OF_CHUNK * memory)


@dataclass(frozen=True)
class Resources:
    """Where a surface is processed, and how much of it at a time."""

    chunking: Chunking | None = None  # of every surface; None: as a whole, in this process
    # Bytes that a chunk of a mesh may take. Larger meshes are cut and processed here chunk by chunk; None: never cut.
    chunk_memory: int | None = None

    def chunking_of_mesh(self, samples: int, threads: int) -> Chunking | None:
        """Return the chunking of a mesh, or of a graph of its clusters; None if it is not cut."""
        chunk = self.chunk_memory
        if self.chunking is not None or chunk is None or _BYTES_OF_SAMPLE * samples <= chunk:
            return self.chunking
        return Chunking(math.ceil(_BYTES_OF_SAMPLE * samples / chunk), partial(in_turn, threads=threads))


IN_ONE_PIECE = Resources()


# ---- canvases
# Minimum number of cells of a chunk: around a square of this size, patches repeat less than half of the work.
MIN_CELLS = 1 << 18

Rectangle: TypeAlias = tuple[Any, ...]
"""The index of some cells in stacks of a canvas: an ellipsis, a slice of rows, and one of columns."""


def grown(cells: Rectangle, before: int, after: int, shape: tuple[int, ...]) -> Rectangle:
    """Extend a rectangle by `before` cells above and on the left, `after` below and on the right, within the canvas."""
    sides = zip(cells[1:], shape, strict=True)
    return ..., *(slice(max(0, side.start - before), min(most, side.stop + after)) for side, most in sides)


def chunks_of_canvas(
    cut: Callable[[Rectangle, Rectangle], Any], owned: Bools, count: int, unit: int, before: int, after: int
) -> list[Chunk]:
    """Cut a canvas into nearly square rectangles with about equal numbers of owned cells.

    They begin at multiples of `unit`, the period of the order of summation. A part has `before` and `after` more cells
    around. `cut` is called with the index of the part on the canvas, and with that of the rectangle within the part.
    """
    count = min(count, max(1, int(np.count_nonzero(owned)) // MIN_CELLS))
    bands = int(np.clip(round((count * owned.shape[0] / max(1, owned.shape[1])) ** 0.5), 1, count))
    shares = np.linspace(0, count, bands + 1).round().astype(int)
    heights, chunks = _split_evenly(owned.sum(axis=1), shares / count, unit), []
    for rows, parts in zip(heights, np.diff(shares).tolist(), strict=True):
        for columns in _split_evenly(owned[rows].sum(axis=0), np.linspace(0, 1, parts + 1), unit):
            place = ..., rows, columns
            around = grown(place, before, after, owned.shape)
            sides = zip(place[1:], around[1:], strict=True)
            core = ..., *(slice(side.start - first.start, side.stop - first.start) for side, first in sides)
            if owned[place].any():
                chunks.append(Chunk(partial(cut, around, core), around, place))
    return chunks


def _split_evenly(counts: Int64s, shares: Float64s, unit: int) -> list[slice]:
    """Cut entries so that the sum of each slice is its share of the total; slices begin at multiples of `unit`."""
    totals = np.concatenate([[0], np.cumsum(counts)])
    borders = np.searchsorted(totals, shares * totals[-1])
    borders = np.minimum((borders + unit // 2) // unit * unit, len(counts))
    borders[-1] = len(counts)
    return [slice(*each) for each in pairwise(borders.tolist())]


# ---- meshes
# Minimum number of samples of a chunk, as for canvases.
MIN_SAMPLES = 1 << 14


def runs(size: int, count: int) -> list[tuple[int, int]]:
    """Cut samples that are sorted by locality into runs of whole blocks."""
    blocks = -(-size // PATCH_BLOCK_SIZE)
    count = min(count, max(1, size // MIN_SAMPLES), blocks)
    borders = np.linspace(0, blocks, count + 1).round().astype(int) * PATCH_BLOCK_SIZE
    return list(pairwise(np.minimum(borders, size).tolist()))
