"""Coloured polygons of any format, and the way from colours of corners to colours of vertices."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s, Int64s
from beltrami_cli.errors import InputError, UnpaintedError
from beltrami_cli.surface.grouping import group_equal_rows
from beltrami_cli.surface.records import require_finite

_LEAST_WEIGHT = 1e-6  # of a polygon without area, against the mean one
_MEANS = (
    "Where polygons of different colours meet, vertices have the mean of their colours; {} of {} are such."
)
_BARE = "{} of {} vertices have no colour, and are white."


@dataclass(frozen=True)
class ColouredPolygons:
    """What a reader finds: V vertices, and polygons with K corners in all; colours are display values."""

    positions: Float64s  # (V, 3)
    corners: Int64s  # (K,): vertices of all polygons, one polygon after the other
    sizes: Int64s  # how many corners each polygon has
    colours: Float32s  # (K, 3) of every corner, or (K, 4) with opacity; full scale 1, NaN where there is none
    stored: str  # the type of colours in the file, as in `PaintedVertices`
    left_out: tuple[str, ...] = ()  # what else the file holds


def check_polygons(found: ColouredPolygons, name: str) -> None:
    """Raise `InputError` where there is nothing, an index is out of range, or a number not finite."""
    vertices = len(found.positions)
    if not vertices or not len(found.corners):
        raise InputError(name, "there are no polygons", "nothing in it can be smoothed")
    if found.corners.min() < 0 or found.corners.max() >= vertices:
        raise InputError(name, f"a polygon names a vertex that is none of the {vertices}", "export it again")
    require_finite(found.positions, name, "the position of vertex")
    if not np.isfinite(found.colours).all(axis=1).any():
        if "textures" in found.left_out:
            cause = "its colours are textures, which are not read in files of this format"
            raise UnpaintedError(name, cause, "convert it to glTF, for example with Blender")
        cause = "none of its polygons or vertices has a colour"
        raise UnpaintedError(name, cause, "give a file with vertex colours")


def joined(found: ColouredPolygons) -> ColouredPolygons:
    """Make one vertex of those at the same place, for formats that give every triangle its own."""
    number_of, first = group_equal_rows(*found.positions.T)
    return replace(found, positions=found.positions[first], corners=number_of[found.corners].astype(np.int64))


def colours_of_vertices(found: ColouredPolygons) -> tuple[Float32s, list[str]]:
    """Give every vertex the mean of its corners' colours, weighted by areas, or exactly their colour if they agree."""
    count, notices = len(found.positions), []
    known = np.isfinite(found.colours).all(axis=1)
    corners, colours = found.corners[known], found.colours[known]
    weights = np.repeat(_areas(found), found.sizes)[known]
    total = np.bincount(corners, weights, count)
    first = np.zeros(count, np.int64)
    first[corners[::-1]] = np.arange(len(corners))[::-1]
    result = np.ones((count, colours.shape[1]), np.float32)
    result[total > 0] = colours[first[total > 0]]
    mixed = np.bincount(corners, (colours != colours[first[corners]]).any(axis=1), count) > 0
    for channel in range(colours.shape[1]):
        sums = np.bincount(corners, weights * colours[:, channel], count)
        result[mixed, channel] = (sums[mixed] / total[mixed]).astype(np.float32)
    if mixed.any():
        notices.append(_MEANS.format(int(mixed.sum()), count))
    used = np.bincount(found.corners, minlength=count) > 0
    bare = int(np.count_nonzero(used & (total == 0)))
    if bare:
        notices.append(_BARE.format(bare, count))
    return result, notices


def _areas(found: ColouredPolygons) -> Float64s:
    """Return the areas of polygons in units of their mean, none of them zero."""
    starts = np.cumsum(found.sizes) - found.sizes
    polygon = np.repeat(np.arange(len(found.sizes)), found.sizes)
    extent = float(np.abs(found.positions).max()) or 1.0
    points = found.positions[found.corners] / extent
    points = points - points[starts[polygon]]
    after = np.arange(len(found.corners)) + 1
    after[starts + found.sizes - 1] = starts
    across = np.cross(points, points[after])
    sums = np.stack([np.bincount(polygon, column, len(starts)) for column in across.T], axis=1)
    areas: Float64s = np.linalg.norm(sums, axis=1)
    return areas / (areas.mean() or 1.0) + _LEAST_WEIGHT
