"""What the figures share: pictures in a grid with titles, enlarged without interpolation, and views of surfaces."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.surface.colour_values import srgb_to_linear
from beltrami_cli.view.drawing.arranging import displayed
from beltrami_cli.view.drawing.cameras import fitted, orientation
from beltrami_cli.view.drawing.surface_colours import InterpolatedColours
from beltrami_cli.view.drawing.surface_view import SurfaceView
from beltrami_cli.view.settings import DEFAULT_RENDER

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

Array = NDArray[np.float64]

DOTS_PER_INCH = 100


def figure(
    rows: int, columns: int, size: tuple[float, float], heights: Sequence[float] | None = None
) -> tuple[Any, Any]:
    """Return a figure of a size in inches, and the grid that its pictures are put in."""
    from matplotlib.figure import Figure

    made = Figure(figsize=size, dpi=DOTS_PER_INCH, layout="constrained")
    made.get_layout_engine().set(hspace=0.06, wspace=0.04)
    return made, made.add_gridspec(rows, columns, height_ratios=heights)


def show(
    axes: Any,
    image: Array,
    title: str = "",
    *,
    limits: tuple[float, float] | None = None,
    marked: tuple[int, int] | None = None,
    edge: float | None = None,
    cmap: str = "viridis",
) -> Any:
    """Show colours of shape (H, W, 3), grey of shape (H, W, 1), or values of shape (H, W) by a colour map."""
    from matplotlib.patches import Rectangle

    low, high = limits or (None, None)
    if image.ndim == 3 and image.shape[2] == 1:
        image, cmap, low, high = image[..., 0], "gray", 0.0, 1.0
    drawn = axes.imshow(np.clip(image, 0, 1) if image.ndim == 3 else image, cmap=cmap, vmin=low, vmax=high)
    drawn.set_interpolation("nearest")
    axes.set(xticks=(), yticks=())
    axes.set_title(title, fontsize=10)
    if marked is not None:
        axes.add_patch(Rectangle((marked[1] - 0.5, marked[0] - 0.5), 1, 1, fill=False, ec="red", lw=1.5))
    if edge is not None:
        axes.axvline(edge, color="white", lw=1, ls="--")
    return drawn


def view(
    heights: Array,
    colours: Array,
    size: int,
    angles: tuple[float, float],
    *,
    lying: bool = False,
    shade: bool = False,
) -> NDArray[np.float32]:
    """Return a view of a surface over the image plane, coloured by the image, cropped to its visible part.

    Parameters
    ----------
    heights : ndarray of float64, shape (H, W)
        In pixels.
    colours : ndarray of float64, shape (H, W, 3)
        Display values.
    size : int
        Pixels a side, before cropping.
    angles : (float, float)
        Degrees to the right about the vertical, and towards a view from above.
    lying : bool
        Whether heights go up, as of a landscape, and not towards the eye, as of a face.
    shade : bool
        Whether to add light.
    """
    rows, columns = heights.shape
    y, x = np.mgrid[:rows, :columns]
    places = [x, heights, y] if lying else [x, -y, heights]
    positions = np.stack(places, axis=2).reshape(-1, 3).astype(float)
    corner = (y * columns + x)[:-1, :-1].ravel()
    upper = np.column_stack([corner, corner + columns, corner + 1])
    lower = np.column_stack([corner + 1, corner + columns, corner + columns + 1])
    faces = np.concatenate([upper, lower]).astype(np.int32)
    light = srgb_to_linear(np.clip(colours, 0, 1).reshape(-1, 3))
    surface = SurfaceView(positions, faces, InterpolatedColours(faces, light))
    camera = fitted(positions, orientation(*angles), 0, 1)
    drawn = surface.draw(camera, (size, size), (0.0, 0.0, 1.0, 1.0), lit=shade)
    seen = drawn[..., 3] > 0
    inside = np.ix_(np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0)))
    return displayed(drawn[inside], DEFAULT_RENDER.background_colour())[..., :3].astype(np.float32)


def save(made: Any, path: Path) -> None:
    """Write a figure as a PNG file."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    canvas = FigureCanvasAgg(made)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3]
    # Steps of 4 in 255 are not seen, and make the file a third smaller.
    coarse = (pixels & 0xFC) | (pixels >> 6)
    Image.fromarray(coarse).save(path, optimize=True)
