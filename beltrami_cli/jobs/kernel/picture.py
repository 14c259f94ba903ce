"""Kernels in colours: bright where they are near and weigh much, dark where they end, grey beyond."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.jobs.kernel.study import MeshView, WindowView

# Every tenth part of the colour map viridis: its lightness grows evenly, also for the colour-blind and in grey.
# S. van der Walt, N. Smith, "A better default colormap for matplotlib" (2015), in the public domain (CC0).
_VIRIDIS = np.array(
    [
        [0.267, 0.005, 0.329],
        [0.283, 0.141, 0.458],
        [0.254, 0.265, 0.530],
        [0.207, 0.372, 0.553],
        [0.164, 0.471, 0.558],
        [0.128, 0.567, 0.551],
        [0.135, 0.659, 0.518],
        [0.267, 0.749, 0.441],
        [0.478, 0.821, 0.318],
        [0.741, 0.873, 0.150],
        [0.993, 0.906, 0.144],
    ]
)
# What the painting is drawn in where the kernel does not reach: grey, neither black nor white.
_GREY_FROM, _GREY_TO = 0.35, 0.9
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
_NOTHING = 1.0  # where there is no sample
_PANEL, _GAP = 420, 12  # pixels
_SOURCE = np.array([0.9, 0.1, 0.1])


def coloured(
    values: NDArray[np.float32], shades: NDArray[np.float32], held: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Colour values by viridis, and the painting in grey where there is none.

    Parameters
    ----------
    values : ndarray of float32, any shape
        From 0 (dark) to 1 (bright).
    shades : ndarray of float32, of that shape and one axis of 3 more
        The painting, as display values.
    held : ndarray of bool, of that shape
        Which values are meant.

    Returns
    -------
    ndarray of float64, shape as `shades`
        Display values in [0, 1].
    """
    at = np.clip(np.where(held, values, 0), 0, 1)
    steps = np.linspace(0, 1, len(_VIRIDIS))
    colours = np.stack([np.interp(at, steps, channel) for channel in _VIRIDIS.T], axis=-1)
    grey = _GREY_FROM + (_GREY_TO - _GREY_FROM) * (shades.astype(np.float64) @ _LUMINANCE)
    return np.where(held[..., None], colours, grey[..., None])


def nearness(view: MeshView | WindowView, radius: float) -> NDArray[np.float32]:
    """Return 1 at the kernel's own sample, falling to 0 at the radius; NaN where the kernel holds nothing."""
    return np.asarray(1 - view.distances / np.float32(radius), np.float32)


def draw_mesh(view: MeshView, radius: float) -> NDArray[np.uint8]:
    """Return the colours of a mesh's vertices, shape (V, 3), by the distance."""
    return _as_bytes(coloured(nearness(view, radius), view.shades, np.isfinite(view.distances)))


def draw_window(view: WindowView, radius: float) -> NDArray[np.uint8]:
    """Draw a window three times side by side: the painting, the distances, the weights.

    Returns
    -------
    ndarray of uint8, shape (H, W, 3)
        Each cell a square of whole pixels; the kernel's own is framed.
    """
    held = np.isfinite(view.distances)
    panels = (
        view.shades.astype(np.float64),
        coloured(nearness(view, radius), view.shades, held),
        coloured(view.weights / view.weights.max(), view.shades, held),
    )
    zoom = max(1, _PANEL // len(view.filled))
    drawn = [_enlarged(np.where(view.filled[..., None], panel, _NOTHING), zoom) for panel in panels]
    if zoom > 2:
        for panel in drawn:
            _frame(panel, view.source, zoom)
    gap = np.full((len(drawn[0]), _GAP, 3), _NOTHING)
    return _as_bytes(np.hstack([drawn[0], gap, drawn[1], gap, drawn[2]]))


def _enlarged(panel: NDArray[np.float64], zoom: int) -> NDArray[np.float64]:
    return panel.repeat(zoom, axis=0).repeat(zoom, axis=1)


def _frame(panel: NDArray[np.float64], cell: tuple[int, int], zoom: int) -> None:
    """Draw the border of a cell, in place."""
    thickness = max(1, zoom // 14)
    square = panel[cell[0] * zoom : (cell[0] + 1) * zoom, cell[1] * zoom : (cell[1] + 1) * zoom]
    inside = square[thickness:-thickness, thickness:-thickness].copy()
    square[:] = _SOURCE
    square[thickness:-thickness, thickness:-thickness] = inside


def _as_bytes(colours: NDArray[np.float64]) -> NDArray[np.uint8]:
    return np.rint(255 * colours).astype(np.uint8)
