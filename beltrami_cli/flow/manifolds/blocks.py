"""Passes over stacks in blocks, several at a time."""

from __future__ import annotations

import contextlib
from _thread import start_new_thread
from collections.abc import Callable, Iterable, Iterator
from threading import Lock
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array
from beltrami_cli.surface import large_arrays

# Rows of a canvas per block for steps that need temporary memory. The rounding of sums depends on it.
SUMMED_ROWS = 64


def in_blocks(axis: int, *stacks: Array) -> Iterator[tuple[Array, ...]]:
    """Yield blocks of several stacks together, with the channels moved from `axis` to the front."""
    whole = [np.moveaxis(stack, axis, 0) for stack in stacks]
    for rows in block_rows(whole[0]):
        yield tuple(stack[:, rows] for stack in whole)


def block_rows(stack: Array, side: int = 1) -> Iterator[slice]:
    """Yield slices of rows of a stack whose channels come first, in multiples of `side` rows."""
    size = max(1, large_arrays.CACHED // max(1, side * stack[0, :1].size)) * side
    return large_arrays.blocks(stack.shape[1], size)


def for_blocks(work: Callable[..., object], threads: int, axis: int, *stacks: Array) -> None:
    """Call `work` with blocks of stacks, several in parallel; it may change only its own block."""
    in_parallel(work, threads, in_blocks(axis, *stacks))


def in_parallel(work: Callable[..., object], threads: int, blocks: Iterable[tuple[Any, ...]]) -> None:
    """Call `work` with the arguments of each block, in parallel threads, this one included.

    Pools of the standard library wait forever for a thread that could not begin for lack of memory. Here, only threads
    that have taken a block are waited for, and nothing is allocated to report that one failed.
    """
    left, lock = iter(blocks), Lock()
    idle = [Lock() for _ in range(threads)]
    failures: list[BaseException | None] = [None] * threads

    def run(thread: int) -> None:
        try:
            while True:
                with lock:
                    block = None if any(failures) else next(left, None)
                    if block is None:
                        return
                    idle[thread].acquire(blocking=False)
                work(*block)
        except BaseException as error:  # KeyboardInterrupt, too: raised again when the others have stopped
            failures[thread] = error
        finally:
            if idle[thread].locked():
                idle[thread].release()

    for thread in range(1, threads):
        with contextlib.suppress(RuntimeError):  # no further thread can be started: fewer do the work
            start_new_thread(run, (thread,))
    run(0)
    for each in idle:
        each.acquire()
    for error in failures:
        if error is not None:
            raise error
