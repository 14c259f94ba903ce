"""Cutting polygons into triangles, for the surface that the kernels walk on.

Triangles stay as they are. A quad is cut along the diagonal that inverts neither triangle, the shorter one if both do
not. Larger polygons become fans around their first corner where that inverts no triangle, which includes all convex
ones; the others lose ears [2]_ in the plane of Newell's normal [1]_. Where a polygon crosses itself there is no right
answer, but the count is still n - 2.

References
----------
.. [1] M. E. Newell, R. G. Newell, T. L. Sancha, "A solution to the hidden surface problem", ACM 1972: the
   normal of a polygon that need not be flat.
.. [2] G. H. Meisters, "Polygons have ears", Amer. Math. Monthly 82 (1975). https://doi.org/10.2307/2319703
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Float64s, Int32s, Int64s
from beltrami_cli.errors import InputError
from beltrami_cli.surface.grouping import group_equal_rows

_BLOCK = 1 << 16  # polygons cut at a time, which bounds the memory for their corners
_MOST_EARS = 1 << 14  # corners of a polygon that is not convex: some ten seconds of work at most


def triangulate(positions: Float64s, corners: Int32s, offsets: Int64s) -> Int32s:
    """Cut polygons into triangles of the same orientation, in order: n - 2 for n corners, no new vertices."""
    # Polygon p has the corners ``corners[offsets[p]:offsets[p + 1]]``.
    sizes = np.diff(offsets)
    if sizes.size and (sizes == 3).all():
        return corners.reshape(-1, 3)
    rows = np.concatenate([[0], np.cumsum(np.maximum(sizes - 2, 0))])
    faces = np.empty((int(rows[-1]), 3), np.int32)
    for size in np.unique(sizes[sizes >= 3]).tolist():
        chosen = np.flatnonzero(sizes == size)
        for first in range(0, len(chosen), _BLOCK):
            block = chosen[first : first + _BLOCK, None]
            polygons = corners[offsets[block] + np.arange(size)]
            with np.errstate(over="ignore", invalid="ignore"):  # Areas of huge polygons count as no area.
                faces[rows[block] + np.arange(size - 2)] = _cut(positions, polygons)
    return faces


def triangulate_corners(positions: Float64s, corners: Int32s, offsets: Int64s) -> tuple[Int32s, Int64s]:
    """Cut polygons like `triangulate`; return indices into `corners`, and the polygon of each triangle."""
    cut = triangulate(positions[corners], np.arange(len(corners), dtype=np.int32), offsets)
    return cut, np.searchsorted(offsets, cut[:, 0], side="right") - 1


def dual(positions: Float64s, corners: Int32s, offsets: Int64s) -> tuple[Float64s, Int32s]:
    """Return the centroids of P polygons, shape (P, 3), and triangles that join those around each vertex."""
    sizes = np.diff(offsets)
    polygon = np.repeat(np.arange(len(sizes)), sizes)
    sums = [np.bincount(polygon, column, len(sizes)) for column in positions[corners].T]
    centroids = np.column_stack(sums) / np.maximum(sizes, 1)[:, None]
    place = group_equal_rows(*positions.T)[0][corners].astype(np.int64)
    after = np.arange(1, len(corners) + 1)
    after[offsets[1:][sizes > 0] - 1] = offsets[:-1][sizes > 0]
    # Across the edge from a corner to the next one lies the polygon that has this edge in the other direction.
    edges, reverse = (a * len(positions) + b for a, b in ((place, place[after]), (place[after], place)))
    order = np.argsort(edges, kind="stable")
    match = order[np.minimum(np.searchsorted(edges, reverse, sorter=order), len(order) - 1)]
    first = np.empty(len(positions), np.int64)
    first[place[::-1]] = polygon[::-1]
    fans = np.column_stack([first[place], polygon[match], polygon])[edges[match] == reverse]
    a, b, c = fans.T
    return centroids, fans[(a != b) & (b != c) & (c != a)].astype(np.int32)


def unrolled(strips: Int64s, ends: Int64s) -> Int64s:
    """Convert strips, which -1 restarts, to triangles, with every other one of a strip reversed."""
    if strips.size < 3:
        return np.empty((0, 3), np.int64)
    begins = np.zeros(len(strips), np.bool_)
    begins[ends[:-1][ends[:-1] < len(strips)]] = True
    begins[1:] |= strips[:-1] == -1
    numbers = np.arange(len(strips))
    since = numbers - np.maximum.accumulate(np.where(begins, numbers, 0))
    triangles = np.column_stack([strips[:-2], strips[1:-1], strips[2:]])
    odd = since[2:] % 2 == 1
    triangles[odd] = triangles[odd][:, [0, 2, 1]]
    a, b, c = triangles.T
    proper = (since[2:] >= 2) & (triangles >= 0).all(axis=1) & (a != b) & (b != c) & (c != a)
    return np.asarray(triangles[proper])


def _cut(positions: Float64s, polygons: Int32s) -> Int32s:
    """Cut polygons of one size, shape (P, n), into triangles of shape (P, n - 2, 3)."""
    size = polygons.shape[1]
    if size == 3:
        return polygons[:, None, :]
    # Relative to the first corner, so that meshes far from the origin lose no digits in the products.
    points = positions[polygons] - positions[polygons[:, :1]]
    if size == 4:
        return _cut_quads(points, polygons)
    fan = np.column_stack([np.zeros(size - 2, np.intp), np.arange(1, size - 1), np.arange(2, size)])
    cut = polygons[:, fan]
    normals = np.cross(points, np.roll(points, -1, axis=1)).sum(axis=1)
    areas = np.einsum("pfi,pi->pf", np.cross(points[:, 1:-1], points[:, 2:]), normals)
    for bad in np.flatnonzero((areas < 0).any(axis=1)).tolist():
        if size > _MOST_EARS:
            cause = f"a polygon of {size} corners is not convex; up to {_MOST_EARS} are cut into triangles"
            raise InputError("the mesh", cause, "triangulate it first")
        cut[bad] = polygons[bad][_ears(_flatten(points[bad], normals[bad]))]
    return cut


def _cut_quads(points: Float64s, quads: Int32s) -> Int32s:
    one = np.array([[0, 1, 2], [0, 2, 3]])
    other = np.array([[0, 1, 3], [1, 2, 3]])
    diagonals = points[:, 2] - points[:, 0], points[:, 3] - points[:, 1]
    normals = np.cross(*diagonals)
    lengths = [np.einsum("pi,pi->p", diagonal, diagonal) for diagonal in diagonals]
    # Whether both triangles look along the normal and have area.
    fine = []
    for cut in (one, other):
        triangles = points[:, cut]
        edges = triangles[:, :, 1:] - triangles[:, :, :1]
        areas = np.einsum("pti,pi->pt", np.cross(edges[:, :, 0], edges[:, :, 1]), normals)
        fine.append((areas > 0).all(axis=1))
    take_other = np.where(fine[0] == fine[1], lengths[1] < lengths[0], fine[1])
    return np.where(take_other[:, None, None], quads[:, other], quads[:, one])


def _flatten(points: Float64s, normal: Float64s) -> Float64s:
    """Drop the axis that the normal is closest to, keeping the polygon counter-clockwise."""
    axis = int(np.argmax(np.abs(normal)))
    first, second = (axis + 1) % 3, (axis + 2) % 3
    if normal[axis] < 0:
        first, second = second, first
    return points[:, [first, second]]


def _ears(points: Float64s) -> NDArray[np.intp]:
    """Cut a counter-clockwise polygon, shape (n, 2), into triangles, shape (n - 2, 3), by taking ears off."""
    # Only the two neighbours of an ear can become ears, or cease to be any, when it is taken off. So the
    # work grows with the square of n, whatever the polygon is like.
    ring = _Ring(points)
    ears = [ring.is_ear(tip) for tip in range(len(points))]
    triangles, at = [], 0
    for left in range(len(points), 3, -1):
        tip = at
        for _ in range(left):
            if ears[tip]:
                break
            tip = ring.after[tip]
        else:  # The polygon crosses itself.
            tip = at
        before, at = ring.before[tip], ring.after[tip]  # Going on behind the gap spreads the corners.
        triangles.append((before, tip, at))
        ring.take_off(tip)
        ears[before], ears[at] = ring.is_ear(before), ring.is_ear(at)
    triangles.append((ring.before[at], at, ring.after[at]))
    return np.array(triangles, np.intp)


class _Ring:
    """The remaining corners of a polygon: the previous and next of each, and which remain."""

    def __init__(self, points: Float64s) -> None:
        count = len(points)
        self._x, self._y = points.T
        self._left = np.ones(count, bool)
        self.before, self.after = [count - 1, *range(count - 1)], [*range(1, count), 0]

    def take_off(self, tip: int) -> None:
        """Join the neighbours of a corner."""
        before, after = self.before[tip], self.after[tip]
        self.after[before], self.before[after] = after, before
        self._left[tip] = False

    def is_ear(self, tip: int) -> bool:
        """Return whether a corner and its neighbours form a triangle that looks up and holds no other."""
        corners = self.before[tip], tip, self.after[tip]
        (ax, ay), (bx, by), (cx, cy) = ((float(self._x[i]), float(self._y[i])) for i in corners)
        if (bx - ax) * (cy - ay) - (by - ay) * (cx - ax) <= 0:
            return False
        x, y = self._x, self._y
        inside = self._left & ((bx - ax) * (y - ay) - (by - ay) * (x - ax) >= 0)
        inside &= (cx - bx) * (y - by) - (cy - by) * (x - bx) >= 0
        inside &= (ax - cx) * (y - cy) - (ay - cy) * (x - cx) >= 0
        for px, py in ((ax, ay), (bx, by), (cx, cy)):
            inside &= (x != px) | (y != py)
        return not inside.any()
