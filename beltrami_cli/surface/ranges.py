"""Ranges of numbers, one for each row of a table."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from beltrami_cli.arrays import Array, Int64s

_BLOCK = 1 << 20


def expanded(starts: Int64s, counts: Int64s) -> tuple[Int64s, Int64s]:
    """Return start, start + 1, ... for each row, and the row of each number."""
    owner = np.repeat(np.arange(len(counts)), counts)
    return starts[owner] + np.arange(len(owner)) - (np.cumsum(counts) - counts)[owner], owner


def entries(offsets: Int64s, rows: Array) -> tuple[Int64s, Int64s]:
    """Return the positions of all entries of some rows, row after row, and their number in each row.

    Row i has the entries ``offsets[i]`` to ``offsets[i + 1]``.
    """
    counts = offsets[rows + 1] - offsets[rows]
    return expanded(offsets[rows], counts)[0], counts


def runs_of(counts: Int64s) -> Iterator[slice]:
    """Split rows into runs whose counts sum to about a million, to bound memory."""
    sums, first = np.cumsum(counts), 0
    while first < len(counts):
        done = sums[first - 1] if first else 0
        last = max(first + 1, int(np.searchsorted(sums, done + _BLOCK, side="right")))
        yield slice(first, last)
        first = last
