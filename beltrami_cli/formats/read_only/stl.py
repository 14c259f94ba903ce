"""Binary STL files: triangles with colours of 15 bits, in two dialects.

Two bytes of every triangle [1]_ are a colour. VisCAM and SolidView mark triangles that have a colour by the highest
bit; blue is in the lowest five. Materialise Magics has COLOR= and a colour for all in the header, marks triangles
without one of their own, and has red lowest. trimesh reads the triangles. It leaves the two bytes as numbers, and makes
text of the header, so both are understood here.

References
----------
.. [1] M. Burns, "Automated fabrication", 1993, section 6.5: the STL format.
"""

from __future__ import annotations

import io

import numpy as np

from beltrami_cli.errors import InputError, NoColoursError
from beltrami_cli.formats.meshes.coloured_polygons import ColouredPolygons

_HEADER, _TRIANGLE = 80, 50  # bytes
_MAGICS = b"COLOR="
_LEVELS = 31  # of five bits


def is_stl(data: bytes) -> bool:
    return data[:5].lower() == b"solid" or _is_binary(data)


def _is_binary(data: bytes) -> bool:
    """Whether the length of a file fits its number of triangles."""
    if len(data) < _HEADER + 4:
        return False
    count = int.from_bytes(data[_HEADER : _HEADER + 4], "little")
    return len(data) == _HEADER + 4 + count * _TRIANGLE


def read_stl(data: bytes, name: str) -> ColouredPolygons:
    if not _is_binary(data):
        cause = "an STL file in text has no colours"
        raise NoColoursError(name, cause, "export it as PLY or OBJ with colours")
    from trimesh.exchange.stl import load_stl_binary

    triangles = load_stl_binary(io.BytesIO(data))
    if "vertices" not in triangles:
        raise InputError(name, "there are no polygons", "nothing in it can be smoothed")
    bits = triangles["face_attributes"]["stl"]
    colours = np.full((len(bits), 3), np.nan, np.float32)
    lowest_first = np.stack([bits & 31, bits >> 5 & 31, bits >> 10 & 31], axis=1) / np.float32(_LEVELS)
    marked = bits >> 15 == 1
    at = data.find(_MAGICS, 0, _HEADER)
    if at >= 0 and at + len(_MAGICS) + 4 <= _HEADER:
        whole = np.frombuffer(data, np.uint8, 3, at + len(_MAGICS)) / np.float32(255)
        colours[:] = np.where(marked[:, None], whole, lowest_first)
    else:
        colours[marked] = lowest_first[marked, ::-1]
    positions = triangles["vertices"].astype(np.float64)
    return ColouredPolygons(
        positions=positions,
        corners=np.arange(len(positions)),
        offsets=3 * np.arange(len(bits) + 1),
        colours=np.repeat(colours, 3, axis=0),
        stored="uint8",
        left_out=("normals",),
    )
