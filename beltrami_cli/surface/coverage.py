"""Coverage of texels by triangles, and overlaps of these."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Bools, Float64s, Int64s
from beltrami_cli.surface.geometry import cross_in_plane
from beltrami_cli.surface.grouping import group_equal_rows
from beltrami_cli.surface.ranges import expanded, runs_of

EDGE = 1e-9
"""Barycentric tolerance: centres on an edge are inside, whichever way they are rounded."""


@dataclass(frozen=True)
class Cover:
    texels: Int64s  # (K,): row * width + column
    faces: Int64s  # (K,): their triangles
    # Shape (K, 2): barycentric weights of the second and third corner; for texels inside, not below 0 up to rounding.
    weights: Float64s

    @property
    def inside(self) -> Bools:
        """Whether each centre is in the triangle, edges included."""
        all_three = np.column_stack([self.weights, 1 - self.weights.sum(axis=1)])
        return np.asarray(np.all(all_three >= -EDGE, axis=1))


def cover(
    uv: Float64s, size: tuple[int, int], reach: float = 0.0, chosen: NDArray[np.intp] | None = None
) -> Iterator[Cover]:
    """Yield texels whose centres are in triangles with an area, or up to `reach` texels outside."""
    corners = uv * size - 0.5  # so that centres are integers
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = cross_in_plane(one, two)
    faces = np.flatnonzero(area) if chosen is None else chosen[area[chosen] != 0]
    y = corners[faces][:, :, 1]
    low, high = _between(y.min(axis=1), y.max(axis=1), reach, size[1])
    counts = np.maximum(high - low + 1, 0)
    for block in runs_of(counts):
        rows, owner = expanded(low[block], counts[block])
        first, last = _columns(corners[faces[block]][owner], rows, reach, size[0])
        lengths = np.maximum(last - first + 1, 0)
        for part in runs_of(lengths):
            column, span = expanded(first[part], lengths[part])
            row, face = rows[part][span], faces[block][owner[part][span]]
            offset = np.stack([column, row], axis=1) - corners[face, 0]
            weights = np.stack([cross_in_plane(offset, two[face]), cross_in_plane(one[face], offset)], axis=1)
            yield Cover(row * size[0] + column, face, weights / area[face][:, None])


def border_faces(uv: Float64s) -> NDArray[np.intp]:
    """Return the triangles with an edge that no other triangle shares in the image."""
    point_of, _ = group_equal_rows(*uv.reshape(-1, 2).T)
    points = point_of.reshape(-1, 3)
    edges = np.sort(np.stack([points, np.roll(points, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    edge_of, _ = group_equal_rows(*edges.T)
    alone = np.bincount(edge_of)[edge_of] == 1
    return np.flatnonzero(alone.reshape(-1, 3).any(axis=1))


def _between(low: Float64s, high: Float64s, reach: float, count: int) -> tuple[Int64s, Int64s]:
    """Return the first and last integer between two numbers, or up to `reach` beyond."""
    first = np.ceil(np.clip(low - reach - EDGE, -1, count))
    last = np.floor(np.clip(high + reach + EDGE, -1, count))
    return np.maximum(first, 0).astype(np.int64), np.minimum(last, count - 1).astype(np.int64)


def _columns(corners: Float64s, rows: Int64s, reach: float, width: int) -> tuple[Int64s, Int64s]:
    """Return the first and last column of each triangle in a row, from its edges within the strip of the row."""
    ends = np.roll(corners, -1, axis=1)
    (ax, ay), (bx, by) = np.moveaxis(corners, 2, 0), np.moveaxis(ends, 2, 0)
    top, bottom = (rows - reach - EDGE)[:, None], (rows + reach + EDGE)[:, None]
    enter = np.clip(top, np.minimum(ay, by), np.maximum(ay, by))
    leave = np.clip(bottom, np.minimum(ay, by), np.maximum(ay, by))
    crosses = (np.maximum(ay, by) >= top) & (np.minimum(ay, by) <= bottom)
    level = ay == by
    rise = np.where(level, 1.0, by - ay)
    one = np.where(level, ax, ax + (enter - ay) / rise * (bx - ax))
    other = np.where(level, bx, ax + (leave - ay) / rise * (bx - ax))
    low = np.where(crosses, np.minimum(one, other), np.inf).min(axis=1)
    high = np.where(crosses, np.maximum(one, other), -np.inf).max(axis=1)
    return _between(low, high, reach, width)


def overlap(uv: Float64s, size: tuple[int, int]) -> float:
    """Return the share of the covered texels that are inside more than one triangle."""
    hits = np.zeros(size[0] * size[1], np.int32)
    for part in cover(uv, size):
        weights = part.weights
        strictly = (weights > 1e-6).all(axis=1) & (weights.sum(axis=1) < 1 - 1e-6)
        np.add.at(hits, part.texels[strictly], 1)
    return float((hits > 1).sum() / max(1, (hits > 0).sum()))
