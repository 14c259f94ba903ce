"""Views of images."""

from __future__ import annotations

import numpy as np
from PIL import Image

from beltrami_cli.arrays import Float32s
from beltrami_cli.view.drawing.cameras import SAMPLES, Window
from beltrami_cli.view.light import LinearPixels
from beltrami_cli.view.settings import SHORTEST_SIDE


class ImageView:
    """An image, which looks the same from all directions."""

    def __init__(self, pixels: LinearPixels) -> None:
        self._pixels = pixels
        pixels[..., :3] *= pixels[..., 3:]

    def size_within(self, size: tuple[int, int]) -> tuple[int, int]:
        """Return the largest size of a view that the image fills, but for the least size of views."""
        shape = np.array(self._pixels.shape[1::-1])
        fitting = np.round(shape * (np.array(size) / shape).min())
        width, height = np.maximum(fitting, SHORTEST_SIDE).astype(int)
        return int(width), int(height)

    def draw(self, size: tuple[int, int], window: Window) -> Float32s:
        """Draw a window of a view; the image fits into the view, with its proportions; see `SurfaceView.draw`."""
        shape, begin, end = np.array(self._pixels.shape[1::-1]), np.array(window[:2]), np.array(window[2:])
        view = np.array(size) / (end - begin)
        scale = (view / shape).min()
        shift = begin * view - np.round((view - shape * scale) / 2)  # of the drawing on the enlarged image
        first = np.clip(np.round(-shift), 0, size).astype(int)
        last = np.clip(np.round(shape * scale - shift), first, size).astype(int)
        drawn = np.zeros((size[1], size[0], 4), np.float32)
        if (first < last).all():
            box = np.clip(np.concatenate([first + shift, last + shift]) / scale, 0, np.tile(shape, 2))
            # Means of some places in each pixel, which see squares, so that single pixels can be judged, or areas.
            places = tuple(SAMPLES * (last - first))
            for channel in range(4):
                plane = Image.fromarray(self._pixels[..., channel])
                part = plane.resize(places, Image.Resampling.BOX, box=tuple(box)).reduce(SAMPLES)
                drawn[first[1] : last[1], first[0] : last[0], channel] = np.asarray(part)
        return drawn
