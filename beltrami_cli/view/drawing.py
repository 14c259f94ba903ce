"""Draw views of files: place the cameras, draw wholes and details, arrange them on a sheet."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.view.rendering.camera import Window, fitted, orientation
from beltrami_cli.view.rendering.details import richest_window
from beltrami_cli.view.rendering.image_view import ImageView
from beltrami_cli.view.rendering.sheet import Background, Panel, arranged, detail_size, is_lost_on_white

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from beltrami_cli.view.rendering.camera import Camera
    from beltrami_cli.view.settings import RenderSettings
    from beltrami_cli.view.views import Drawable

    Draw = Callable[[Window, tuple[int, int]], NDArray[np.float32]]

_ALIKE = 0.1  # of the size of the first model that boxes of others may differ by and be seen by one camera


def draw_views(
    views: Sequence[Drawable],
    labels: Sequence[str],
    settings: RenderSettings,
    progress: Callable[[str, int, int], None] | None = None,
) -> NDArray[np.uint8]:
    """Draw all views, and arrange them.

    Parameters
    ----------
    views : sequence of Drawable
        What is drawn.
    labels : sequence of str
        One for each, which may be empty.
    settings : RenderSettings
        The camera, the light, the layout.
    progress : callable, optional
        Called with a label, the views drawn and the views to draw; may raise to stop.

    Returns
    -------
    ndarray of uint8, shape (H, W, 3), or (H, W, 4) on no background
        sRGB, and opacity.
    """
    panels = draw_panels(views, labels, settings, progress)
    turns = max(1, settings.turntable)
    if settings.stacked and settings.turntable:  # the turns of a model below each other
        panels = [panel for turn in range(turns) for panel in panels[turn::turns]]
    columns = turns if settings.turntable else len(views)
    return arranged(panels, _columns(columns, len(views), settings), background_of(settings, panels))


def draw_panels(
    views: Sequence[Drawable],
    labels: Sequence[str],
    settings: RenderSettings,
    progress: Callable[[str, int, int], None] | None = None,
) -> list[Panel]:
    """Draw all views with their details: of every model one after the other all its turns."""
    turns = max(1, settings.turntable)
    drawers: list[Draw] = []
    for turn in range(turns):
        azimuth = settings.azimuth + 360 * turn / turns
        drawers += _drawers(views, dataclasses.replace(settings, azimuth=azimuth))
    whole = _zoomed(settings.zoom)
    drawn = []
    for done, draw in enumerate(drawers):
        if progress is not None:
            progress("views", done, len(drawers))
        drawn.append(draw(whole, settings.size))
    windows = _detail_windows(drawn[len(views) - 1], settings)
    side = detail_size(settings.size[0], len(windows))
    panels = [
        Panel(
            drawn[turn * len(views) + number],
            labels[number] if turn == 0 else "",
            [drawers[turn * len(views) + number](_inside(whole, window), (side, side)) for window in windows],
            windows,
        )
        for number in range(len(views))
        for turn in range(turns)
    ]
    if progress is not None:
        progress("views", len(drawers), len(drawers))
    return panels


def with_fixed_crops(view: Drawable, settings: RenderSettings) -> RenderSettings:
    """Return settings in which details that choose themselves are where there is most to see in one view."""
    if all(crop.centre is not None for crop in settings.crops):
        return settings
    plain = dataclasses.replace(settings, crops=())
    drawn = draw_panels([view], [""], plain)[0].view
    windows = _detail_windows(drawn, settings)
    crops = [
        dataclasses.replace(crop, centre=((window[0] + window[2]) / 2, (window[1] + window[3]) / 2))
        for crop, window in zip(settings.crops, windows, strict=True)
    ]
    return dataclasses.replace(settings, crops=tuple(crops))


def background_of(settings: RenderSettings, panels: Sequence[Panel]) -> Background:
    """Return what is behind models."""
    if settings.background == "auto":
        lost = is_lost_on_white([panel.view for panel in panels])
        settings = dataclasses.replace(settings, background="grey" if lost else "white")
    colour = settings.background_colour()
    return Background(opacity=0.0) if colour is None else Background(colour)


def _columns(turns: int, files: int, settings: RenderSettings) -> int:
    if settings.turntable:
        return files if settings.stacked else turns
    return 1 if settings.stacked else files


def _drawers(views: Sequence[Drawable], settings: RenderSettings) -> list[Draw]:
    """Return what draws each view; models that lie in one place are seen by one camera."""
    rotation = orientation(settings.azimuth, settings.elevation, settings.up)
    aspect = settings.size[0] / settings.size[1]
    shared: tuple[Camera, NDArray[np.float64]] | None = None
    drawers: list[Draw] = []
    for view in views:
        if isinstance(view, ImageView):
            drawers.append(_draw_image(view))
            continue
        box = np.stack([view.positions.min(axis=0), view.positions.max(axis=0)])
        if shared is None or not _is_alike(box, shared[1]):
            camera = fitted(view.positions, rotation, settings.fov, aspect)
            shared = shared or (camera, box)
        else:
            camera = shared[0]
        drawers.append(_draw_model(view, camera, lit=settings.lit))
    return drawers


def _draw_image(view: ImageView) -> Draw:
    return lambda window, size: view.draw(size, window)


def _draw_model(view: Drawable, camera: Camera, *, lit: bool) -> Draw:
    assert not isinstance(view, ImageView)
    return lambda window, size: view.draw(camera, size, window, lit=lit)


def _is_alike(box: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    return bool(np.abs(box - other).max() <= _ALIKE * np.ptp(other, axis=0).max())


def _zoomed(zoom: float) -> Window:
    half = 0.5 / zoom
    return 0.5 - half, 0.5 - half, 0.5 + half, 0.5 + half


def _inside(window: Window, part: Window) -> Window:
    """Return a part of a window as a window of the whole."""
    width, height = window[2] - window[0], window[3] - window[1]
    left, upper = window[0] + part[0] * width, window[1] + part[1] * height
    return left, upper, left + (part[2] - part[0]) * width, upper + (part[3] - part[1]) * height


def _detail_windows(view: NDArray[np.float32], settings: RenderSettings) -> list[Window]:
    """Return where details are; those that choose themselves look at the last file."""
    width, height = settings.size
    shorter = min(width, height)
    windows = []
    for crop in settings.crops:
        if crop.centre is None:
            windows.append(richest_window(view, crop.side))
            continue
        (x, y), half = crop.centre, crop.side * shorter / 2
        windows.append((x - half / width, y - half / height, x + half / width, y + half / height))
    return windows
