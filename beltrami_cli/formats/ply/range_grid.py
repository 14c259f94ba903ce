"""The regular grid that the vertices of a PLY file were measured on, where the file tells it.

References
----------
.. [1] The Stanford 3D Scanning Repository, on range data: the element range_grid, with obj_info num_cols and num_rows.
.. [2] R. Rusu, S. Cousins, "3D is here: Point Cloud Library (PCL)", ICRA 2011; its files have an element camera, whose
   viewportx and viewporty are the width and height of an organised cloud.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from beltrami_cli.formats.ply.tables import Table

_ELEMENT = "range_grid"
_LISTS = ("vertex_indices", "vertex_index")
_CAMERA = ("viewportx", "viewporty")
_COLUMNS, _ROWS = ("num_cols", "width", "columns", "cols"), ("num_rows", "height", "rows")
_SIZE = re.compile(rb"^(?:obj_info|comment)[ \t]+(\w+)[ \t:=]+(\d{1,9})[ \t]*\r?$", re.MULTILINE)


def read_grid(header: bytes, tables: Mapping[str, Table], name: str) -> NDArray[np.int64] | None:
    """Read which vertex stands at which place of the grid.

    Parameters
    ----------
    header : bytes
        The text of the header.
    tables : mapping of str to Table
        The elements of the file; faces count more than a grid.
    name : str
        The file's name for messages.

    Returns
    -------
    ndarray of int64, shape (H, W), or None
        Vertices, -1 where nothing was measured. None: the file has faces, or no such grid.

    Raises
    ------
    InputError
        If the element range_grid is damaged.
    """
    if any(tables[other].element.count for other in ("face", "tristrips") if other in tables):
        return None
    vertices = tables["vertex"].element.count
    told = {word.decode().lower(): int(number) for word, number in _SIZE.findall(header)}
    columns = next((told[word] for word in _COLUMNS if word in told), 0)
    rows = next((told[word] for word in _ROWS if word in told), 0)
    if _ELEMENT in tables:
        return _listed(tables[_ELEMENT], rows, columns, vertices, name)
    if "camera" in tables and tables["camera"].element.count == 1 and not (rows and columns):
        columns, rows = _viewport(tables["camera"])
    if min(rows, columns) < 2 or rows * columns != vertices:
        return None
    return np.arange(vertices).reshape(rows, columns)


def _listed(table: Table, rows: int, columns: int, vertices: int, name: str) -> NDArray[np.int64]:
    """Read the element that lists a vertex, or none, for every place of the grid, row by row."""
    places = table.element.count
    if rows * columns != places:
        raise InputError(
            name,
            f"element {_ELEMENT} has {places} places, but obj_info num_cols and num_rows say {columns} and {rows}",
            "repair the header, or leave the element out",
        )
    known = next((p.name for p in table.element.properties if p.count and p.name in _LISTS), None)
    if known is None:
        raise InputError(name, f"element {_ELEMENT} has no list vertex_indices")
    items, offsets = table.lists(known)
    lengths = np.diff(offsets)
    if items.size and (items.min() < 0 or items.max() >= vertices or lengths.max() > 1):
        raise InputError(name, f"element {_ELEMENT} names vertices that are not there, or several at a place")
    if len(np.unique(items)) < len(items):
        raise InputError(name, f"element {_ELEMENT} has a vertex at several places")
    grid = np.full(places, -1, np.int64)
    grid[lengths == 1] = items
    return grid.reshape(rows, columns)


def _viewport(camera: Table) -> tuple[int, int]:
    """Return width and height of the cloud, or zeros."""
    whole = {p.name for p in camera.element.properties if not p.count and p.type[0] != "f"}
    if not whole.issuperset(_CAMERA):
        return 0, 0
    width, height = (int(camera.scalars(name)[0]) for name in _CAMERA)
    return width, height
