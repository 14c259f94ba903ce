"""New places of a document's vertices, with the normals that follow from them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.surface.geometry import vertex_normals
from beltrami_cli.surface.grouping import group_equal_rows
from beltrami_cli.surface.records import MovedVertices

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.document import Document
    from beltrami_cli.samples.selection import Work
    from beltrami_cli.samples.settings import SmoothSettings
    from beltrami_cli.surface.records import PaintedVertices


def require_geometry(document: Document, work: Work, settings: SmoothSettings, *, written_back: bool) -> None:
    """Check that a document has a geometry that can be smoothed, if that is asked for.

    Parameters
    ----------
    document : Document
        The source.
    work : Work
        What is smoothed of it.
    settings : SmoothSettings
        Whether geometry is to be smoothed.
    written_back : bool
        Whether new positions go into the document itself, and not into another format.

    Raises
    ------
    UsageError
        If no vertex colours are smoothed, along with which it would be.
    InputError
        If there are no triangles, or positions cannot be replaced.
    """
    if not settings.embedding.smooth_geometry:
        return
    if not work.vertices:
        raise UsageError(
            f"{document.name}: --smooth-geometry moves vertices along with their colours, but only textures are "
            "smoothed; choose --on vertices or --on both"
        )
    if document.grid() is not None or not len(document.painted().faces):
        raise InputError(document.name, "it has no triangles, so there is no geometry to smooth")
    if written_back:
        document.require_movable()


def moved_vertices(document: Document, positions: NDArray[np.float64]) -> MovedVertices:
    """Put together what changes when vertices move.

    Parameters
    ----------
    document : Document
        The source.
    positions : ndarray of float64, shape (V, 3)
        New positions, rows as in ``document.painted().positions``.

    Returns
    -------
    MovedVertices
        With normals made anew around every vertex that moved, if the document has one for each vertex.
    """
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
