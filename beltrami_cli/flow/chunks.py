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
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from beltrami_cli.arrays import Float32s

Part = TypeVar("Part")  # of a surface: what an operation reads besides stacks


class KernelCounts(NamedTuple):
    """The number of samples in all kernels of a chunk, and the number of truncated kernels."""

    samples: float = 0.0
    truncated: int = 0


Operation = Callable[[Part, list[Float32s], int], tuple[Sequence[Float32s], KernelCounts]]
"""Takes a part, a list of its stacks, which it may change, and the number of threads.

Returns stacks of the samples of the chunk.
"""


@dataclass(frozen=True, eq=False)
class Chunk(Generic[Part]):
    """A part of a surface with the surrounding samples that an operation reads."""

    # Makes the part. It holds geometry but no colours, so that all operations of a kind can share it.
    cut: Callable[[], Part]
    around: Any  # index of all samples of the part in a stack of the whole surface
    place: Any  # index of the chunk's own samples in such a stack


Answers = Generator[tuple[int, Sequence[Float32s], KernelCounts], None, None]
"""The number of each chunk and its results, in any order. Results are valid until the next ones are requested."""


class Runner(Protocol):
    def __call__(
        self, chunks: Sequence[Chunk[Part]], operation: Operation[Part], stacks: Sequence[Float32s], /
    ) -> Answers:
        """Take chunks, which may be used again, an operation, and stacks of the whole, which must not be changed."""


def in_turn(
    chunks: Sequence[Chunk[Part]], operation: Operation[Part], stacks: Sequence[Float32s], threads: int = 1
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
        self, chunks: Sequence[Chunk[Part]], operation: Operation[Part], stacks: Sequence[Float32s],
        results: Sequence[Float32s], progress: Callable[[int], None] | None, *,
        size: int, threads: int, adds: bool = False,
    ) -> KernelCounts:  # fmt: skip
        """Write the results of all chunks to stacks of the whole, or add them; `stacks` are not changed.

        `size`: number of samples of the whole, for its progress; `threads`: for a single chunk, which is processed
        here.
        """
        samples, truncated = 0.0, 0
        run = self.runner if len(chunks) > 1 else partial(in_turn, threads=threads)
        # Closing the generator stops the workers at once when an exception is raised here.
        with contextlib.closing(run(chunks, operation, stacks)) as answers:
            for done, (number, values, counts) in enumerate(_in_order(answers) if adds else answers, 1):
                place = chunks[number].place
                for result, part in zip(results, values, strict=True):
                    result[place] = result[place] + part if adds else part
                samples, truncated = samples + counts.samples, truncated + counts.truncated
                if progress is not None:
                    progress(size * done // len(chunks))
        return KernelCounts(samples, truncated)


def _in_order(answers: Answers) -> Answers:
    """Yield answers in the order of the chunks, for sums, whose rounding depends on it."""
    waiting: dict[int, tuple[Sequence[Float32s], KernelCounts]] = {}
    first = 0
    for number, values, counts in answers:
        waiting[number] = [part.copy() for part in values], counts
        while first in waiting:
            yield first, *waiting.pop(first)
            first += 1


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
