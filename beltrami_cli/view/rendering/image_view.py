"""Views of images, which are as they are from wherever they are looked at."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.view.rendering.paint import Pyramid
from beltrami_cli.view.rendering.surface_view import SAMPLES

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.view.rendering.camera import Window
    from beltrami_cli.view.rendering.paint import Sheet


class ImageView:
    """An image.

    Parameters
    ----------
    sheet : ndarray of float32, shape (H, W, 4)
        In linear light with opacity, which colours are not multiplied by.
    """

    def __init__(self, sheet: Sheet) -> None:
        self._pyramid = Pyramid.of(sheet)

    def draw(self, size: tuple[int, int], window: Window) -> NDArray[np.float32]:
        """Draw a part of a view that the image fills as far as its proportions let it.

        Parameters
        ----------
        size, window
            As for `SurfaceView.draw`.

        Returns
        -------
        ndarray of float32, shape (height, width, 4)
            Linear light times opacity, and opacity. At its own size, the image pixel by pixel; enlarged, texels are
            squares.
        """
        height, width = self._pyramid.levels[0].shape[:2]
        view = np.array(size) / [window[2] - window[0], window[3] - window[1]]
        scale = min(view[0] / width, view[1] / height)
        shown = np.array([width, height]) * scale
        corner = np.round((view - shown) / 2)
        samples = SAMPLES if scale != 1 else 1
        axes = [
            (np.arange(size[k] * samples) + 0.5) / samples + window[k] * view[k] - corner[k] for k in (0, 1)
        ]
        x, y = (axis.ravel() for axis in np.meshgrid(axes[0] / shown[0], axes[1] / shown[1]))
        inside = (x >= 0) & (x < 1) & (y >= 0) & (y < 1)
        uv = np.column_stack([x, y])[inside]
        if scale >= 1:  # squares, so that single pixels can be judged
            uv = (np.floor(uv * (width, height)) + 0.5) / (width, height)
        seen = np.zeros((len(x), 4), np.float32)
        texels = np.full(len(uv), 1 / (scale * samples) ** 2)
        colours = self._pyramid.look_up(uv, ("clamp", "clamp"), texels)
        colours[:, :3] *= colours[:, 3:]
        seen[inside] = colours
        blocks = seen.reshape(size[1], samples, size[0], samples, 4)
        return np.asarray(blocks.mean(axis=(1, 3)), np.float32)
