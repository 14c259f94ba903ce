"""The normals of an OBJ file, as far as each vertex has one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.obj.statements import Statements


def read_normals(statements: Statements, corners: NDArray[np.int32], count: int) -> NDArray[np.float64]:
    """Read the normal of every vertex.

    Parameters
    ----------
    statements : Statements
        The file.
    corners : ndarray of int32, shape (K,)
        Vertices of the corners of all polygons.
    count : int
        Number of vertices.

    Returns
    -------
    ndarray of float64, shape (count, 3)
        Of unit length; NaN at vertices whose corners have none.

    Raises
    ------
    InputError
        If normals are damaged, or corners of one vertex have different ones.
    """
    values, polygons = _values(statements), statements.select(b"f")
    tokens, offsets = statements.arguments(polygons)
    index = statements.third_indices(tokens)
    before = np.repeat(np.searchsorted(statements.select(b"vn"), polygons), np.diff(offsets))
    rows = np.where(index < 0, before + index, index - 1)
    outside = (index != 0) & ((rows < 0) | (rows >= len(values)))
    if outside.any():
        cause = f"refers to no normal, of which there are {len(values)}"
        raise statements.error(tokens[int(np.argmax(outside))], cause)
    given = index != 0
    normals = np.full((count, 3), np.nan)
    vertices, found = corners[given], values[rows[given]]
    normals[vertices[::-1]] = found[::-1]  # so that the first one of a vertex stays
    differs = (normals[vertices] != found).any(axis=1)
    if differs.any():
        token = tokens[given][int(np.argmax(differs))]
        raise statements.error(token, "has another normal than an earlier corner of the same vertex")
    return normals


def _values(statements: Statements) -> NDArray[np.float64]:
    """Return all `vn` statements as unit vectors, shape (N, 3)."""
    chosen = statements.select(b"vn")
    tokens, offsets = statements.arguments(chosen)
    wrong = np.diff(offsets) != 3
    if wrong.any():
        head = statements.heads[chosen[int(np.argmax(wrong))]]
        raise statements.error(head, "has not three numbers behind it")
    values = statements.numbers(tokens).reshape(-1, 3)
    if not np.isfinite(values).all():
        raise statements.error(tokens[int(np.argmin(np.isfinite(values)))], "is not a finite number")
    length = np.linalg.norm(values, axis=1, keepdims=True)
    return np.asarray(np.divide(values, length, out=np.zeros_like(values), where=length > 0))
