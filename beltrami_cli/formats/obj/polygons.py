"""The `f` statements of an OBJ file."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.obj.statements import Statements


def read_polygons(statements: Statements) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Read all polygons; texture coordinates and normals of their corners are passed over.

    Parameters
    ----------
    statements : Statements
        The file. Indices count from 1, negative ones back from the last vertex before the polygon.

    Returns
    -------
    corners : ndarray of int32, shape (K,)
        The corners of all polygons, each in [0, N) of the N vertices.
    offsets : ndarray of int64, shape (P + 1,)
        Where each polygon starts.

    Raises
    ------
    InputError
        If a corner is no index or out of range, with the line.
    """
    vertices, chosen = statements.select(b"v"), statements.select(b"f")
    tokens, offsets = statements.arguments(chosen)
    given = statements.indices(tokens)
    before = np.repeat(np.searchsorted(vertices, chosen), np.diff(offsets))
    corners = np.where(given < 0, before + given, given - 1)
    outside = (corners < 0) | (corners >= len(vertices)) | (given == 0)
    if outside.any():
        cause = f"refers to no vertex, of which there are {len(vertices)}"
        raise statements.error(tokens[int(np.argmax(outside))], cause)
    return corners.astype(np.int32), offsets


def among(
    corners: NDArray[np.int32], offsets: NDArray[np.int64], vertices: NDArray[np.int64], count: int
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Keep the polygons that have all corners among some vertices, and number these from 0.

    Parameters
    ----------
    corners, offsets : ndarray
        Polygons as from `read_polygons`.
    vertices : ndarray of int64, shape (V,)
        The vertices to be kept, in ascending order.
    count : int
        Number of all vertices.
    """
    row = np.full(count, -1, np.int32)
    row[vertices] = np.arange(len(vertices))
    sizes = np.diff(offsets)
    moved = row[corners]
    polygon = np.repeat(np.arange(len(sizes)), sizes)
    kept = np.bincount(polygon[moved < 0], minlength=len(sizes)) == 0
    ends = np.concatenate([[0], np.cumsum(sizes[kept])])
    return moved[kept[polygon]], ends
