"""A coloured mesh with numbers at its vertices, as programs that draw fields read it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.document import Written
from beltrami_cli.formats.ply.writer import face_element, shortest, vertex_element

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray


def write_scalars_as_ply(
    positions: NDArray[np.float64],
    faces: NDArray[np.int32],
    shades: NDArray[np.uint8],
    scalars: Mapping[str, NDArray[np.float32]],
    comments: Sequence[str] = (),
) -> Written:
    """Write a little-endian PLY file whose vertices have a colour and further properties.

    Parameters
    ----------
    positions : ndarray of float64, shape (V, 3)
        They become floats if that loses nothing, otherwise doubles.
    faces : ndarray of int32, shape (F, 3)
        Triangles.
    shades : ndarray of uint8, shape (V, 3)
        Colours.
    scalars : mapping of str to ndarray of float32, shape (V,)
        A property of each name.
    comments : sequence of str
        Lines of the header, without line breaks.

    Returns
    -------
    Written
        One file.
    """
    names = [("x", "y", "z"), ("red", "green", "blue"), *((name,) for name in scalars)]
    blocks = [shortest(positions), shades, *(values[:, None] for values in scalars.values())]
    properties, rows = vertex_element(names, blocks)
    announced, polygons = face_element(faces.ravel(), 3 * np.arange(len(faces) + 1))
    header = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment {line}" for line in comments),
        f"element vertex {len(rows)}",
        *properties,
        *announced,
    ]
    text = "".join(f"{line}\n" for line in [*header, "end_header"])
    return Written([text.encode("ascii", "replace"), rows.tobytes(), polygons])
