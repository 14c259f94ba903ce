"""New places of a document's vertices, with the normals that follow from them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.surface.geometry import vertex_normals
from beltrami_cli.surface.grouping import group_equal_rows
from beltrami_cli.surface.records import MovedVertices

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.document import Document
    from beltrami_cli.surface.records import PaintedVertices


def moved_vertices(document: Document, positions: NDArray[np.float64]) -> MovedVertices:
    """Return new positions, rows as in `painted`; with normals around what moved, if every vertex has one."""
    painted = document.painted()
    if not document.has_normals_by_vertex():
        return MovedVertices(positions)
    return MovedVertices(positions, _normals(painted, document.attribute("normal"), positions))


def _normals(
    painted: PaintedVertices, old: NDArray[np.float64], positions: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Return the normals of vertices that moved or have a neighbour that did, NaN for the others, shape (V, 3).

    Copies of a vertex that shared a normal share the new one; those with normals of their own keep them apart, so that
    hard edges stay hard.
    """
    columns = [*painted.positions.T, *old.T]
    if painted.space_of is not None:
        columns.append(painted.space_of)
    group_of, _ = group_equal_rows(*columns)
    normals = vertex_normals(positions, painted.faces, group_of)
    moved = np.any(positions != painted.positions, axis=1)
    touched = np.zeros(int(group_of.max(initial=-1)) + 1, bool)
    touched[group_of[painted.faces[moved[painted.faces].any(axis=1)]]] = True
    kept = ~touched[group_of] | ~normals.any(axis=1)
    normals[kept] = np.nan
    return normals
