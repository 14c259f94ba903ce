"""The meaning of the elements of a PLY file: colours and other properties of vertices, polygons, range image grids.

References
----------
.. [1] The Stanford 3D Scanning Repository, on range data: the element range_grid, with obj_info num_cols and num_rows.
.. [2] R. Rusu, S. Cousins, "3D is here: Point Cloud Library (PCL)", ICRA 2011; its files have an element camera, whose
   viewportx and viewporty are the width and height of an organised cloud.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s, Int32s, Int64s
from beltrami_cli.errors import InputError, NoColoursError
from beltrami_cli.formats.colours import full_scale, integer_scale, intensity_scale
from beltrami_cli.formats.ply.tables import COLOUR_PROPERTIES, Header, Table, plain
from beltrami_cli.surface.polygons import unrolled
from beltrami_cli.surface.precision import require_finite, require_single

POSITION = ("x", "y", "z")
NORMAL = ("nx", "ny", "nz")
_LISTS = ("vertex_indices", "vertex_index")
VERTEX_LISTS = {"face": _LISTS, "tristrips": _LISTS}
"""The lists of vertices by element, each under its two names."""

# Names of colours and opacity, as `plain` returns them; "colour 0" is a channel of `with_channels`.
_COLOURS = (
    (("red", "green", "blue"), "alpha"),
    (("diffuse_red", "diffuse_green", "diffuse_blue"), "diffuse_alpha"),
    (("r", "g", "b"), "a"),
    *((tuple(f"{each} {n}" for n in range(3)), f"{each} 3") for each in COLOUR_PROPERTIES),
    (("gray",), "alpha"),
    (("grey",), "alpha"),
)
_INTENSITY = "intensity"  # a colour in scans, any scalar elsewhere
_INTENSITIES = (_INTENSITY, "reflectance")
# Gaussian splats as trained, and as PlayCanvas packs them.
_SPLATS = ({"f_dc_0", "rot_0"}, {"packed_rotation", "packed_scale"})


@dataclass(frozen=True)
class ColourProperties:
    """The colour properties of the vertices, or of the faces."""

    names: tuple[str, ...]  # in the table: red, green and blue, or grey alone
    alpha: str  # the property of the opacity, or empty
    type: str  # NumPy code of the type that all colours have
    element: str = "vertex"
    any_range: bool = (
        False  # whether they are a scalar, such as an intensity, whose full scale may be any number
    )

    @property
    def channels(self) -> tuple[str, ...]:
        if len(self.names) == 3:
            return ("red", "green", "blue")
        is_named = self.any_range and plain(self.names[0]) not in _INTENSITIES
        return (self.names[0].lower() if is_named else "intensity",) if self.any_range else ("grey",)


def find_colours(
    header: Header, vertices: Table, faces: Table | None, wanted: Sequence[str] = ()
) -> ColourProperties:
    """Find the colour properties; InputError if there are none, or they are of type char or of several types.

    `wanted`: channels that are asked for; one that is not a colour may be any scalar.
    """
    types, name = vertices.element.scalars, vertices.body.name
    if (found := _scalar(types, wanted) or _by_name(vertices)) is not None:
        return found
    has_faces = any(element.count for element in header.elements if element.name in VERTEX_LISTS)
    if _INTENSITY in types and _is_grey(vertices, types[_INTENSITY], "iu" if has_faces else "u"):
        return ColourProperties((_INTENSITY,), "alpha" if "alpha" in types else "", types[_INTENSITY])
    if faces is not None and faces.element.count and (found := _by_name(faces)) is not None:
        return found
    for known in types:
        if plain(known) in _INTENSITIES:
            return ColourProperties(
                (known,), "alpha" if "alpha" in types else "", types[known], any_range=True
            )
    among = ", ".join(known.name for known in vertices.element.properties)[:300]
    cause = f"no vertex colours among the vertex properties {among}"
    remedy = "export the mesh with vertex colours, which are red, green, blue, or name a scalar by --channels"
    raise NoColoursError(name, cause, remedy)


def _scalar(types: Mapping[str, str], wanted: Sequence[str]) -> ColourProperties | None:
    """Return the only wanted channel if a property has its name, which is none of positions and colours."""
    taken = {*POSITION, *_INTENSITIES, *(word for words, _ in _COLOURS for word in words)}
    named = {known.lower(): known for known in types if plain(known) not in taken}
    known = named.get(wanted[0].lower()) if len(wanted) == 1 else None
    return None if known is None else ColourProperties((known,), "", types[known], any_range=True)


def _by_name(table: Table) -> ColourProperties | None:
    types, name = table.element.scalars, table.body.name
    actual = {plain(known): known for known in reversed(types)}
    for words, alpha in _COLOURS:
        if not actual.keys() >= {*words}:
            continue
        names = tuple(actual[word] for word in words)
        kinds = {types[known] for known in names}
        if len(kinds) > 1:
            raise InputError(name, f"{', '.join(names)} are of several types", "store them in one type")
        kind = kinds.pop()
        if kind == "i1":
            cause = f"{', '.join(names)} are of type char, which holds no more than 127"
            raise InputError(name, cause, "store colours as uchar, ushort or float")
        return ColourProperties(names, actual.get(alpha, ""), kind, table.element.name)
    return None


def require_no_splats(header: Header, name: str) -> None:
    """Raise InputError for Gaussian splats: their colours are coefficients of light by direction."""
    vertices = header.element("vertex")
    if vertices is not None and any(vertices.scalars.keys() >= names for names in _SPLATS):
        cause = "it holds Gaussian splats, which are not points or triangles of a surface"
        raise InputError(name, cause, "smooth the photographs, or a mesh that is extracted from the splats")


def _is_grey(vertices: Table, kind: str, integers: str) -> bool:
    if kind[0] != "f":
        return kind[0] in integers and kind != "i1"
    values = vertices.scalars(_INTENSITY)
    return bool(((values >= 0) & (values <= 1)).all())


class Colours(NamedTuple):
    """Colours as read."""

    values: Float32s  # (V, C), full scale 1
    scale: float  # the stored number that is full scale
    notice: str  # about the scale, or empty


def read_colours(vertices: Table, found: ColourProperties) -> Colours:
    """Read the colours of all vertices, at least one."""
    values = np.empty((vertices.element.count, len(found.names)), np.float32)
    if found.any_range or found.type[0] == "f":
        stored = finite_columns(vertices, found.names, "colour")
        require_single(stored, vertices.body.name, f"the colour of {vertices.element.name}")
        scale, notice = intensity_scale(stored) if found.any_range else full_scale(stored, vertices.body.name)
        columns = list(stored.T)
    else:
        columns = [vertices.scalars(known) for known in found.names]
        # Opacity of the same type has the same full scale, which it mostly reaches.
        is_alike = vertices.element.scalars.get(found.alpha) == found.type
        known = [*columns, *([vertices.scalars(found.alpha)] if is_alike else [])]
        largest = max(max(int(column.max()), -int(column.min())) for column in known)
        is_intensity = found.names == (_INTENSITY,)
        scale, notice = integer_scale(largest, found.type, is_intensity=is_intensity)
    for channel, column in enumerate(columns):
        values[:, channel] = column / scale
    return Colours(values, scale, notice)


def finite_columns(vertices: Table, names: tuple[str, ...], what: str) -> Float64s:
    """Read some scalars of all vertices, shape (V, len(names)); InputError if one is not finite."""
    values = np.empty((vertices.element.count, len(names)))
    with np.errstate(invalid="ignore"):  # Signalling NaNs warn when they are made wider.
        for column, known in enumerate(names):
            values[:, column] = vertices.scalars(known)
    require_finite(values, vertices.body.name, f"the {what} of {vertices.element.name}")
    return values


def attribute_names(kinds: Mapping[str, str], colours: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of attributes: "normal" if there are three real components of one, and single properties."""
    others = tuple(name for name in kinds if name not in (*POSITION, *colours))
    real = all(kinds.get(name, "")[:1] == "f" for name in NORMAL)
    return (*(("normal",) if real else ()), *others)


_ELEMENT = "range_grid"
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
    for known in table.element.lists:
        if known.name in VERTEX_LISTS[element]:
            if known.type[0] == "f":
                raise InputError(name, f"the {known.name} of element '{element}' are not whole numbers")
            return table.lists(known.name)
    raise InputError(name, f"element '{element}' has no list vertex_indices")


def _check(corners: Int64s, offsets: Int64s, vertices: int, least: int, what: str, name: str) -> None:
    if corners.size and (corners.min() < least or corners.max() >= vertices):
        bad = int(np.argmax((corners < least) | (corners >= vertices)))
        row = int(np.searchsorted(offsets, bad, side="right")) - 1
        cause = f"{what} {row} refers to vertex {corners[bad]}, but there are {vertices} vertices"
        raise InputError(name, cause)


def read_grid(header: bytes, tables: Mapping[str, Table]) -> Int64s | None:
    """Return the vertices on the grid, (H, W), -1 where nothing was measured; None without a grid, or with faces."""
    has_polygons = any(tables[other].element.count for other in VERTEX_LISTS if other in tables)
    if has_polygons or "vertex" not in tables:
        return None
    vertices = tables["vertex"].element.count
    sizes = {word.decode().lower(): int(number) for word, number in _SIZE.findall(header)}
    columns = next((sizes[word] for word in _COLUMNS if word in sizes), 0)
    rows = next((sizes[word] for word in _ROWS if word in sizes), 0)
    if _ELEMENT in tables:
        return _listed(tables[_ELEMENT], rows, columns, vertices)
    camera = tables.get("camera")
    if camera is not None and camera.element.count == 1 and not (rows and columns):
        whole = {known for known, kind in camera.element.scalars.items() if kind[0] != "f"}
        columns, rows = 0, 0
        if whole.issuperset(_CAMERA):
            columns, rows = (int(camera.scalars(known)[0]) for known in _CAMERA)
    if min(rows, columns) < 2 or rows * columns != vertices:
        return None
    return np.arange(vertices).reshape(rows, columns)


def _listed(table: Table, rows: int, columns: int, vertices: int) -> Int64s:
    """Read the element that lists a vertex or none for each grid point, row by row."""
    places, name = table.element.count, table.body.name
    if rows * columns != places:
        said = f"obj_info num_cols and num_rows say {columns} and {rows}"
        cause = f"element {_ELEMENT} has {places} places, but {said}"
        raise InputError(name, cause, "repair the header, or leave the element out")
    known = next((p.name for p in table.element.lists if p.name in _LISTS), None)
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
