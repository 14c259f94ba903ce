"""Polygons with colours at their corners, and the vertex colours that are made of them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s, Int64s
from beltrami_cli.errors import InputError, NoColoursError
from beltrami_cli.surface.grouping import group_equal_rows
from beltrami_cli.surface.polygons import polygons_of
from beltrami_cli.surface.precision import require_finite, require_single
from beltrami_cli.surface.records import Frame

_MIN_WEIGHT = 1e-6  # of a degenerate polygon, relative to the mean area
_MEANS_NOTICE = "Where polygons of different colours meet, vertices have the mean of their colours: {} of {}."
_UNCOLOURED_NOTICE = "{} of {} vertices have no colour, and are white."


@dataclass(frozen=True)
class ColouredPolygons:
    """Polygons with display colours at their corners: V vertices and K corners in total."""

    positions: Float64s  # (V, 3)
    corners: Int64s  # (K,): vertices of all polygons, one polygon after the other
    offsets: Int64s  # (P + 1,): first corner of each polygon
    colours: Float32s  # (K, 3), or (K, 4) with opacity; full scale 1, NaN: no colour
    stored: str  # the type of colours in the file, as in `ColouredVertices`
    left_out: tuple[str, ...] = ()  # what else the file holds
    frame: Frame = field(default_factory=Frame)


def check_polygons(found: ColouredPolygons, name: str) -> None:
    """Raise InputError if there are no polygons or colours, or an index or a number is invalid."""
    vertices = len(found.positions)
    if not vertices or not len(found.corners):
        raise InputError(name, "there are no polygons", "nothing in it can be smoothed")
    if found.corners.min() < 0 or found.corners.max() >= vertices:
        raise InputError(
            name, f"a polygon names a vertex beyond the {vertices} of the file", "export it again"
        )
    require_finite(found.positions, name, "the position of vertex")
    require_single(np.where(np.isnan(found.colours), 0, found.colours), name, "the colour of corner")
    if not np.isfinite(found.colours).all(axis=1).any():
        if "textures" in found.left_out:
            cause = "its colours are textures, which are not read in files of this format"
            raise NoColoursError(name, cause, "convert it to glTF, for example with Blender")
        cause = "none of its polygons or vertices has a colour"
        raise NoColoursError(name, cause, "give a file with vertex colours")


def joined(found: ColouredPolygons) -> ColouredPolygons:
    """Merge vertices at the same position, for formats in which every triangle has vertices of its own."""
    number_of, first = group_equal_rows(*found.positions.T)
    return replace(found, positions=found.positions[first], corners=number_of[found.corners].astype(np.int64))


def colours_of_vertices(found: ColouredPolygons) -> tuple[Float32s, list[str]]:
    """Return the area-weighted mean colour of the corners of each vertex, exact where they agree, and notices."""
    count, notices = len(found.positions), []
    known = np.isfinite(found.colours).all(axis=1)
    corners, colours = found.corners[known], found.colours[known]
    weights = _areas(found)[polygons_of(found.offsets)][known]
    total = np.bincount(corners, weights, count)
    first = np.zeros(count, np.int64)  # the first corner of each vertex that has a colour
    first[corners[::-1]] = np.arange(len(corners))[::-1]
    result = np.ones((count, colours.shape[1]), np.float32)
    result[total > 0] = colours[first[total > 0]]
    # Only where other corners differ from it, since a mean would round equal colours.
    mixed = np.bincount(corners, (colours != colours[first[corners]]).any(axis=1), count) > 0
    for channel in range(colours.shape[1]):
        sums = np.bincount(corners, weights * colours[:, channel], count)
        result[mixed, channel] = (sums[mixed] / total[mixed]).astype(np.float32)
    if mixed.any():
        notices.append(_MEANS_NOTICE.format(int(mixed.sum()), count))
    used = np.bincount(found.corners, minlength=count) > 0
    bare = int(np.count_nonzero(used & (total == 0)))
    if bare:
        notices.append(_UNCOLOURED_NOTICE.format(bare, count))
    return result, notices


def _areas(found: ColouredPolygons) -> Float64s:
    """Return the areas of polygons relative to their mean, all positive."""
    starts, polygon = found.offsets[:-1], polygons_of(found.offsets)
    extent = float(np.abs(found.positions).max()) or 1.0
    points = found.positions[found.corners] / extent
    points = points - points[starts[polygon]]
    after = np.arange(len(found.corners)) + 1
    after[found.offsets[1:] - 1] = starts
    across = np.cross(points, points[after])
    sums = np.stack([np.bincount(polygon, column, len(starts)) for column in across.T], axis=1)
    areas: Float64s = np.linalg.norm(sums, axis=1)
    return areas / (areas.mean() or 1.0) + _MIN_WEIGHT
