"""Counts that tell what a triangle mesh is like: boundary, non-manifold and degenerate parts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.surface.areas import triangle_areas

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True)
class TopologyCounts:
    """What a triangle mesh is like.

    Attributes
    ----------
    edges, boundary_edges, non_manifold_edges : int
        Distinct edges; those with one triangle; those with more than two.
    degenerate_faces, duplicate_faces : int
        Triangles without area; triangles with the same three vertices as an earlier one.
    isolated_vertices : int
        Vertices in no triangle.
    """

    edges: int
    boundary_edges: int
    non_manifold_edges: int
    degenerate_faces: int
    duplicate_faces: int
    isolated_vertices: int


def count_topology(positions: NDArray[np.float64], faces: NDArray[np.int32]) -> TopologyCounts:
    """Count the parts of a triangle mesh.

    Parameters
    ----------
    positions : ndarray of float64, shape (V, M)
        Vertex positions.
    faces : ndarray of int32, shape (F, 3)
        Vertex indices.

    Returns
    -------
    TopologyCounts
        Duplicate faces count once for the edges.
    """
    count = len(positions)
    faces = np.sort(faces.astype(np.int64), axis=1)
    repeats = (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2])
    proper = faces[~repeats]
    order = np.lexsort(proper.T[::-1])
    proper = proper[order]
    new = np.ones(len(proper), bool)
    new[1:] = np.any(proper[1:] != proper[:-1], axis=1)
    distinct = proper[new]
    keys = np.concatenate([distinct[:, i] * count + distinct[:, j] for i, j in ((0, 1), (0, 2), (1, 2))])
    _, uses = np.unique(keys, return_counts=True)
    flat = np.count_nonzero(triangle_areas(positions, proper.astype(np.int32)) == 0)
    return TopologyCounts(
        edges=len(uses),
        boundary_edges=int(np.count_nonzero(uses == 1)),
        non_manifold_edges=int(np.count_nonzero(uses > 2)),
        degenerate_faces=int(np.count_nonzero(repeats) + flat),
        duplicate_faces=int(len(proper) - len(distinct)),
        isolated_vertices=count - len(np.unique(faces)),
    )
