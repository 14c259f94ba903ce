"""The polygons of a PLY file, and the grids of its range images.

References
----------
.. [1] The Stanford 3D Scanning Repository, on range data: the element range_grid, with obj_info num_cols and num_rows.
.. [2] R. Rusu, S. Cousins, "3D is here: Point Cloud Library (PCL)", ICRA 2011; its files have an element camera, whose
   viewportx and viewporty are the width and height of an organised cloud.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from beltrami_cli.arrays import Int32s, Int64s
from beltrami_cli.errors import InputError
from beltrami_cli.formats.ply.tables import Table
from beltrami_cli.surface.polygons import unrolled

POLYGONS = ("face", "tristrips")  # elements
VERTEX_LISTS = ("vertex_indices", "vertex_index")  # the two names of their list of vertices

_GRID = "range_grid"
_CAMERA = ("viewportx", "viewporty")
_COLUMNS, _ROWS = ("num_cols", "width", "columns", "cols"), ("num_rows", "height", "rows")
_SIZE = re.compile(rb"^(?:obj_info|comment)[ \t]+(\w+)[ \t:=]+(\d{1,9})[ \t]*\r?$", re.MULTILINE)


def read_polygons(tables: Mapping[str, Table], vertices: int, name: str) -> tuple[Int32s, Int64s]:
    """Read the faces, and behind them the triangles of strips: (K,) corners and (P + 1,) offsets of polygons."""
    corners, offsets = _vertex_lists(tables, "face", name)
    _check(corners, offsets, vertices, 0, "face", name)
    strips, ends = _vertex_lists(tables, "tristrips", name)
    _check(strips, ends, vertices, -1, "strip", name)
    triangles = unrolled(strips, ends)
    return (
        np.concatenate([corners, triangles.ravel()], dtype=np.int32, casting="unsafe"),
        np.concatenate([offsets, offsets[-1] + 3 * np.arange(1, len(triangles) + 1)]),
    )


def _vertex_lists(tables: Mapping[str, Table], element: str, name: str) -> tuple[Int64s, Int64s]:
    table = tables.get(element)
    if table is None or table.element.count == 0:
        return np.empty(0, np.int64), np.zeros(1, np.int64)
    for prop in table.element.lists:
        if prop.name in VERTEX_LISTS:
            if prop.type[0] == "f":
                raise InputError(name, f"the {prop.name} of element '{element}' are not whole numbers")
            return table.lists(prop.name)
    raise InputError(name, f"element '{element}' has no list vertex_indices")


def _check(corners: Int64s, offsets: Int64s, vertices: int, least: int, what: str, name: str) -> None:
    if corners.size and (corners.min() < least or corners.max() >= vertices):
        bad = int(np.argmax((corners < least) | (corners >= vertices)))
        row = int(np.searchsorted(offsets, bad, side="right")) - 1
        cause = f"{what} {row} refers to vertex {corners[bad]}, but there are {vertices} vertices"
        raise InputError(name, cause)


def read_grid(header: bytes, tables: Mapping[str, Table]) -> Int64s | None:
    """Return the vertices on the grid, (H, W), -1 where nothing was measured; None without a grid, or with faces."""
    has_polygons = any(tables[name].element.count for name in POLYGONS if name in tables)
    if has_polygons or "vertex" not in tables:
        return None
    vertices = tables["vertex"].element.count
    sizes = {word.decode().lower(): int(number) for word, number in _SIZE.findall(header)}
    columns = next((sizes[word] for word in _COLUMNS if word in sizes), 0)
    rows = next((sizes[word] for word in _ROWS if word in sizes), 0)
    if _GRID in tables:
        return _listed(tables[_GRID], rows, columns, vertices)
    camera = tables.get("camera")
    if camera is not None and camera.element.count == 1 and not (rows and columns):
        whole = {label for label, kind in camera.element.scalars.items() if kind[0] != "f"}
        columns, rows = 0, 0
        if whole.issuperset(_CAMERA):
            columns, rows = (int(camera.scalars(label)[0]) for label in _CAMERA)
    if min(rows, columns) < 2 or rows * columns != vertices:
        return None
    return np.arange(vertices).reshape(rows, columns)


def _listed(table: Table, rows: int, columns: int, vertices: int) -> Int64s:
    """Read the element that lists a vertex or none for each grid point, row by row."""
    places, name = table.element.count, table.body.name
    if rows * columns != places:
        said = f"obj_info num_cols and num_rows say {columns} and {rows}"
        cause = f"element {_GRID} has {places} places, but {said}"
        raise InputError(name, cause, "repair the header, or leave the element out")
    listed = next((p.name for p in table.element.lists if p.name in VERTEX_LISTS), None)
    if listed is None:
        raise InputError(name, f"element {_GRID} has no list vertex_indices")
    items, offsets = table.lists(listed)
    lengths = np.diff(offsets)
    if items.size and (items.min() < 0 or items.max() >= vertices or lengths.max() > 1):
        raise InputError(name, f"element {_GRID} names vertices that are not there, or several at a place")
    if len(np.unique(items)) < len(items):
        raise InputError(name, f"element {_GRID} has a vertex at several places")
    grid = np.full(places, -1, np.int64)
    grid[lengths == 1] = items
    return grid.reshape(rows, columns)
