"""Where in a view there is most to see."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.surface.colour_values import linear_to_srgb

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.view.rendering.camera import Window

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
_COVERED = 0.98  # of a detail, at least, if there is any such place
_STEPS = 8  # places tried along each side of a detail


def richest_window(view: NDArray[np.float32], side: float) -> Window:
    """Find the square part of a view in which brightness varies most, and the model fills it.

    Parameters
    ----------
    view : ndarray of float32, shape (H, W, 4)
        Linear light times opacity, and opacity.
    side : float
        Of the square, in shares of the shorter side of the view.

    Returns
    -------
    Window
        The first of equals, from the upper left.
    """
    height, width = view.shape[:2]
    square = max(1, round(side * min(width, height)))
    brightness = linear_to_srgb(np.clip(view[..., :3].astype(np.float64) @ _LUMINANCE, 0, 1))
    cover = view[..., 3].astype(np.float64)
    sums = [_sums(values, square) for values in (cover, cover * brightness, cover * np.square(brightness))]
    stride = max(1, square // _STEPS)
    share, first, second = (values[::stride, ::stride] / square**2 for values in sums)
    mean = first / np.maximum(share, 1e-9)
    variance = second / np.maximum(share, 1e-9) - mean**2
    filled = share >= min(_COVERED, share.max())
    best = np.unravel_index(int(np.argmax(np.where(filled, variance, -1))), share.shape)
    upper, left = (int(index) * stride for index in best)
    return left / width, upper / height, (left + square) / width, (upper + square) / height


def _sums(values: NDArray[np.float64], square: int) -> NDArray[np.float64]:
    """Return the sum over each square that fits, by its upper left corner."""
    table = np.pad(values, [(1, 0), (1, 0)]).cumsum(axis=0).cumsum(axis=1)
    near, far = slice(None, -square), slice(square, None)
    return np.asarray(table[far, far] - table[near, far] - table[far, near] + table[near, near])
