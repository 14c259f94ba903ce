"""Walls: what keeps a surface connected where its colour jumps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def build_walls(
    faces: NDArray[np.int32], place_of: NDArray[np.int32], colours: NDArray[np.float32]
) -> NDArray[np.int32]:
    """Join the two sides of hard colour edges.

    On the image manifold (X, beta I) a colour jump along an edge is an upright wall between the edge's two
    copies: no extent in X, the jump in I. Both of its diagonals are laid, so that the result does not depend on
    the order of vertices. More than two copies of one edge (non-manifold edges) are joined in a chain, by
    the order of their colours.

    Parameters
    ----------
    faces : ndarray of int32, shape (F, 3)
        Triangles of the surface, as samples.
    place_of : ndarray of int32, shape (S,)
        Samples with the same number stand at the same place.
    colours : ndarray of float32, shape (S, N)
        Colours of the samples.

    Returns
    -------
    ndarray of int32, shape (W, 3)
        Triangles of the walls.
    """
    shared = np.bincount(place_of) > 1
    if not shared.any():
        return np.empty((0, 3), np.int32)
    copies = _edge_copies(faces, place_of, shared)
    if len(copies) < 2:
        return np.empty((0, 3), np.int32)
    places = place_of[copies]
    by_colour = [*colours[copies[:, 1]].T, *colours[copies[:, 0]].T]
    order = np.lexsort([*by_colour, places[:, 1], places[:, 0]])
    copies, places = copies[order], places[order]
    joined = np.all(places[1:] == places[:-1], axis=1)
    return _wall_triangles(copies[:-1][joined], copies[1:][joined])


def _edge_copies(
    faces: NDArray[np.int32], place_of: NDArray[np.int32], shared: NDArray[np.bool_]
) -> NDArray[np.int32]:
    """Find the distinct edges of samples, shape (E, 2), that may have a copy; both ends in order of place."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = edges[shared[place_of[edges]].any(axis=1)]
    places = place_of[edges]
    edges = np.where((places[:, 0] > places[:, 1])[:, None], edges[:, ::-1], edges)
    edges = edges[places[:, 0] != places[:, 1]]
    return np.unique(edges, axis=0)


def _wall_triangles(one: NDArray[np.int32], other: NDArray[np.int32]) -> NDArray[np.int32]:
    """Make the triangles between copies one = (a, b) and other = (c, d) of edges, both diagonals laid."""
    a, b, c, d = one[:, 0], one[:, 1], other[:, 0], other[:, 1]
    triangles = np.concatenate(
        [np.stack(corners, axis=1) for corners in ((a, b, c), (a, b, d), (c, d, a), (c, d, b))]
    )
    # Where the copies share an end, two of the four repeat a corner; the others are equal and count once.
    distinct = (triangles[:, 0] != triangles[:, 2]) & (triangles[:, 1] != triangles[:, 2])
    walls: NDArray[np.int32] = triangles[distinct].astype(np.int32)
    return walls
