"""Binary STL files with colours: two bytes of every triangle, in the two customs that there are.

VisCAM and SolidView mark triangles that have a colour by the highest bit; blue is in the lowest five. Materialise
Magics has COLOR= and a colour for all in the header, marks triangles without one of their own, and has red lowest.

References
----------
.. [1] M. Burns, "Automated fabrication", 1993, section 6.5: the STL format.
"""

from __future__ import annotations

import numpy as np

from beltrami_cli.errors import InputError, UnpaintedError
from beltrami_cli.formats.foreign.painting import PaintedPolygons, joined

_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("colour", "<u2")])
_HEADER = 80
_MAGICS = b"COLOR="
_LEVELS = 31  # of five bits


def is_binary_stl(data: bytes) -> bool:
    """Tell whether a file has the length that its count of triangles asks for."""
    if len(data) < _HEADER + 4:
        return False
    count = int.from_bytes(data[_HEADER : _HEADER + 4], "little")
    return len(data) == _HEADER + 4 + count * _TRIANGLE.itemsize


def read_stl(data: bytes, name: str) -> PaintedPolygons:
    """Read a binary STL file; vertices at one place become one.

    Raises
    ------
    UnpaintedError
        If it is text, which has no colours.
    InputError
        If its length does not fit its count.
    """
    if not is_binary_stl(data):
        if data[:5].lower() == b"solid":
            raise UnpaintedError(
                name, "an STL file in text has no colours", "export it as PLY or OBJ with colours"
            )
        raise InputError(name, "its length does not fit its number of triangles", "the file may be cut off")
    triangles = np.frombuffer(data, _TRIANGLE, offset=_HEADER + 4)
    colours = np.full((len(triangles), 3), np.nan, np.float32)
    bits = triangles["colour"]
    lowest_first = np.stack([bits & 31, bits >> 5 & 31, bits >> 10 & 31], axis=1) / np.float32(_LEVELS)
    marked = bits >> 15 == 1
    at = data.find(_MAGICS, 0, _HEADER)
    if at >= 0 and at + len(_MAGICS) + 4 <= _HEADER:
        whole = np.frombuffer(data, np.uint8, 3, at + len(_MAGICS)) / np.float32(255)
        colours[:] = np.where(marked[:, None], whole, lowest_first)
    else:
        colours[marked] = lowest_first[marked, ::-1]
    sizes = np.full(len(triangles), 3)
    positions = triangles["corners"].reshape(-1, 3).astype(np.float64)
    everything = PaintedPolygons(
        positions, np.arange(len(positions)), sizes, np.repeat(colours, 3, axis=0), "uint8", ("normals",)
    )
    return joined(everything) if np.isfinite(positions).all() else everything
