"""Cameras, and what views of models are framed by.

View coordinates are x to the right, y up, z towards the eye.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Array, Float64s, Int32s
from beltrami_cli.surface.geometry import vertex_areas
from beltrami_cli.surface.grouping import connected, group_equal_rows

# Rows: the directions to the right, up and towards the eye in a view from the front, by the axis that points up.
_FRONT = {
    "x": [[0, 1, 0], [1, 0, 0], [0, 0, -1]],
    "y": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "z": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
}
_NARROWEST = 1e-3  # degrees: smaller fields of view are orthographic
_MARGIN = 0.92  # of the shorter side of a view that a model fills
_SMALLEST = 1e-13  # of the distance from the origin: smaller models would vanish by rounding
# Models beyond 2^128 or below 2^-128 are rescaled, which keeps their fourth powers within 2^256.
_MAX_EXPONENT = 128
_MAX_OUTLIER_SHARE = 0.01  # of the surface or the points, so that parts of some size are always framed
_MIN_OUTLIER_GAP = 0.5  # sizes of the rest; with smaller gaps, the rest fills at least half of the view

SAMPLES = 3  # along each side of a pixel

Window = tuple[float, float, float, float]
"""Part of a view: left, upper, right and lower border, as fractions of its width and height."""


def part_of(window: Window, part: Window) -> Window:
    """Return a part of a window as a window of the whole view."""
    width, height = window[2] - window[0], window[3] - window[1]
    left, upper = window[0] + part[0] * width, window[1] + part[1] * height
    return left, upper, left + (part[2] - part[0]) * width, upper + (part[3] - part[1]) * height


@dataclass(frozen=True)
class Camera:
    """A perspective or orthographic camera."""

    rotation: Float64s  # (3, 3): rows are the directions of view coordinates
    place: Float64s  # (3,), view coordinates: the eye; orthographic: a point in front of the model
    reach: Float64s  # (2,): half the width and height seen at distance 1; orthographic: anywhere
    is_orthographic: bool

    def rays(
        self, columns: Float64s, rows: Float64s, precision: type[np.float32] | type[np.float64] = np.float64
    ) -> tuple[Array, Array]:
        """Return origins and unit directions of rays, (K, 3) each, through places in fractions of the view."""
        # Columns (C,) with rows (R, 1) make a grid, by the rules of broadcasting.
        across = ((2 * columns - 1) * self.reach[0])[..., None]
        up = ((1 - 2 * rows) * self.reach[1])[..., None]
        right, above, back = self.rotation
        eye = self.place @ self.rotation
        if self.is_orthographic:
            starts = (eye + up * above) + across * right
            return starts.reshape(-1, 3), np.broadcast_to(-back, (starts.size // 3, 3))
        directions = (up * above - back).astype(precision) + (across * right).astype(precision)
        directions /= np.sqrt(across**2 + up**2 + 1).astype(precision)
        return np.broadcast_to(eye, (directions.size // 3, 3)), directions.reshape(-1, 3)

    def project(self, positions: Float64s) -> tuple[Float64s, Float64s]:
        """Return where points are in the view, (K, 2), as fractions of it, and their depths, (K,)."""
        seen = positions @ self.rotation.T - self.place
        depth = -seen[:, 2]
        scale = 1.0 if self.is_orthographic else np.maximum(depth, 1e-300)[:, None]
        across = seen[:, :2] / (scale * self.reach)
        return np.column_stack([(1 + across[:, 0]) / 2, (1 - across[:, 1]) / 2]), depth

    def breadth(self, distances: Float64s) -> Float64s:
        """Return the width of the whole view at distances from the origins of rays, in units of the model."""
        return np.asarray(
            2 * self.reach[0] * (np.ones_like(distances) if self.is_orthographic else distances)
        )


def orientation(azimuth: float, elevation: float, up: str = "y") -> Float64s:
    """Return the rotation to view coordinates, (3, 3), of an eye to the right of the front and above, in degrees."""
    (c, s), (d, e) = ((np.cos(angle), np.sin(angle)) for angle in np.radians((azimuth, elevation)))
    around = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    over = np.array([[1, 0, 0], [0, d, -e], [0, e, d]])
    return np.asarray(over @ around @ np.array(_FRONT[up], float))


def size_between(low: Float64s, high: Float64s) -> float:
    """Return the longest side of a bounding box, or a small positive number for a single point."""
    farthest = float(np.abs([low, high]).max())
    return max(float((high - low).max()), _SMALLEST * farthest, float(np.finfo(float).tiny))


def fitted(positions: Float64s, rotation: Float64s, field: float, aspect: float) -> Camera:
    """Place a camera so that all points, at least one, are visible and fill the view."""
    seen = positions @ rotation.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    size = size_between(low, high)
    shape = np.array([aspect, 1.0]) / min(aspect, 1.0)
    middle = (low + high) / 2
    if field < _NARROWEST:
        half = max(float(((high - low)[:2] / 2 / shape).max()), 1e-6 * size) / _MARGIN
        return Camera(rotation, np.array([*middle[:2], high[2] + size]), half * shape, True)
    reach = np.tan(np.radians(field) / 2) * shape
    # |x - cx| <= T (d - z) for all points: linear in the eye (cx, d), so the outermost planes decide.
    slope = _MARGIN * reach
    centred = seen - middle
    right = (centred[:, :2] + slope * centred[:, 2:]).max(axis=0)
    left = (-centred[:, :2] + slope * centred[:, 2:]).max(axis=0)
    nearest = float(centred[:, 2].max())
    distance = max(float(((right + left) / (2 * slope)).max()), nearest + 0.05 * size)
    eye = middle + np.array([*(right - left) / 2, distance])
    return Camera(rotation, eye, reach, False)


def within_reach(positions: Float64s) -> Float64s:
    """Return positions, scaled by a power of two if squares of areas would overflow or underflow."""
    largest = np.max(np.abs(positions), where=np.isfinite(positions), initial=0.0)
    exponent = np.frexp(largest)[1]
    if abs(exponent) < _MAX_EXPONENT:
        return positions
    return np.asarray(np.ldexp(positions, -_MAX_EXPONENT * round(exponent / _MAX_EXPONENT)), np.float64)


def framed(positions: Float64s, faces: Int32s) -> Float64s:
    """Return the finite positions that views are framed by: without outliers, which are parts far from the rest."""
    places = within_reach(positions)
    is_finite = np.isfinite(places).all(axis=1)
    weights = vertex_areas(places, faces).astype(np.float64) if len(faces) else np.ones(len(places))
    weights[~(is_finite & np.isfinite(weights))] = 0
    if not weights.any():
        return np.asarray(positions[is_finite])
    ends = [_MAX_OUTLIER_SHARE / 2, 1 - _MAX_OUTLIER_SHARE / 2]
    known, shares = places[is_finite], weights[is_finite]
    low, high = np.transpose(
        [np.quantile(axis, ends, weights=shares, method="inverted_cdf") for axis in known.T]
    )
    reach = _MIN_OUTLIER_GAP * (high - low).max()
    is_near = is_finite & ((places >= low - reach) & (places <= high + reach)).all(axis=1)
    # Parts that are connected to the rest, at places of vertices, are framed.
    if len(faces) and not is_near.all():
        place_of, _ = group_equal_rows(*np.nan_to_num(places).T)
        corners = place_of[faces]
        part_of = connected(len(places), np.concatenate([corners[:, :2], corners[:, 1:]]))[place_of]
        is_near = is_finite & np.isin(part_of, part_of[is_near & (weights > 0)])
    return np.asarray(positions[is_near])
