"""Polygons: cut into triangles, their duals, and strips of triangles.

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

from beltrami_cli.arrays import Bools, Float64s, Int32s, Int64s
from beltrami_cli.errors import InputError
from beltrami_cli.surface.grouping import group_equal_rows

_BLOCK = 1 << 16  # polygons processed at a time, to bound memory
_MAX_EARS = 1 << 14  # corners of a concave polygon, for at most ten seconds of work


def triangulate(positions: Float64s, corners: Int32s, offsets: Int64s) -> Int32s:
    """Cut polygons into triangles of the same orientation, in order: n - 2 per n corners, without new vertices."""
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
    every = np.arange(len(corners), dtype=np.int32)
    if (np.diff(offsets) == 3).all():
        return every.reshape(-1, 3), np.arange(len(offsets) - 1)
    cut = triangulate(positions[corners], every, offsets)
    return cut, np.searchsorted(offsets, cut[:, 0], side="right") - 1


def polygons_of(offsets: Int64s) -> Int64s:
    return np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))


def polygons_with(marked: Bools, offsets: Int64s) -> Bools:
    return np.bincount(polygons_of(offsets)[marked], minlength=len(offsets) - 1) > 0


def dual(positions: Float64s, corners: Int32s, offsets: Int64s) -> tuple[Float64s, Int32s]:
    """Return the centroids of P polygons, shape (P, 3), and triangles that join those around each vertex."""
    sizes, polygon = np.diff(offsets), polygons_of(offsets)
    sums = [np.bincount(polygon, column, len(sizes)) for column in positions[corners].T]
    centroids = np.column_stack(sums) / np.maximum(sizes, 1)[:, None]
    place = group_equal_rows(*positions.T)[0][corners].astype(np.int64)
    after = np.arange(1, len(corners) + 1)
    after[offsets[1:][sizes > 0] - 1] = offsets[:-1][sizes > 0]
    # The polygon across the edge from a corner to the next has this edge in the opposite direction.
    edges, reverse = (a * len(positions) + b for a, b in ((place, place[after]), (place[after], place)))
    order = np.argsort(edges, kind="stable")
    match = order[np.minimum(np.searchsorted(edges, reverse, sorter=order), len(order) - 1)]
    first = np.empty(len(positions), np.int64)
    first[place[::-1]] = polygon[::-1]
    fans = np.column_stack([first[place], polygon[match], polygon])[edges[match] == reverse]
    a, b, c = fans.T
    return centroids, fans[(a != b) & (b != c) & (c != a)].astype(np.int32)


def unrolled(strips: Int64s, ends: Int64s) -> Int64s:
    """Convert triangle strips, which -1 restarts, to triangles; every second one of a strip is reversed."""
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
    # Relative to the first corner, so that products keep their digits far from the origin.
    points = positions[polygons] - positions[polygons[:, :1]]
    if size == 4:
        return _cut_quads(points, polygons)
    fan = np.column_stack([np.zeros(size - 2, np.intp), np.arange(1, size - 1), np.arange(2, size)])
    cut = polygons[:, fan]
    normals = np.cross(points, np.roll(points, -1, axis=1)).sum(axis=1)
    areas = np.einsum("pfi,pi->pf", np.cross(points[:, 1:-1], points[:, 2:]), normals)
    for bad in np.flatnonzero((areas < 0).any(axis=1)).tolist():
        if size > _MAX_EARS:
            cause = f"a polygon of {size} corners is not convex; up to {_MAX_EARS} are cut into triangles"
            raise InputError("the mesh", cause, "triangulate it first")
        # Project along the axis closest to the normal, which keeps the polygon counter-clockwise.
        axis = int(np.argmax(np.abs(normals[bad])))
        axes = [(axis + 1) % 3, (axis + 2) % 3][:: -1 if normals[bad, axis] < 0 else 1]
        cut[bad] = polygons[bad][_ears(points[bad][:, axes])]
    return cut


def _cut_quads(points: Float64s, quads: Int32s) -> Int32s:
    one = np.array([[0, 1, 2], [0, 2, 3]])
    other = np.array([[0, 1, 3], [1, 2, 3]])
    diagonals = points[:, 2] - points[:, 0], points[:, 3] - points[:, 1]
    normals = np.cross(*diagonals)
    lengths = [np.einsum("pi,pi->p", diagonal, diagonal) for diagonal in diagonals]
    # Whether both triangles face along the normal and have an area.
    fine = []
    for cut in (one, other):
        triangles = points[:, cut]
        edges = triangles[:, :, 1:] - triangles[:, :, :1]
        areas = np.einsum("pti,pi->pt", np.cross(edges[:, :, 0], edges[:, :, 1]), normals)
        fine.append((areas > 0).all(axis=1))
    take_other = np.where(fine[0] == fine[1], lengths[1] < lengths[0], fine[1])
    return np.where(take_other[:, None, None], quads[:, other], quads[:, one])


def _ears(points: Float64s) -> NDArray[np.intp]:
    """Triangulate a counter-clockwise polygon, shape (n, 2), by ear clipping, shape (n - 2, 3)."""
    # Clipping an ear can change only its two neighbours. So the work is quadratic in n for any polygon.
    left, is_left, triangles, at = [*range(len(points))], np.ones(len(points), bool), [], 0
    axes = np.ascontiguousarray(points.T)
    ears = [_is_ear(axes, left, tip, is_left) for tip in left]
    while len(left) > 3:
        # A self-intersecting polygon may have none.
        tip = next((tip for tip in (*range(at, len(left)), *range(at)) if ears[tip]), at)
        triangles.append((left[tip - 1], left[tip], left[(tip + 1) % len(left)]))
        is_left[left[tip]] = False
        del left[tip], ears[tip]
        at = tip % len(left)  # continue behind the gap to spread the corners
        for neighbour in (at - 1, at):
            ears[neighbour] = _is_ear(axes, left, neighbour, is_left)
    triangles.append((left[at - 1], left[at], left[(at + 1) % 3]))
    return np.array(triangles, np.intp)


def _is_ear(axes: Float64s, left: list[int], tip: int, is_left: Bools) -> bool:
    """Whether a corner and its neighbours form a triangle that faces up and contains no other corner."""
    x, y = axes
    (ax, bx, cx), (ay, by, cy) = axes[:, [left[tip - 1], left[tip], left[(tip + 1) % len(left)]]].tolist()
    if (bx - ax) * (cy - ay) - (by - ay) * (cx - ax) <= 0:
        return False
    inside = is_left.copy()
    for sx, sy, ex, ey in ((ax, ay, bx, by), (bx, by, cx, cy), (cx, cy, ax, ay)):
        inside &= (ex - sx) * (y - sy) - (ey - sy) * (x - sx) >= 0
        inside &= (x != sx) | (y != sy)
    return not inside.any()
