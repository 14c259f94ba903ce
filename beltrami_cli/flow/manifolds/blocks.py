"""Passes over stacks in blocks, several at a time."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array
from beltrami_cli.surface import large_arrays


def in_blocks(axis: int, *stacks: Array) -> Iterator[tuple[Array, ...]]:
    """Yield blocks of several stacks together, with the channels moved from `axis` to the front."""
    whole = [np.moveaxis(stack, axis, 0) for stack in stacks]
    for rows in block_rows(whole[0]):
        yield tuple(stack[:, rows] for stack in whole)


def block_rows(stack: Array, side: int = 1) -> Iterator[slice]:
    """Yield slices of rows of a stack whose channels come first, in multiples of `side` rows."""
    size = max(1, large_arrays.CACHED // max(1, side * stack[0, :1].size)) * side
    return large_arrays.blocks(stack.shape[1], size)


def for_blocks(
    work: Callable[..., object], threads: int, axis: int, *stacks: Array, planes: Sequence[Array] = ()
) -> None:
    """Call `work` with blocks of stacks and planes, several in parallel; it may change only its own block."""
    blocks = in_blocks(axis, *stacks)
    if planes:
        blocks = ((*own, *others) for own, others in zip(blocks, in_blocks(0, *planes), strict=True))
    in_parallel(work, threads, blocks)


def in_parallel(work: Callable[..., object], threads: int, blocks: Iterable[tuple[Any, ...]]) -> None:
    """Call `work` with the arguments of each block, in parallel threads."""
    if threads == 1:
        for block in blocks:
            work(*block)
        return
    waiting = deque[Future[object]]()
    with ThreadPoolExecutor(threads) as pool:
        for block in blocks:
            waiting.append(pool.submit(work, *block))
            if len(waiting) > threads:  # so that an interruption waits for few calls
                waiting.popleft().result()
        for each in waiting:
            each.result()
