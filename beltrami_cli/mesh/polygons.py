"""Cutting polygons into triangles, for the surface that the kernels walk on.

References
----------
.. [1] M. E. Newell, R. G. Newell, T. L. Sancha, "A solution to the hidden surface problem", ACM 1972: the
   normal of a polygon that need not be flat.
.. [2] G. H. Meisters, "Polygons have ears", Amer. Math. Monthly 82 (1975). https://doi.org/10.2307/2319703
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

Point = tuple[float, float]

_BLOCK = 1 << 16  # polygons cut at a time, which bounds the memory for their corners


def triangulate(
    positions: NDArray[np.float64], corners: NDArray[np.int32], offsets: NDArray[np.int64]
) -> NDArray[np.int32]:
    """Cut polygons into triangles without new vertices.

    Parameters
    ----------
    positions : ndarray of float64, shape (V, 3)
        Finite vertex positions, any unit.
    corners : ndarray of int32, shape (K,)
        The corners of all polygons one after the other, each in [0, V).
    offsets : ndarray of int64, shape (P + 1,)
        Polygon p has the corners ``corners[offsets[p]:offsets[p + 1]]``.

    Returns
    -------
    ndarray of int32, shape (F, 3)
        n - 2 triangles for every polygon of n corners, in the order and the orientation of the polygons;
        none for polygons of fewer than three corners.

    Notes
    -----
    Triangles stay as they are. A quad is cut along the diagonal that inverts neither triangle, the shorter
    one if both do not. Larger polygons become fans around their first corner where that inverts no
    triangle, which includes all convex ones; the others lose ears in the plane of Newell's normal. Where
    a polygon crosses itself there is no right answer, but the count is still n - 2.
    """
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


def triangulate_corners(
    positions: NDArray[np.float64], corners: NDArray[np.int32], offsets: NDArray[np.int64]
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Cut polygons like `triangulate`, but tell which corners the triangles have, not only which vertices.

    Parameters
    ----------
    positions, corners, offsets : ndarray
        As for `triangulate`.

    Returns
    -------
    cut : ndarray of int32, shape (F, 3)
        Indices into `corners`; ``corners[cut]`` is what `triangulate` returns.
    polygon : ndarray of int64, shape (F,)
        The polygon that each triangle is part of.
    """
    cut = triangulate(positions[corners], np.arange(len(corners), dtype=np.int32), offsets)
    return cut, np.searchsorted(offsets, cut[:, 0], side="right") - 1


def _cut(positions: NDArray[np.float64], polygons: NDArray[np.int32]) -> NDArray[np.int32]:
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
        cut[bad] = polygons[bad][_ears(_flatten(points[bad], normals[bad]))]
    return cut


def _cut_quads(points: NDArray[np.float64], quads: NDArray[np.int32]) -> NDArray[np.int32]:
    one = np.array([[0, 1, 2], [0, 2, 3]])
    other = np.array([[0, 1, 3], [1, 2, 3]])
    diagonals = points[:, 2] - points[:, 0], points[:, 3] - points[:, 1]
    normals = np.cross(*diagonals)
    lengths = [np.einsum("pi,pi->p", diagonal, diagonal) for diagonal in diagonals]
    fine = [_upright(points[:, cut], normals) for cut in (one, other)]
    take_other = np.where(fine[0] == fine[1], lengths[1] < lengths[0], fine[1])
    return np.where(take_other[:, None, None], quads[:, other], quads[:, one])


def _upright(triangles: NDArray[np.float64], normals: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell for pairs of triangles, shape (P, 2, 3, 3), whether both look along the normal and have area."""
    edges = triangles[:, :, 1:] - triangles[:, :, :1]
    areas = np.einsum("pti,pi->pt", np.cross(edges[:, :, 0], edges[:, :, 1]), normals)
    upright: NDArray[np.bool_] = (areas > 0).all(axis=1)
    return upright


def _flatten(points: NDArray[np.float64], normal: NDArray[np.float64]) -> list[Point]:
    """Drop the axis that the normal is closest to, keeping the polygon counter-clockwise."""
    axis = int(np.argmax(np.abs(normal)))
    first, second = (axis + 1) % 3, (axis + 2) % 3
    if normal[axis] < 0:
        first, second = second, first
    return [(x, y) for x, y in points[:, [first, second]].tolist()]


def _ears(points: Sequence[Point]) -> NDArray[np.intp]:
    """Cut a counter-clockwise polygon of n points by taking ears off, in triangles of shape (n - 2, 3)."""
    ring = list(range(len(points)))
    triangles = []
    at = 0
    while len(ring) > 3:
        for step in range(len(ring)):
            tip = (at + step) % len(ring)
            if _is_ear(points, ring, tip):
                break
        else:  # The polygon crosses itself.
            tip = at % len(ring)
        triangles.append((ring[tip - 1], ring[tip], ring[(tip + 1) % len(ring)]))
        del ring[tip]
        at = tip  # Going on behind the gap, so that the triangles do not all meet in one corner.
    triangles.append((ring[0], ring[1], ring[2]))
    return np.array(triangles, np.intp)


def _is_ear(points: Sequence[Point], ring: Sequence[int], tip: int) -> bool:
    a, b, c = (points[ring[(tip + step) % len(ring)]] for step in (-1, 0, 1))
    if _turn(a, b, c) <= 0:
        return False
    for index in ring:
        p = points[index]
        inside = _turn(a, b, p) >= 0 and _turn(b, c, p) >= 0 and _turn(c, a, p) >= 0
        if inside and p not in (a, b, c):
            return False
    return True


def _turn(a: Point, b: Point, c: Point) -> float:
    """Twice the signed area of a triangle, positive if it is counter-clockwise."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
