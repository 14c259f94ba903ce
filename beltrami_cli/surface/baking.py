"""Colours of a surface put into the texels of an atlas."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.surface.areas import triangle_areas
from beltrami_cli.surface.cover import border_faces, cover
from beltrami_cli.surface.gutter import fill_gutter

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import DTypeLike, NDArray

    Shade = Callable[[NDArray[np.int64], NDArray[np.float64]], NDArray[Any]]

_FAR = 1.0  # texels beyond a border that bilinear lookups on it touch


def bake(
    uv: NDArray[np.float64],
    size: tuple[int, int],
    shade: Shade,
    channels: int,
    dtype: DTypeLike,
    threads: int = 1,
) -> NDArray[Any]:
    """Paint a texture.

    Parameters
    ----------
    uv : ndarray of float64, shape (F, 3, 2)
        Texture coordinates, u to the right, v down.
    size : (int, int)
        Width and height in texels.
    shade : callable
        From triangles, shape (K,), and weights of their second and third corner, shape (K, 2), to the texels' values,
        shape (K, `channels`), as they are to be stored. Beyond the borders of charts weights leave [0, 1].
    channels : int
        Of the texture.
    dtype : data type
        Of the texture.
    threads : int
        The result does not depend on it.

    Returns
    -------
    ndarray, shape (height, width, channels)
        Texels just beyond the border of a chart continue its triangles, so that bilinear lookups on the border are
        right; all others have the colour of the nearest chart.
    """
    width, height = size
    pixels = np.zeros((height * width, channels), dtype)
    covered = np.zeros(height * width, bool)
    beside = np.zeros(height * width, bool)
    for part in cover(uv, size):
        inside = part.inside
        covered[part.texels[inside]] = True
        pixels[part.texels[inside]] = shade(part.faces[inside], part.weights[inside])
    for part in cover(uv, size, _FAR, border_faces(uv)):
        free = ~covered[part.texels]
        beside[part.texels[free]] = True
        pixels[part.texels[free]] = shade(part.faces[free], part.weights[free])
    shape = (height, width)
    # Where charts are smaller than a texel, what lies beside them is all that there is.
    source = covered if covered.any() else beside
    texture = pixels.reshape(*shape, channels)
    fill_gutter(texture, source.reshape(shape), None, None, beside.reshape(shape), threads)
    return texture


def interpolated(
    corners: NDArray[np.floating[Any]], faces: NDArray[np.int64], weights: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Interpolate linearly between the corners of triangles.

    Parameters
    ----------
    corners : ndarray of float, shape (F, 3, C)
        Values at the corners. Where all three agree they are returned exactly.
    faces : ndarray of int64, shape (K,)
        Which triangle.
    weights : ndarray of float64, shape (K, 2)
        Of its second and third corner. Outside the triangle the values go on linearly, but no further beyond those of
        the corners than these differ.

    Returns
    -------
    ndarray of float64, shape (K, C)
    """
    mine = corners[faces].astype(np.float64)
    first = mine[:, 0]
    steps = mine[:, 1:] - mine[:, :1]
    values = first + weights[:, :1] * steps[:, 0] + weights[:, 1:] * steps[:, 1]
    low, high = mine.min(axis=1), mine.max(axis=1)
    limited: NDArray[np.float64] = np.clip(values, 2 * low - high, 2 * high - low)
    return limited


def overlap(uv: NDArray[np.float64], size: tuple[int, int]) -> float:
    """Return which share of the covered texels lies inside more than one triangle."""
    hits = np.zeros(size[0] * size[1], np.int32)
    for part in cover(uv, size):
        weights = part.weights
        strictly = (weights > 1e-6).all(axis=1) & (weights.sum(axis=1) < 1 - 1e-6)
        np.add.at(hits, part.texels[strictly], 1)
    return float((hits > 1).sum() / max(1, (hits > 0).sum()))


def texels_for_vertices(positions: NDArray[np.float64], faces: NDArray[np.int32]) -> float:
    """Return how many texels cover a mesh if each is half as long as an edge."""
    unit = positions / max(float(np.abs(positions).max(initial=0)), np.finfo(float).tiny)
    edges = np.linalg.norm(unit[faces] - unit[np.roll(faces, -1, axis=1)], axis=2)
    mean = float(edges.mean()) if edges.size else 0.0
    return 4 * float(triangle_areas(unit, faces).sum()) / mean**2 if mean > 0 else 0.0
