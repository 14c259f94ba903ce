"""Baking: which triangle is seen at each texel, where that is in space, and the colour there."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

NEIGHBOURS = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))


def baked(
    pattern: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    corners: NDArray[np.float64],
    uv: NDArray[np.float64],
    size: tuple[int, int],
    gutter: int,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return an image of a colour function of space.

    Parameters
    ----------
    pattern : callable
        Colours, shape (K, C), of positions, shape (K, 3).
    corners : ndarray of float64, shape (F, 3, 3)
        Positions of the triangles' corners.
    uv : ndarray of float64, shape (F, 3, 2)
        Their texture coordinates, v down, in [0, 1].
    size : tuple of int
        Width and height of the image.
    gutter : int
        How many texels the charts are continued beyond their borders.

    Returns
    -------
    pixels : ndarray of float64, shape (H, W, C)
        Zero in the background.
    filled : ndarray of bool, shape (H, W)
        Texels of charts and gutters.
    """
    scaled = uv * size
    seen = grown(covering(scaled, size), gutter)
    row, column = np.nonzero(seen >= 0)
    triangle = scaled[seen[row, column]]
    weights = barycentric(triangle, np.column_stack([column, row]) + 0.5)
    # In the gutter a weight is negative: the plane of the nearest triangle is continued, and the pattern with it.
    places = np.round(np.einsum("kc,kcx->kx", weights, corners[seen[row, column]]), 7)
    colours = pattern(places)
    pixels = np.zeros((size[1], size[0], colours.shape[1]))
    pixels[row, column] = colours
    return pixels, seen >= 0


def covering(triangles: NDArray[np.float64], size: tuple[int, int]) -> NDArray[np.int64]:
    """Return the triangle that covers each texel's centre, or -1; the first where several do, shape (H, W)."""
    width, height = size
    seen = np.full((height, width), -1)
    low = np.clip(np.floor(triangles.min(axis=1) - 0.5), 0, None).astype(int)
    high = np.clip(np.ceil(triangles.max(axis=1) + 0.5), 0, size).astype(int)
    for face, triangle in enumerate(triangles):
        (left, top), (right, bottom) = low[face], high[face]
        y, x = np.mgrid[top:bottom, left:right] + 0.5
        inside = (barycentric(triangle, np.stack([x, y], axis=-1)) > -1e-9).all(axis=-1)
        part = seen[top:bottom, left:right]
        part[inside & (part < 0)] = face
    return seen


def barycentric(triangles: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the weights of the three corners at points of the plane, shape (..., 3)."""
    a, b, c = (triangles[..., k, :] for k in range(3))
    area = cross(b - a, c - a)
    second, third = cross(points - a, c - a) / area, cross(b - a, points - a) / area
    return np.stack([1 - second - third, second, third], axis=-1)


def cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return twice the signed area between vectors of the plane."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def grown(seen: NDArray[np.int64], steps: int) -> NDArray[np.int64]:
    """Return the map of triangles where each is continued over the empty texels about it, `steps` texels far."""
    for _ in range(steps):
        padded, seen = np.pad(seen, 1, constant_values=-1), seen.copy()
        for down, right in NEIGHBOURS:
            rows, columns = (
                slice(1 + down, padded.shape[0] - 1 + down),
                slice(1 + right, padded.shape[1] - 1 + right),
            )
            seen = np.where(seen < 0, padded[rows, columns], seen)
    return seen
