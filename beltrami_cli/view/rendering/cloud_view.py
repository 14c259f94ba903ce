"""Views of points without faces, as small discs that look at the eye."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.view.rendering.camera import Camera, Window

SAMPLES = 3  # places along a side of each pixel
_NEIGHBOURS = 4  # on a square grid, all at one distance
_SHARE = 0.75  # of the distance to the last of them: a little more than half the diagonal of the grid
_LARGEST = 3.0  # times the median radius
_LONE = 0.02  # radius in widths of the view of a place without neighbours
_SMALLEST = 0.75  # radius in places, below which points would fall between them


class CloudView:
    """Coloured points, to be looked at from anywhere.

    Parameters
    ----------
    positions : ndarray of float64, shape (V, 3)
        At least one.
    colours : ndarray of float64, shape (V, 3)
        Linear light.
    """

    def __init__(self, positions: NDArray[np.float64], colours: NDArray[np.float64]) -> None:
        self.positions = positions
        self._colours = colours.astype(np.float32)
        self._radii = disc_radii(positions)

    def draw(
        self, camera: Camera, size: tuple[int, int], window: Window, *, lit: bool
    ) -> NDArray[np.float32]:
        """Draw a part of a view; points have no normals, so that no lamp shines on them.

        Parameters
        ----------
        camera, size, window, lit
            As for `SurfaceView.draw`.

        Returns
        -------
        ndarray of float32, shape (height, width, 4)
            Linear light times opacity, and opacity.
        """
        width, height = (side * SAMPLES for side in size)
        places, depths = camera.project(self.positions)
        share = np.array([window[2] - window[0], window[3] - window[1]])
        at = (places - window[:2]) / share * (width, height)
        radii = self._radii / camera.breadth(depths) / share[0] * width
        radii[self._radii == 0] = _LONE * width
        radii = np.maximum(radii, _SMALLEST)
        near = (depths > 0) & (at > -radii[:, None]).all(axis=1)
        near &= (at < np.array([width, height]) + radii[:, None]).all(axis=1)
        chosen = np.flatnonzero(near)
        # The farthest first: of what is written to one place, the last stays.
        chosen = chosen[np.lexsort((chosen, -depths[chosen]))]
        image = _painted(at[chosen], radii[chosen], self._colours[chosen], (width, height))
        return np.asarray(image.reshape(size[1], SAMPLES, size[0], SAMPLES, 4).mean(axis=(1, 3)), np.float32)


def _painted(
    at: NDArray[np.float64],
    radii: NDArray[np.float64],
    colours: NDArray[np.float32],
    size: tuple[int, int],
) -> NDArray[np.float32]:
    """Return discs drawn over each other, shape (height, width, 4); the nearer hides the farther."""
    width, height = size
    front = np.full(
        width * height, -1, np.int64
    )  # the number of the disc that is seen; nearer ones are later
    reach = int(np.ceil(radii.max(initial=0)))
    corner = np.floor(at).astype(np.int64)
    for down in range(-reach, reach + 1):
        for right in range(-reach, reach + 1):
            cell = corner + np.array([right, down])
            off = cell + 0.5 - at
            inside = np.einsum("kx,kx->k", off, off) <= radii**2
            inside &= ((cell >= 0) & (cell < (width, height))).all(axis=1)
            discs = np.flatnonzero(inside)
            np.maximum.at(front, cell[discs, 1] * width + cell[discs, 0], discs)
    image = np.zeros((width * height, 4), np.float32)
    filled = front >= 0
    image[filled, :3] = colours[front[filled]]
    image[filled, 3] = 1
    return image.reshape(height, width, 4)


def disc_radii(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the radius of each disc: as far as some of the nearest other places, so that a surface has no holes.

    A single place has none, and a radius of 0.
    """
    places, which = np.unique(positions, axis=0, return_inverse=True)
    if len(places) < 2:
        return np.zeros(len(positions))
    found: NDArray[np.float64] = np.asarray(
        cKDTree(places).query(places, k=min(_NEIGHBOURS + 1, len(places)))[0]
    )
    radii = _SHARE * found[:, -1]
    # Points far from all others would hide what is around them.
    limited = np.minimum(radii, _LARGEST * np.median(radii))
    return np.asarray(limited[which.reshape(-1)], np.float64)
