"""Baking of surface colours into textures, and positions of texels in space."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from beltrami_cli.arrays import Array, Float64s, Int32s, Int64s
from beltrami_cli.surface.coverage import EDGE, border_faces, cover
from beltrami_cli.surface.geometry import cross_in_plane, triangle_areas
from beltrami_cli.surface.grouping import group_places
from beltrami_cli.surface.gutters import fill_gutter
from beltrami_cli.surface.records import Cells, TexturedSurface

Shade = Callable[[Int64s, Float64s], Array]


_COVER_MARGIN = 0.75  # texels: distance at which a centre may belong to a triangle
_LOOKUP_MARGIN = 1.0  # texels beyond a border that bilinear lookups on it read


def places_of_texels(surface: TexturedSurface, cells: Cells) -> tuple[Float64s, Float64s]:
    """Return the positions of texels in space, (K, 3), and their spacing there, (K,)."""
    places, spacing = np.zeros((len(cells.row), 3)), np.ones(len(cells.row))
    of_corners = _texel_spacing(surface, [(columns, rows) for rows, columns in cells.sizes])
    for index, (rows, columns) in enumerate(cells.sizes):
        in_texture, (row, column) = cells.of(index)
        if not len(row):
            continue
        faces = surface.texture_of == index
        uv = surface.uv[faces]
        uv = uv - np.floor(uv.mean(axis=1, keepdims=True))  # repeated textures
        corners = surface.positions[surface.faces[faces]]
        texels, positions, apart = _texels_in_space(corners, uv, (columns, rows), of_corners[faces])
        nearest = np.minimum(np.searchsorted(texels, row * columns + column), len(texels) - 1)
        places[in_texture], spacing[in_texture] = positions[nearest], apart[nearest]
    return places, spacing


def _texel_spacing(surface: TexturedSurface, sizes: Sequence[tuple[int, int]]) -> Float64s:
    """Return the spacing of texels in space at each corner, (F, 3), equal where triangles meet."""
    place_of, _ = group_places(surface.positions, surface.space_of, surface.faces)
    count = len(surface.positions)
    shown = surface.texture_of >= 0
    texels = np.array([across * down for across, down in sizes], np.float64)[surface.texture_of[shown]]
    one, two = (surface.uv[shown, k] - surface.uv[shown, 0] for k in (1, 2))
    flat = np.maximum(texels * np.abs(cross_in_plane(one, two)) / 2, np.finfo(float).tiny)
    areas = triangle_areas(surface.positions, surface.faces[shown])
    ends = place_of[surface.faces[shown]]
    total = np.bincount(ends.ravel(), np.repeat(areas, 3), count)
    covered = np.bincount(ends.ravel(), np.repeat(flat, 3), count)
    spacing = np.sqrt(total / np.maximum(covered, np.finfo(float).tiny))
    return np.asarray(spacing[place_of[surface.faces]], np.float64)


def _texels_in_space(
    positions: Float64s, uv: Float64s, size: tuple[int, int], spacing: Float64s
) -> tuple[Int64s, Float64s, Float64s]:
    """Return the texels on triangles, ascending, their positions, and the spacing interpolated from corners.

    Shapes: `positions` of corners (F, 3, 3), `spacing` (F, 3).
    """
    covers = [(part.texels, part.faces, part.weights) for part in cover(uv, size, _COVER_MARGIN)]
    texels, faces, weights = map(np.concatenate, zip(*covers, strict=True))
    outside = np.maximum(0, -np.column_stack([weights, 1 - weights.sum(axis=1)])).max(axis=1)
    order = np.lexsort((faces, outside > EDGE, texels))
    texels, first = np.unique(texels[order], return_index=True)
    chosen = order[first]
    faces, (second, third) = faces[chosen], weights[chosen].T
    shares = np.column_stack([1 - second - third, second, third])
    places = np.einsum("kc,kcx->kx", shares, positions[faces])
    return texels, places, np.einsum("kc,kc->k", shares, spacing[faces])


def bake(uv: Float64s, size: tuple[int, int], shade: Shade, channels: int, dtype: DTypeLike) -> Array:
    """Fill a texture, shape (height, width, channels), with the values of `shade` for triangles and weights."""
    # Texels just beyond the border of a chart extend its triangles (weights outside [0, 1]), so that bilinear lookups
    # on the border are exact. All others get the colour of the nearest chart.
    width, height = size
    pixels = np.zeros((height * width, channels), dtype)
    covered, adjacent = np.zeros((2, height * width), bool)
    for part in cover(uv, size):
        inside = part.inside
        covered[part.texels[inside]] = True
        pixels[part.texels[inside]] = shade(part.faces[inside], part.weights[inside])
    for part in cover(uv, size, _LOOKUP_MARGIN, border_faces(uv)):
        free = ~covered[part.texels]
        adjacent[part.texels[free]] = True
        pixels[part.texels[free]] = shade(part.faces[free], part.weights[free])
    # Charts smaller than a texel only have adjacent texels.
    source = covered if covered.any() else adjacent
    texture = pixels.reshape(height, width, channels)
    fill_gutter(texture, source.reshape(height, width), None, adjacent.reshape(height, width))
    return texture


def interpolated(corners: NDArray[np.floating[Any]], faces: Int64s, weights: Float64s) -> Float64s:
    """Interpolate corner values, shape (F, 3, C), within triangles; exact where all three are equal."""
    # Outside the triangle values are extrapolated, by at most the difference between corners.
    face_corners = corners[faces].astype(np.float64)
    first = face_corners[:, 0]
    steps = face_corners[:, 1:] - face_corners[:, :1]
    values = first + weights[:, :1] * steps[:, 0] + weights[:, 1:] * steps[:, 1]
    low, high = face_corners.min(axis=1), face_corners.max(axis=1)
    return np.asarray(np.clip(values, 2 * low - high, 2 * high - low))


def texels_for_vertices(positions: Float64s, faces: Int32s) -> float:
    """Return the number of texels that cover a mesh with two texels per edge."""
    unit = positions / max(float(np.abs(positions).max(initial=0)), np.finfo(float).tiny)
    edges = np.linalg.norm(unit[faces] - unit[np.roll(faces, -1, axis=1)], axis=2)
    mean = float(edges.mean()) if edges.size else 0.0
    return 4 * float(triangle_areas(unit, faces).sum()) / mean**2 if mean > 0 else 0.0
