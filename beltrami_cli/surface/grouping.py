"""Grouping of equal rows by hashing, of vertices at one place, and of connected nodes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Array, Bools, Float64s, Int32s, Int64s
from beltrami_cli.surface.precision import typical_edge

# Odd constants of the splitmix64 generator (Steele, Lea, Flood 2014); each step is a bijection of 64-bit words.
_INCREMENT = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)


def group_equal_rows(*columns: Array) -> tuple[Int32s, Int32s]:
    """Find the distinct rows of a table; return the number of each row, and the first row of each number."""
    # Columns have any integer or floating type, without NaN; -0.0 equals 0.0.
    words = []
    for column in columns:
        is_float = column.dtype.kind == "f"
        words.append(
            (column.astype(np.float64) + 0.0 if is_float else column.astype(np.int64)).view(np.uint64)
        )
    hashed = np.zeros(len(words[0]), np.uint64)
    for word in words:
        hashed = mix_bits(hashed ^ word)
    ascending = np.sort(hashed)
    if not np.any(ascending[1:] == ascending[:-1]):  # the usual case, in which sorting suffices
        every = np.arange(len(hashed), dtype=np.int32)
        return every, every.copy()
    order = np.argsort(hashed, kind="stable")
    new, same_hash = _run_starts(words, order), hashed[order][1:] == hashed[order][:-1]
    if np.any(new[1:] & same_hash):  # hash collision: sort by the rows themselves
        order = np.lexsort(words)
        new = _run_starts(words, order)
    # The sort is stable, so the first member of a run is the first row of the group.
    first_of_run = order[new]
    by_first = np.argsort(first_of_run)
    rank = np.empty(len(by_first), np.int32)
    rank[by_first] = np.arange(len(by_first), dtype=np.int32)
    group_of = np.empty(len(order), np.int32)
    group_of[order] = rank[np.cumsum(new) - 1]
    return group_of, first_of_run[by_first].astype(np.int32)


def _run_starts(columns: Sequence[Array], order: NDArray[np.intp]) -> Bools:
    """Return which rows, in an order, differ from the row before."""
    new = np.zeros(len(order), bool)
    new[:1] = True
    for column in columns:
        new[1:] |= column[order][1:] != column[order][:-1]
    return new


# Maximum difference between copies of a vertex, in units in the last place of the largest coordinate: either copy may
# be rounded by half a unit in four operations, such as a rotation and an offset.
_ROUNDED_UNITS = 4
# Minimum ratio of a typical edge to the tolerance: else rounding is as coarse as details of the mesh.
_EDGE_OF_TOLERANCE = 64
# More than twice the tolerance, so that along each axis at least one of two shifted grids has both copies in one cell.
_CELL_OF_TOLERANCE = 4
_SINGLE_EPS = np.finfo(np.float32).eps
_SAMPLED_VALUES = 10_000  # number of coordinates whose digits are counted
_MAX_DECIMALS = 9  # of single-precision coordinates in text


def group_places(
    positions: Float64s, space_of: Int32s | None, faces: Int32s | None = None
) -> tuple[Int32s, Int32s]:
    """Find the distinct positions in each space, as `group_equal_rows`.

    Vertices at open borders are merged if they differ only by rounding, unless an edge joins any two of them.
    """
    spaces = [] if space_of is None else [space_of]
    place_of, first = group_equal_rows(*positions.T, *spaces)
    if faces is None or not len(faces):
        return place_of, first
    tolerance = _tolerance(positions)
    if not tolerance * _EDGE_OF_TOLERANCE <= typical_edge(positions, faces):
        return place_of, first
    corners = place_of[faces]
    border = _open_places(corners, len(first))
    if not len(border):
        return place_of, first
    rows = first[border]
    pairs = border[_near(positions[rows], tolerance, [each[rows] for each in spaces])]
    return _merged_places(place_of, first, corners, pairs) if len(pairs) else (place_of, first)


def _tolerance(positions: Float64s) -> float:
    """Return the maximum difference of copies' coordinates, from the precision in which they are stored."""
    with np.errstate(over="ignore"):
        if (positions.astype(np.float32) == positions).all():
            return _ROUNDED_UNITS * float(np.spacing(np.float32(np.abs(positions).max())))
        # Doubles may have an offset added, or be rotated by a scene node, but most programs compute meshes in single
        # precision.
        computed = _ROUNDED_UNITS * float(_SINGLE_EPS * np.ptp(positions, axis=0).max())
        values = positions.ravel()[:: 1 + positions.size // _SAMPLED_VALUES]
        for decimals in range(_MAX_DECIMALS + 1):
            scaled = np.abs(values * 10.0**decimals)
            if (np.abs(scaled - np.rint(scaled)) <= np.spacing(scaled)).all():
                # In text, copies may differ by one in the last digit.
                return max(computed, 1.5 * 10.0**-decimals)
    return computed


def _open_places(corners: Int32s, count: int) -> Int64s:
    """Return the places whose triangles do not form a closed fan."""
    # In a closed fan every neighbour comes once before and once after another. Numbers are hashed, so that no other set
    # has the same sum, and sums are exact.
    number = (mix_bits(np.arange(count, dtype=np.uint64)) >> np.uint64(34)).astype(np.float64)
    balance = np.zeros(count)
    for corner in range(3):
        steps = number[corners[:, (corner + 1) % 3]] - number[corners[:, (corner + 2) % 3]]
        balance += np.bincount(corners[:, corner], steps, count)
    return np.flatnonzero(balance)


def _near(points: Float64s, tolerance: float, further: Sequence[Array]) -> Int64s:
    """Return pairs of points, (K, 2), that differ by at most a tolerance per coordinate, and not in `further`."""
    every, pairs = np.arange(len(points)), []
    for shift in product((0, 0.5), repeat=points.shape[1]):
        cells = np.floor(points / (_CELL_OF_TOLERANCE * tolerance) + shift)
        number, first = group_equal_rows(*cells.T, *further)
        if len(first) == len(points):
            continue
        others = first[number]
        near = (np.abs(points - points[others]) <= tolerance).all(axis=1) & (others != every)
        pairs.append(np.stack([others[near], every[near]], axis=1))
    return np.concatenate(pairs) if pairs else np.zeros((0, 2), np.int64)


def _merged_places(place_of: Int32s, first: Int32s, corners: Int32s, pairs: Int64s) -> tuple[Int32s, Int32s]:
    """Merge places connected by pairs, unless an edge joins two places that would become one."""
    every, count = np.arange(len(first), dtype=np.int32), len(first)
    label = connected(count, pairs)
    _, least = np.unique(label, return_index=True)
    joined = least[label].astype(np.int32)  # the first place of each group
    ends = joined[corners]
    is_edge = (ends == np.roll(ends, 1, axis=1)) & (corners != np.roll(corners, 1, axis=1))
    has_edge = np.zeros(count, bool)
    has_edge[ends[is_edge]] = True
    joined = np.where(has_edge[joined], every, joined)
    kept = joined == every
    number = (np.cumsum(kept) - 1).astype(np.int32)
    return number[joined][place_of], first[kept]


def connected(count: int, pairs: NDArray[np.integer[Any]]) -> Int32s:
    """Return the connected component of each of `count` nodes, joined by pairs, (K, 2); numbered from 0."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(pairs), bool), pairs.T), (count, count))
    return np.asarray(connected_components(graph, directed=False)[1], np.int32)


def mix_bits(word: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Hash words by a bijection."""
    word = word + _INCREMENT
    word = (word ^ (word >> np.uint64(30))) * _MIX_1
    word = (word ^ (word >> np.uint64(27))) * _MIX_2
    return word ^ (word >> np.uint64(31))
