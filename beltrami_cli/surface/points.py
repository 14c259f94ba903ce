"""The surface through points without faces.

Around each of some points its nearest neighbours are laid out in the tangent plane, which principal axes give [1]_, and
the Delaunay triangles that hold the point are taken [2]_. Triangles on which two of their points agree remain. The
local spacing limits how large they are and how far from the plane, so that holes stay open and thin sheets apart. The
result follows rotations, shifts, scales and permutations of the points; of four points on one empty circle, as on
grids, it has all four triangles. A point in none of them is an outlier: it lies too far from others, in spacings of
these, or they lie in one line.

References
----------
.. [1] H. Hoppe et al., "Surface reconstruction from unorganized points", SIGGRAPH 1992, doi:10.1145/133994.134011
.. [2] N. Sharp, K. Crane, "A Laplacian for nonmanifold triangle meshes", Computer Graphics Forum 39(5), 2020,
   doi:10.1111/cgf.14069
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s, Int32s
from beltrami_cli.surface.geometry import scaled_to_unit
from beltrami_cli.surface.grouping import group_places
from beltrami_cli.surface.large_arrays import blocks, kept
from beltrami_cli.surface.ranges import expanded
from beltrami_cli.surface.records import ColouredVertices

# Numbers of nearest neighbours, tried until a point's triangles are determined. Usually the first suffices; on rims and
# between the lines of a scanner the last may not.
_NEIGHBOUR_COUNTS = (24, 64, 192)
_POINTS_AT_ONCE = 1 << 17  # bounds the memory of their neighbours


def faces_of_points(vertices: ColouredVertices, threads: int) -> Int32s:
    """Triangulate coloured points in at most three dimensions; their own faces are ignored."""
    # Each of several coincident points is a corner of the triangles of their place.
    place_of, first = group_places(vertices.positions, vertices.space_of)
    if vertices.space_of is None and len(first) == len(place_of):
        del place_of, first  # all points are distinct
        return triangulate_points(vertices.positions, threads)
    places = vertices.positions[first]
    if vertices.space_of is None:
        faces = triangulate_points(places, threads)
    else:  # distances between spaces are undefined
        spaces = vertices.space_of[first]
        members = [np.flatnonzero(spaces == space).astype(np.int32) for space in np.unique(spaces)]
        parts = (rows[triangulate_points(places[rows], threads)] for rows in members)
        faces = np.concatenate([np.empty((0, 3), np.int32), *parts])
    return first[faces] if len(first) == len(place_of) else _with_copies(faces, place_of, vertices.colours)


def triangulate_points(positions: Float64s, threads: int = 1, at_once: int = _POINTS_AT_ONCE) -> Int32s:
    """Triangulate the surface through distinct points, shape (P, 2 or 3); corners are sorted.

    `at_once`: number of points whose neighbours are found together; it does not affect the result.
    """
    from scipy.spatial import cKDTree

    from beltrami_cli._native import LocalTriangulation, morton_order

    if len(positions) < 3:
        return np.empty((0, 3), np.int32)
    points = np.zeros((len(positions), 3))
    points[:, : positions.shape[1]] = scaled_to_unit(positions)
    order = morton_order(points)  # neighbours lie close in memory, which halves the time
    points = kept(points[order])
    tree, stars = cKDTree(points), LocalTriangulation(points)
    for first in range(0, len(points), at_once):
        rows = np.arange(first, min(first + at_once, len(points)), dtype=np.int32)
        for wanted in _NEIGHBOUR_COUNTS:
            complete = wanted >= len(points) - 1
            nearest = np.asarray(tree.query(points[rows], min(wanted + 1, len(points)), workers=threads)[1])
            keep_unsettled = complete or wanted == _NEIGHBOUR_COUNTS[-1]
            rows = stars.add_stars(rows, nearest.astype(np.int32), complete, keep_unsettled, threads)
            if not len(rows):
                break
    del tree, points
    faces = kept(stars.faces())
    del stars
    for block in blocks(len(faces)):
        faces[block] = np.sort(order[faces[block]], axis=1)
    return faces


def _with_copies(faces: Int32s, place_of: Int32s, colours: Float32s) -> Int32s:
    """Give the triangles of each place to its first point, and copies of them to the other points there."""
    # Colours determine the first point, so that the order of points does not matter.
    order = np.lexsort([*colours.T[::-1], place_of])
    leads = np.ones(len(order), bool)
    leads[1:] = place_of[order][1:] != place_of[order][:-1]
    first, duplicates = order[leads].astype(np.int32), order[~leads].astype(np.int32)
    copies = np.bincount(place_of[duplicates], minlength=len(first))
    starts = np.cumsum(copies) - copies
    parts = [first[faces]]
    for corner in range(3):
        at = faces[:, corner]
        copy, row = expanded(starts[at], copies[at])
        more = first[faces[row]]
        more[:, corner] = duplicates[copy]
        parts.append(more)
    return np.concatenate(parts)


@dataclass(frozen=True)
class CloudCounts:
    """Numbers of triangles between points, each in a tangent plane, and of points without any, left unchanged."""

    triangles: int
    outliers: int


def with_surface(vertices: ColouredVertices, threads: int) -> ColouredVertices:
    """Return coloured vertices with their triangles, or with triangles of a surface fitted to the points."""
    # Points too far from all others, or on one line with them, are in no triangle. The same holds for points without a
    # finite position, which are put at the centre of the others.
    if len(vertices.faces):
        return vertices
    measured = np.asarray(np.isfinite(vertices.positions).all(axis=1))
    if measured.all():
        return dataclasses.replace(vertices, faces=kept(faces_of_points(vertices, threads)))
    rows = np.flatnonzero(measured).astype(np.int32)
    finite = vertices.only(rows)
    middle = finite.positions.mean(axis=0) if len(rows) else np.zeros(vertices.positions.shape[1])
    return dataclasses.replace(
        vertices,
        positions=np.where(measured[:, None], vertices.positions, middle),
        faces=rows[faces_of_points(finite, threads)],
    )


def count_cloud(surface: ColouredVertices) -> CloudCounts:
    """Count the triangles and isolated points of `with_surface`."""
    joined = np.zeros(len(surface.positions), bool)
    joined[surface.faces] = True
    return CloudCounts(len(surface.faces), int(np.count_nonzero(~joined)))
