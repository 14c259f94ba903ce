"""The polygons of a PLY file: faces, and triangle strips unrolled."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from beltrami_cli.formats.ply.tables import Table

VERTEX_LISTS = {"face": ("vertex_indices", "vertex_index"), "tristrips": ("vertex_indices", "vertex_index")}
"""The lists of vertices by element, each under its two names."""


def read_polygons(
    tables: Mapping[str, Table], vertices: int, name: str
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Read the faces, and behind them the triangles of strips.

    Parameters
    ----------
    tables : mapping of str to Table
        The elements of the file.
    vertices : int
        Number of vertices V.
    name : str
        The file's name for messages.

    Returns
    -------
    corners : ndarray of int32, shape (K,)
        The corners of all polygons, each in [0, V).
    offsets : ndarray of int64, shape (P + 1,)
        Where each polygon starts.

    Raises
    ------
    InputError
        If an index is out of range, or the elements have no list of vertices.
    """
    corners, offsets = _vertex_lists(tables, "face", name)
    _check(corners, offsets, vertices, 0, "face", name)
    strips, ends = _vertex_lists(tables, "tristrips", name)
    _check(strips, ends, vertices, -1, "strip", name)
    triangles = _unroll(strips, ends)
    return (
        np.concatenate([corners, triangles.ravel()], dtype=np.int32, casting="unsafe"),
        np.concatenate([offsets, offsets[-1] + 3 * np.arange(1, len(triangles) + 1)]),
    )


def _vertex_lists(
    tables: Mapping[str, Table], element: str, name: str
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    table = tables.get(element)
    if table is None or table.element.count == 0:
        return np.empty(0, np.int64), np.zeros(1, np.int64)
    for known in table.element.properties:
        if known.count and known.name in VERTEX_LISTS[element]:
            if known.type[0] == "f":
                raise InputError(name, f"the {known.name} of element '{element}' are not whole numbers")
            return table.lists(known.name)
    raise InputError(name, f"element '{element}' has no list vertex_indices")


def _check(
    corners: NDArray[np.int64],
    offsets: NDArray[np.int64],
    vertices: int,
    least: int,
    what: str,
    name: str,
) -> None:
    if corners.size and (corners.min() < least or corners.max() >= vertices):
        bad = int(np.argmax((corners < least) | (corners >= vertices)))
        row = int(np.searchsorted(offsets, bad, side="right")) - 1
        raise InputError(
            name, f"{what} {row} refers to vertex {corners[bad]}, but there are {vertices} vertices"
        )


def _unroll(strips: NDArray[np.int64], ends: NDArray[np.int64]) -> NDArray[np.int64]:
    """Turn strips, which -1 restarts, into triangles; every other one of a strip is turned round.

    Triangles of fewer than three different corners only lead from one strip to the next, and are left out.
    """
    if strips.size < 3:
        return np.empty((0, 3), np.int64)
    begins = np.zeros(len(strips), np.bool_)
    begins[ends[:-1][ends[:-1] < len(strips)]] = True
    begins[1:] |= strips[:-1] == -1
    numbers = np.arange(len(strips))
    since = numbers - np.maximum.accumulate(np.where(begins, numbers, 0))
    triangles = np.column_stack([strips[:-2], strips[1:-1], strips[2:]])
    odd = since[2:] % 2 == 1
    triangles[odd] = triangles[odd][:, [1, 0, 2]]
    a, b, c = triangles.T
    proper = (since[2:] >= 2) & (triangles >= 0).all(axis=1) & (a != b) & (b != c) & (c != a)
    kept: NDArray[np.int64] = triangles[proper]
    return kept
