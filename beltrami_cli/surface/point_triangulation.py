"""Points without faces: triangles of the surface around each, in its tangent plane.

Around each point its nearest neighbours are laid out in the tangent plane, which principal axes give [1]_, and the
Delaunay triangles that hold the point are taken [2]_. Triangles on which two of their points agree remain. The local
spacing limits how large they are and how far from the plane, so that holes stay open and thin sheets apart. The result
follows rotations, shifts, scales and permutations of the points; of four points on one empty circle, as on grids, it
has all four triangles. A point in none of them is an outlier: it lies too far from others, in spacings of these, or
they lie in one line.

References
----------
.. [1] H. Hoppe et al., "Surface reconstruction from unorganized points", SIGGRAPH 1992, doi:10.1145/133994.134011
.. [2] N. Sharp, K. Crane, "A Laplacian for nonmanifold triangle meshes", Computer Graphics Forum 39(5), 2020,
   doi:10.1111/cgf.14069
"""

from __future__ import annotations

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s, Int32s
from beltrami_cli.surface.grouping import group_places
from beltrami_cli.surface.records import PaintedVertices

# Nearest neighbours asked for, until there are enough to know a point's triangles: usually the first number
# does, on rims and between the lines of a scanner the last may not.
_NEIGHBOURS = (24, 64, 192)
BLOCK = 1 << 17  # points asked for at a time, which bounds the memory that their neighbours take


def faces_of_points(painted: PaintedVertices, threads: int) -> Int32s:
    """Find triangles between painted points in at most three dimensions, whose own faces do not count."""
    # Coincident points are each a corner of the triangles that their place has.
    place_of, first = group_places(painted.positions, painted.space_of)
    spaces = None if painted.space_of is None else painted.space_of[first]
    faces = _triangulate_spaces(painted.positions[first], spaces, threads)
    return first[faces] if len(first) == len(place_of) else _with_copies(faces, place_of, painted.colours)


def triangulate_points(positions: Float64s, threads: int = 1) -> Int32s:
    """Find triangles of the surface that distinct points, shape (P, 2 or 3), lie on, corners ascending."""
    from scipy.spatial import cKDTree

    from beltrami_cli._native import LocalTriangulation, morton_order

    if len(positions) < 3:
        return np.empty((0, 3), np.int32)
    points = _centred(positions)
    order = morton_order(points)  # neighbours lie close in memory, which halves the time
    points = points[order]
    tree, stars = cKDTree(points), LocalTriangulation(points)
    for first in range(0, len(points), BLOCK):
        rows = np.arange(first, min(first + BLOCK, len(points)), dtype=np.int32)
        for wanted in _NEIGHBOURS:
            complete = wanted >= len(points) - 1
            nearest = np.asarray(tree.query(points[rows], min(wanted + 1, len(points)), workers=threads)[1])
            keep_unsettled = complete or wanted == _NEIGHBOURS[-1]
            rows = stars.add_stars(rows, nearest.astype(np.int32), complete, keep_unsettled, threads)
            if not len(rows):
                break
    return np.sort(order[stars.faces()], axis=1)


def _centred(positions: Float64s) -> Float64s:
    """Return points around the origin with coordinates near 1, so that squares neither vanish nor overflow."""
    points = np.zeros((len(positions), 3))
    low, high = positions.min(axis=0), positions.max(axis=0)
    # Halves, since a sum may overflow; a power of two, since it rounds nothing.
    points[:, : positions.shape[1]] = positions / 2 - (low / 2 + high / 2) / 2
    extent = float(np.abs(points).max())
    return np.ldexp(points, -int(np.frexp(extent)[1])) if extent > 0 else points


def _triangulate_spaces(places: Float64s, spaces: Int32s | None, threads: int) -> Int32s:
    """Triangulate the points of each space; distances between spaces are undefined."""
    if spaces is None:
        return triangulate_points(places, threads)
    parts = [np.empty((0, 3), np.int32)]
    for space in np.unique(spaces):
        members = np.flatnonzero(spaces == space).astype(np.int32)
        parts.append(members[triangulate_points(places[members], threads)])
    return np.concatenate(parts)


def _with_copies(faces: Int32s, place_of: Int32s, colours: Float32s) -> Int32s:
    """Give the triangles of places to the first point there, and to each other one with first ones elsewhere."""
    # Colours say which is first, so that the order of points makes no difference.
    order = np.lexsort([*colours.T[::-1], place_of])
    leads = np.ones(len(order), bool)
    leads[1:] = place_of[order][1:] != place_of[order][:-1]
    first, others = order[leads].astype(np.int32), order[~leads].astype(np.int32)
    copies = np.bincount(place_of[others], minlength=len(first))
    starts = np.cumsum(copies) - copies
    parts = [first[faces]]
    for corner in range(3):
        counts = copies[faces[:, corner]]
        rows = np.repeat(np.arange(len(faces)), counts)
        within = np.arange(len(rows)) - np.repeat(np.cumsum(counts) - counts, counts)
        more = first[faces[rows]]
        more[:, corner] = others[starts[faces[rows, corner]] + within]
        parts.append(more)
    return np.concatenate(parts)
