"""Textures as samples: every texel that the surface covers has a place on it, and neighbours across seams."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli._native import build_atlas as build_native_atlas
from beltrami_cli.errors import ProcessingError
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import Atlas
from beltrami_cli.surface.grouping import group_equal_rows

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from beltrami_cli.surface.textured import TexturedSurface

_WRAP_CODES = {"repeat": 0, "mirror": 1, "clamp": 2}


def build_atlas(
    surface: TexturedSurface, sizes: Sequence[tuple[int, int]], margin: int, threads: int = 1
) -> Atlas:
    """Lay out the charts of a textured surface, and continue each over its seams.

    Faces that share an edge in space and in the image, on its two sides, are of one chart; where an edge of
    exactly two faces is shared in space only, it is a seam, also between textures. A texel is covered if its
    centre lies in a triangle. Where triangles overlap in the image the texel is owned by the largest chart, and other
    charts look at it. A texture that tiles is owned by the fullest period of a chart. Beyond a seam the faces on its
    other side are unfolded into the plane of the face before it, and looked up there; beyond open edges, and edges of
    more than two faces, is nothing.

    Parameters
    ----------
    surface : TexturedSurface
        As a document gives it. Vertices at exactly one place (and in one space) are one.
    sizes : sequence of (int, int)
        Width and height of each texture, in texels.
    margin : int
        How many cells a chart is continued, and rectangles of charts are kept apart: the reach of a kernel.
    threads : int
        The result does not depend on it.

    Returns
    -------
    Atlas
        With a canvas of 2 `margin` by 2 `margin` empty cells if no texel is covered.

    Raises
    ------
    ProcessingError
        If the charts do not fit on a canvas of 2^31 cells, or the textures have more texels together.
    """
    columns = list(surface.positions.T)
    if surface.space_of is not None:
        columns.append(surface.space_of)
    place_of, first = group_equal_rows(*columns)
    grids = _grids(surface, sizes)
    try:
        made = build_native_atlas(
            np.ascontiguousarray(surface.positions[first], np.float64),
            np.ascontiguousarray(place_of[surface.faces], np.int32).reshape(-1, 3),
            np.ascontiguousarray(surface.uv, np.float64).reshape(-1, 3, 2),
            np.ascontiguousarray(surface.texture_of, np.int32),
            grids,
            margin,
            threads,
            lambda size: large_arrays.empty(size, np.uint8),
            lambda _: large_arrays.leave_memory(),
        )
    except ValueError as error:  # what the core's length errors become
        raise ProcessingError(f"{error}; use smaller textures") from error
    texels = grids[:, 0].astype(np.int64) * grids[:, 1]
    return Atlas(texture_offsets=np.concatenate([[0], np.cumsum(texels)]).astype(np.int64), **made)


def _grids(surface: TexturedSurface, sizes: Sequence[tuple[int, int]]) -> NDArray[np.int32]:
    """Width, height and codes of the wrap modes along u and v of each texture."""
    rows = [
        (width, height, *(_WRAP_CODES[mode] for mode in texture.wrap))
        for texture, (width, height) in zip(surface.textures, sizes, strict=True)
    ]
    return np.array(rows, np.int32).reshape(-1, 4)
