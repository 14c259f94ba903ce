"""Views of points, which are drawn as discs."""

from __future__ import annotations

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s, Int64s
from beltrami_cli.surface.ranges import expanded, runs_of
from beltrami_cli.view.drawing.cameras import SAMPLES, Camera, Window

_NEIGHBOURS = 4  # on a square grid, all at the same distance
# Of the distance to the farthest neighbour: a little more than half the diagonal of a grid cell.
_SHARE = 0.75
_MAX_RADIUS_RATIO = 3.0  # times the median radius
_LONE_RADIUS = 0.02  # radius of a point without neighbours, in widths of the view
_SMALLEST = 0.75  # radius in samples; smaller points would fall between samples


class CloudView:
    """Points in linear light, as small discs that face the eye, to be looked at from anywhere."""

    def __init__(self, positions: Float64s, colours: Float64s) -> None:
        self.positions, self.faces = positions, np.zeros((0, 3), np.int32)
        self._colours = colours.astype(np.float32)
        self._radii = disc_radii(positions)

    def draw(self, camera: Camera, size: tuple[int, int], window: Window, *, lit: bool) -> Float32s:
        """Draw as `SurfaceView.draw` does, but unlit: points have no normals."""
        width, height = (side * SAMPLES for side in size)
        places, depths = camera.project(self.positions)
        share = np.array([window[2] - window[0], window[3] - window[1]])
        at = (places - window[:2]) / share * (width, height)
        radii = self._radii / camera.breadth(depths) / share[0] * width
        radii[self._radii == 0] = _LONE_RADIUS * width
        radii = np.maximum(radii, _SMALLEST)
        near = (depths > 0) & (at > -radii[:, None]).all(axis=1)
        near &= (at < np.array([width, height]) + radii[:, None]).all(axis=1)
        chosen = np.flatnonzero(near)
        # Farthest first, so that the nearest is written last and stays.
        chosen = chosen[np.lexsort((chosen, -depths[chosen]))]
        image = draw_discs(at[chosen], radii[chosen], self._colours[chosen], (width, height))
        return np.asarray(image.reshape(size[1], SAMPLES, size[0], SAMPLES, 4).mean(axis=(1, 3)), np.float32)


def disc_radii(positions: Float64s) -> Float64s:
    """Return the radius of each disc, so that neighbours leave no holes in a surface; 0 for a single place."""
    from scipy.spatial import cKDTree

    places, which = np.unique(positions, axis=0, return_inverse=True)
    if len(places) < 2:
        return np.zeros(len(positions))
    found: Float64s = np.asarray(cKDTree(places).query(places, k=min(_NEIGHBOURS + 1, len(places)))[0])
    radii = _SHARE * found[:, -1]
    # Points far from all others would hide the points around them.
    limited = np.minimum(radii, _MAX_RADIUS_RATIO * np.median(radii))
    return np.asarray(limited[which.reshape(-1)], np.float64)


def draw_discs(at: Float64s, radii: Float64s, colours: Float32s, size: tuple[int, int]) -> Float32s:
    """Return discs drawn over each other, (height, width, 4); later ones are nearer and hide earlier ones."""
    width, height = size
    front = np.full(height * width, -1, np.int64)  # index of the visible disc
    first, heights = _cells(at[:, 1], radii, height)
    for block in runs_of(heights):
        row, disc = expanded(first[block], heights[block])
        disc += block.start
        half = np.sqrt(np.maximum(radii[disc] ** 2 - (row + 0.5 - at[disc, 1]) ** 2, 0))
        left, widths = _cells(at[disc, 0], half, width)
        for run in runs_of(widths):
            column, span = expanded(left[run], widths[run])
            front[row[run][span] * width + column] = disc[run][span]  # the last one stays
    image = np.zeros((height * width, 4), np.float32)
    filled = front >= 0
    image[filled, :3] = colours[front[filled]]
    image[filled, 3] = 1
    return image.reshape(height, width, 4)


def _cells(middles: Float64s, reach: Float64s, count: int) -> tuple[Int64s, Int64s]:
    """Return the first of `count` cells whose centres are within reach of each place, and their number."""
    first = np.clip(np.ceil(middles - reach - 0.5), 0, count).astype(np.int64)
    end = np.clip(np.floor(middles + reach + 0.5), 0, count).astype(np.int64)
    return first, np.maximum(end - first, 0)
