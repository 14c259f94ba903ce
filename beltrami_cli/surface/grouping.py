"""Equal rows found by hashing: what is at one place, what is one sample."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.arrays import Array, Bools, Float64s, Int32s

# Odd constants of the splitmix64 generator (Steele, Lea, Flood 2014): each step is a bijection of 64-bit
# words.
_INCREMENT = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)


def group_equal_rows(*columns: Array) -> tuple[Int32s, Int32s]:
    """Find the distinct rows of a table, numbered by their first row: each row's number, and first rows."""
    # Columns are of any integer or floating type, without NaN; -0.0 equals 0.0.
    words = [_as_words(column) for column in columns]
    hashed = np.zeros(len(words[0]), np.uint64)
    for word in words:
        hashed = mix_bits(hashed ^ word)
    ascending = np.sort(hashed)
    if not np.any(ascending[1:] == ascending[:-1]):  # as in most files; to sort alone is quick
        every = np.arange(len(hashed), dtype=np.int32)
        return every, every.copy()
    order = np.argsort(hashed, kind="stable")
    new = np.ones(len(order), bool)
    new[1:] = False
    same_hash = hashed[order][1:] == hashed[order][:-1]
    for word in words:
        new[1:] |= word[order][1:] != word[order][:-1]
    if np.any(new[1:] & same_hash):  # two different rows with one hash: sort by the rows themselves
        order = np.lexsort(words)
        new[1:] = False
        for word in words:
            new[1:] |= word[order][1:] != word[order][:-1]
    return _number_by_first(order, new)


def group_places(positions: Float64s, space_of: Int32s | None) -> tuple[Int32s, Int32s]:
    """Find the distinct positions, each in its space, as `group_equal_rows` does."""
    return group_equal_rows(*positions.T, *([] if space_of is None else [space_of]))


def distinct_corners(*columns: NDArray[np.generic]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Find the distinct rows of a table, numbered by the order of their values: a row of each, and numbers."""
    order = np.lexsort(columns[::-1])
    new = np.zeros(len(order), bool)
    new[:1] = True
    for column in columns:
        new[1:] |= column[order][1:] != column[order][:-1]
    number_of = np.empty(len(order), np.intp)
    number_of[order] = np.cumsum(new) - 1
    return order[new], number_of


def _number_by_first(order: NDArray[np.intp], new: Bools) -> tuple[Int32s, Int32s]:
    # The sort is stable, so the first member of a run is the group's first row.
    runs = np.cumsum(new) - 1
    first_of_run = order[new]
    by_first = np.argsort(first_of_run)
    rank = np.empty(len(by_first), np.int32)
    rank[by_first] = np.arange(len(by_first), dtype=np.int32)
    group_of = np.empty(len(order), np.int32)
    group_of[order] = rank[runs]
    return group_of, first_of_run[by_first].astype(np.int32)


def _as_words(column: Array) -> NDArray[np.uint64]:
    if column.dtype.kind == "f":
        return (column.astype(np.float64) + 0.0).view(np.uint64)
    return column.astype(np.int64).view(np.uint64)


def mix_bits(word: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Scatter the bits of words, each to another word."""
    word = word + _INCREMENT
    word = (word ^ (word >> np.uint64(30))) * _MIX_1
    word = (word ^ (word >> np.uint64(27))) * _MIX_2
    return word ^ (word >> np.uint64(31))
