"""Cameras: where they look from, and how they are placed so that all of a model is seen.

Notes
-----
View coordinates are x to the right, y up, z towards the eye. A camera of a field of view of 0 is orthographic.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

_SMALLEST = 1e-13  # of how far away from the origin a model lies: what does not get lost in rounding
_MARGIN = 0.92  # of the shorter side of a view that a model fills

# Rows: what is to the right, up and towards the eye in a view from the front, by the axis that points up.
_FRONT = {
    "x": [[0, 1, 0], [1, 0, 0], [0, 0, -1]],
    "y": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "z": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
}

Window = tuple[float, float, float, float]
"""Part of a view: left, upper, right and lower border, in shares of its width and height."""

WHOLE: Window = (0.0, 0.0, 1.0, 1.0)


@dataclass(frozen=True)
class Camera:
    """A camera.

    Attributes
    ----------
    rotation : ndarray of float64, shape (3, 3)
        Rows are the directions of view coordinates.
    place : ndarray of float64, shape (3,)
        In view coordinates: the eye, or for an orthographic camera a point in the middle of the view, before the model.
    reach : ndarray of float64, shape (2,)
        Half the width and height that are seen: at a distance of 1 from the eye, or anywhere if orthographic.
    is_orthographic : bool
        Whether all rays are parallel.
    """

    rotation: NDArray[np.float64]
    place: NDArray[np.float64]
    reach: NDArray[np.float64]
    is_orthographic: bool

    def rays(
        self, columns: NDArray[np.float64], rows: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return where rays start and their unit directions, shape (K, 3) each.

        Parameters
        ----------
        columns, rows : ndarray of float64, shape (K,)
            Places in the view in shares of its width and height; (0, 0) is its upper left corner.
        """
        across = np.column_stack([2 * columns - 1, 1 - 2 * rows]) * self.reach
        if self.is_orthographic:
            starts = self.place + np.column_stack([across, np.zeros(len(across))])
            directions = np.tile([0.0, 0.0, -1.0], (len(across), 1))
        else:
            starts = np.tile(self.place, (len(across), 1))
            directions = np.column_stack([across, np.full(len(across), -1.0)])
            directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        return starts @ self.rotation, directions @ self.rotation

    def project(self, positions: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the places of points in the view, shape (K, 2), in shares of it, and their depths, shape (K,)."""
        seen = positions @ self.rotation.T - self.place
        depth = -seen[:, 2]
        scale = 1.0 if self.is_orthographic else np.maximum(depth, 1e-300)[:, None]
        across = seen[:, :2] / (scale * self.reach)
        return np.column_stack([(1 + across[:, 0]) / 2, (1 - across[:, 1]) / 2]), depth

    def breadth(self, distances: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the width of the whole view at distances from where rays start, in units of the model."""
        width: NDArray[np.float64] = (
            2 * self.reach[0] * (np.ones_like(distances) if self.is_orthographic else distances)
        )
        return width


def orientation(azimuth: float, elevation: float, up: str = "y") -> NDArray[np.float64]:
    """Return the rotation to view coordinates, shape (3, 3).

    Parameters
    ----------
    azimuth : float
        Degrees that the eye goes to the right around the model, from the front.
    elevation : float
        Degrees that it goes up.
    up : {"x", "y", "z"}
        Which axis of the model points up.
    """
    (c, s), (d, e) = ((np.cos(angle), np.sin(angle)) for angle in np.radians((azimuth, elevation)))
    around = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    over = np.array([[1, 0, 0], [0, d, -e], [0, e, d]])
    return np.asarray(over @ around @ np.array(_FRONT[up], float))


def size_between(low: NDArray[np.float64], high: NDArray[np.float64]) -> float:
    """Return the longest side of a bounding box, or what counts as that where all lies at one place."""
    farthest = float(np.abs([low, high]).max())
    return max(float((high - low).max()), _SMALLEST * farthest, float(np.finfo(float).tiny))


def fitted(
    positions: NDArray[np.float64], rotation: NDArray[np.float64], field: float, aspect: float
) -> Camera:
    """Place a camera so that it sees all points, and they fill the view.

    Parameters
    ----------
    positions : ndarray of float64, shape (V, 3)
        The points, at least one.
    rotation : ndarray of float64, shape (3, 3)
        Where it looks from, as `orientation` gives it.
    field : float
        Field of view along the shorter side, in degrees; 0: orthographic.
    aspect : float
        Width of the view by its height.
    """
    seen = positions @ rotation.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    size = size_between(low, high)
    shape = np.array([aspect, 1.0]) / min(aspect, 1.0)
    middle = (low + high) / 2
    if field <= 0:
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
