"""Baking of surface colours into an atlas, coverage of texels by triangles, and texture lookups.

References
----------
.. [1] J. Immerkaer, "Fast noise variance estimation", CVIU 64 (1996).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int32s, Int64s
from beltrami_cli.surface.atlas import fill_gutter
from beltrami_cli.surface.geometry import triangle_areas
from beltrami_cli.surface.grouping import group_equal_rows, group_places
from beltrami_cli.surface.records import TexturedSurface, Wrap

Shade = Callable[[Int64s, Float64s], Array]


_BLOCK = 1 << 20  # texels processed at a time, to bound memory
_COVER_MARGIN = 0.75  # texels: distance at which a centre may belong to a triangle
_LOOKUP_MARGIN = 1.0  # texels beyond a border that bilinear lookups on it read
_EDGE = 1e-9  # barycentric: centres on an edge are inside, whichever way they are rounded


@dataclass(frozen=True)
class Cover:
    """Texels and the triangles that cover them."""

    texels: Int64s  # (K,): row * width + column
    faces: Int64s  # (K,): their triangles
    # Shape (K, 2): barycentric weights of the second and third corner; for texels inside, not below 0 up to rounding.
    weights: Float64s

    @property
    def inside(self) -> Bools:
        """Whether each centre is in the triangle, edges included."""
        all_three = np.column_stack([self.weights, 1 - self.weights.sum(axis=1)])
        return np.asarray(np.all(all_three >= -_EDGE, axis=1))


def cover(
    uv: Float64s, size: tuple[int, int], reach: float = 0.0, chosen: NDArray[np.intp] | None = None
) -> Iterator[Cover]:
    """Yield texels whose centres are in triangles with an area, or up to `reach` texels outside."""
    corners = uv * size - 0.5  # so that centres are integers
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = _cross(one, two)
    faces = np.flatnonzero(area) if chosen is None else chosen[area[chosen] != 0]
    y = corners[faces][:, :, 1]
    low, high = _between(y.min(axis=1), y.max(axis=1), reach, size[1])
    counts = np.maximum(high - low + 1, 0)
    for block in runs_of(counts):
        rows, owner = expanded(low[block], counts[block])
        first, last = _columns(corners[faces[block]][owner], rows, reach, size[0])
        lengths = np.maximum(last - first + 1, 0)
        for part in runs_of(lengths):
            column, span = expanded(first[part], lengths[part])
            row, face = rows[part][span], faces[block][owner[part][span]]
            offset = np.stack([column, row], axis=1) - corners[face, 0]
            weights = np.stack([_cross(offset, two[face]), _cross(one[face], offset)], axis=1)
            yield Cover(row * size[0] + column, face, weights / area[face][:, None])


@dataclass(frozen=True)
class Cells:
    """Pixels of pictures: picture, row, column and chart of each, shapes (K,)."""

    sizes: Sequence[tuple[int, int]]  # rows and columns of each picture
    picture: Int64s
    row: Int64s
    column: Int64s
    chart: NDArray[np.signedinteger[Any]]
    names: Sequence[str] = ()  # of the pictures; empty: a single image

    def of(self, index: int) -> tuple[Bools, tuple[Int64s, Int64s]]:
        """Return a mask of the samples in a picture, and their rows and columns."""
        mine = self.picture == index
        return mine, (self.row[mine], self.column[mine])


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
        texels, found, apart = _texels_in_space(corners, uv, (columns, rows), of_corners[faces])
        nearest = np.minimum(np.searchsorted(texels, row * columns + column), len(texels) - 1)
        places[in_texture], spacing[in_texture] = found[nearest], apart[nearest]
    return places, spacing


def _texel_spacing(surface: TexturedSurface, sizes: Sequence[tuple[int, int]]) -> Float64s:
    """Return the spacing of texels in space at each corner, (F, 3), equal where triangles meet."""
    place_of, _ = group_places(surface.positions, surface.space_of, surface.faces)
    count = len(surface.positions)
    shown = surface.texture_of >= 0
    texels = np.array([across * down for across, down in sizes], np.float64)[surface.texture_of[shown]]
    one, two = (surface.uv[shown, k] - surface.uv[shown, 0] for k in (1, 2))
    flat = np.maximum(texels * np.abs(_cross(one, two)) / 2, np.finfo(float).tiny)
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
    found = [(part.texels, part.faces, part.weights) for part in cover(uv, size, _COVER_MARGIN)]
    texels, faces, weights = map(np.concatenate, zip(*found, strict=True))
    outside = np.maximum(0, -np.column_stack([weights, 1 - weights.sum(axis=1)])).max(axis=1)
    order = np.lexsort((faces, outside > _EDGE, texels))
    texels, first = np.unique(texels[order], return_index=True)
    chosen = order[first]
    faces, (second, third) = faces[chosen], weights[chosen].T
    shares = np.column_stack([1 - second - third, second, third])
    places = np.einsum("kc,kcx->kx", shares, positions[faces])
    return texels, places, np.einsum("kc,kc->k", shares, spacing[faces])


def border_faces(uv: Float64s) -> NDArray[np.intp]:
    """Return the triangles with an edge that no other triangle shares in the image."""
    point_of, _ = group_equal_rows(*uv.reshape(-1, 2).T)
    points = point_of.reshape(-1, 3)
    edges = np.sort(np.stack([points, np.roll(points, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    edge_of, _ = group_equal_rows(*edges.T)
    alone = np.bincount(edge_of)[edge_of] == 1
    return np.flatnonzero(alone.reshape(-1, 3).any(axis=1))


def _cross(a: Float64s, b: Float64s) -> Float64s:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _between(low: Float64s, high: Float64s, reach: float, count: int) -> tuple[Int64s, Int64s]:
    """Return the first and last integer between two numbers, or up to `reach` beyond."""
    first = np.ceil(np.clip(low - reach - _EDGE, -1, count))
    last = np.floor(np.clip(high + reach + _EDGE, -1, count))
    return np.maximum(first, 0).astype(np.int64), np.minimum(last, count - 1).astype(np.int64)


def _columns(corners: Float64s, rows: Int64s, reach: float, width: int) -> tuple[Int64s, Int64s]:
    """Return the first and last column of each triangle in a row, from its edges within the strip of the row."""
    ends = np.roll(corners, -1, axis=1)
    (ax, ay), (bx, by) = np.moveaxis(corners, 2, 0), np.moveaxis(ends, 2, 0)
    top, bottom = (rows - reach - _EDGE)[:, None], (rows + reach + _EDGE)[:, None]
    enter = np.clip(top, np.minimum(ay, by), np.maximum(ay, by))
    leave = np.clip(bottom, np.minimum(ay, by), np.maximum(ay, by))
    crosses = (np.maximum(ay, by) >= top) & (np.minimum(ay, by) <= bottom)
    level = ay == by
    rise = np.where(level, 1.0, by - ay)
    one = np.where(level, ax, ax + (enter - ay) / rise * (bx - ax))
    other = np.where(level, bx, ax + (leave - ay) / rise * (bx - ax))
    low = np.where(crosses, np.minimum(one, other), np.inf).min(axis=1)
    high = np.where(crosses, np.maximum(one, other), -np.inf).max(axis=1)
    return _between(low, high, reach, width)


def runs_of(counts: Int64s) -> Iterator[slice]:
    """Split rows into runs whose counts sum to about a block."""
    sums, first = np.cumsum(counts), 0
    while first < len(counts):
        done = sums[first - 1] if first else 0
        last = max(first + 1, int(np.searchsorted(sums, done + _BLOCK, side="right")))
        yield slice(first, last)
        first = last


def expanded(starts: Int64s, counts: Int64s) -> tuple[Int64s, Int64s]:
    """Return start, start + 1, ... for each row, and the row of each number."""
    owner = np.repeat(np.arange(len(counts)), counts)
    return starts[owner] + np.arange(len(owner)) - (np.cumsum(counts) - counts)[owner], owner


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


def overlap(uv: Float64s, size: tuple[int, int]) -> float:
    """Return the share of the covered texels that are inside more than one triangle."""
    hits = np.zeros(size[0] * size[1], np.int32)
    for part in cover(uv, size):
        weights = part.weights
        strictly = (weights > 1e-6).all(axis=1) & (weights.sum(axis=1) < 1 - 1e-6)
        np.add.at(hits, part.texels[strictly], 1)
    return float((hits > 1).sum() / max(1, (hits > 0).sum()))


def texels_for_vertices(positions: Float64s, faces: Int32s) -> float:
    """Return the number of texels that cover a mesh with two texels per edge."""
    unit = positions / max(float(np.abs(positions).max(initial=0)), np.finfo(float).tiny)
    edges = np.linalg.norm(unit[faces] - unit[np.roll(faces, -1, axis=1)], axis=2)
    mean = float(edges.mean()) if edges.size else 0.0
    return 4 * float(triangle_areas(unit, faces).sum()) / mean**2 if mean > 0 else 0.0


def look_up(
    image: Float32s, uv: Array, wrap: tuple[Wrap, Wrap], alpha: int | None = None,
    precision: type[np.float32] | type[np.float64] = np.float64,
) -> Array:  # fmt: skip
    """Interpolate bilinearly between texels; exact where all four are equal."""
    # Coordinates: u to the right, v down, (0, 0) the upper left corner of the image and (1, 1) the lower right. No
    # colour is taken where the channel `alpha` is transparent.
    height, width = image.shape[:2]
    left, right, across = _taps(uv[:, 0], width, wrap[0])
    upper, lower, down = _taps(uv[:, 1], height, wrap[1])
    places = [(row, column) for row in (upper, lower) for column in (left, right)]
    four: list[Array] = [_texels(image, *place).astype(precision, copy=False) for place in places]
    right_part, lower_part = (part.astype(precision, copy=False)[:, None] for part in (across, down))
    plain = _mixed(four, right_part, lower_part)
    if alpha is None:
        return plain
    opacity = plain[:, alpha : alpha + 1]
    weighted = _mixed([texel * texel[:, alpha : alpha + 1] for texel in four], right_part, lower_part)
    agree = np.ptp(np.stack([texel[:, alpha] for texel in four]), axis=0) == 0
    seen = plain.copy()
    np.divide(weighted, opacity, out=seen, where=(opacity > 0) & ~agree[:, None])
    seen[:, alpha] = plain[:, alpha]
    return seen


def _texels(image: Array, row: Int64s, column: Int64s) -> Array:
    if image.flags.c_contiguous:  # the usual and faster case
        return np.asarray(image.reshape(-1, image.shape[2]).take(row * image.shape[1] + column, axis=0))
    return np.asarray(image[row, column])


def noise_around(image: Float32s, uv: Float64s, wrap: tuple[Wrap, Wrap]) -> Float64s:
    """Return samples of the texture's noise, by a mask that maps any plane to zero [1]."""
    # The samples have the standard deviation of independent noise.
    height, width = image.shape[:2]
    mask = np.outer([1, -2, 1], [1, -2, 1]) / 6
    column, row = (np.floor(uv * [width, height]).astype(np.int64)).T
    columns = [_wrapped(column + step, width, wrap[0]) for step in (-1, 0, 1)]
    rows = [_wrapped(row + step, height, wrap[1]) for step in (-1, 0, 1)]
    total = np.zeros((len(uv), image.shape[2]))
    for i, j in np.ndindex(3, 3):
        total += mask[i, j] * image[rows[i], columns[j]]
    return total


def _mixed(four: list[Array], across: Array, down: Array) -> Array:
    upper = four[0] + across * (four[1] - four[0])
    lower = four[2] + across * (four[3] - four[2])
    return np.asarray(upper + down * (lower - upper))


def _taps(coordinate: Array, count: int, wrap: Wrap) -> tuple[Int64s, Int64s, Array]:
    """Return the texels on both sides along one axis, and the fraction between them."""
    # Subtract whole periods first, since coordinates may be huge.
    period = 2.0 if wrap == "mirror" else 1.0
    if wrap == "clamp":
        folded = np.clip(coordinate, -1, 2)
    else:
        folded = coordinate if _all_within(coordinate, period) else np.mod(coordinate, period)
    at = folded * count - 0.5
    first = np.floor(at).astype(np.int64)
    return _wrapped(first, count, wrap), _wrapped(first + 1, count, wrap), at - first


def _all_within(values: Array, end: float) -> bool:
    """Whether all values are in [0, end), so that wrapping is unnecessary."""
    return bool(values.size) and bool(values.min() >= 0) and bool(values.max() < end)


def _wrapped(index: Int64s, count: int, wrap: Wrap) -> Int64s:
    if _all_within(index, count):
        return index
    if wrap == "clamp":
        return np.asarray(np.clip(index, 0, count - 1))
    if wrap == "repeat":
        return index % count
    folded = index % (2 * count)
    return np.minimum(folded, 2 * count - 1 - folded)
