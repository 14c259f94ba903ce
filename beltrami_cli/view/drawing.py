"""Draw views of files: place the cameras, draw wholes and details, arrange them on a sheet."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s, Uint8s
from beltrami_cli.jobs.job import Progress
from beltrami_cli.surface.records import linear_to_srgb
from beltrami_cli.view.camera import Camera, Window, fitted, orientation, part_of
from beltrami_cli.view.settings import RenderSettings
from beltrami_cli.view.sheet import LUMINANCE, Background, Panel, arranged, detail_size, is_lost_on_white
from beltrami_cli.view.views import Drawable, ImageView, framed

Draw = Callable[..., Float32s]  # of a size and a window

_ALIKE = 0.1  # boxes that differ by less than this, in sizes of the first, are seen by one camera
_COVERED = 0.98  # of a detail, at least, if there is any such place
_STEPS_OF_A_VIEW = 100  # that progress counts
_STEPS = 8  # places tried along each side of a detail


def draw_views(
    views: Sequence[Drawable], labels: Sequence[str], settings: RenderSettings, progress: Progress | None = None
) -> Uint8s:  # fmt: skip
    """Draw all views, each with a label that may be empty, and arrange them: sRGB, with opacity on no background."""
    panels = draw_panels(views, labels, settings, progress)
    turns = max(1, settings.turntable)
    if not settings.side_by_side and settings.turntable:  # the turns of a model below each other
        panels = [panel for turn in range(turns) for panel in panels[turn::turns]]
    across, down = (turns, len(views)) if settings.turntable else (len(views), 1)
    return arranged(panels, across if settings.side_by_side else down, background_of(settings, panels))


def draw_turns(
    views: Sequence[Drawable], labels: Sequence[str], settings: RenderSettings, progress: Progress | None
) -> list[Uint8s]:
    """Draw all views at each turn of a turntable, as pictures of one size."""
    panels = draw_panels(views, labels, settings, progress)
    background = background_of(settings, panels)
    turns = settings.turntable
    named = [dataclasses.replace(panel, label=labels[at // turns]) for at, panel in enumerate(panels)]
    across = len(views) if settings.side_by_side else 1
    return [arranged(named[turn::turns], across, background) for turn in range(turns)]


def draw_panels(
    views: Sequence[Drawable], labels: Sequence[str], settings: RenderSettings, progress: Progress | None = None
) -> list[Panel]:  # fmt: skip
    """Draw all views with their details: of every model one after the other all its turns."""
    turns = max(1, settings.turntable)
    drawers: list[Draw] = []
    nowhere = np.zeros((0, 3))
    frames = [
        nowhere if isinstance(view, ImageView) else framed(view.positions, view.faces) for view in views
    ]
    for turn in range(turns):
        azimuth = settings.azimuth + 360 * turn / turns
        drawers += _drawers(views, frames, dataclasses.replace(settings, azimuth=azimuth))
    half = 0.5 / settings.zoom
    whole = 0.5 - half, 0.5 - half, 0.5 + half, 0.5 + half
    drawn = []
    for done, draw in enumerate(drawers):
        drawn.append(draw(settings.size, whole, progress=_share_of(progress, done, len(drawers))))
    windows = _detail_windows(drawn[len(views) - 1], settings)
    side = detail_size(settings.size[0], len(windows))
    panels = []
    for number, turn in np.ndindex(len(views), turns):
        at = turn * len(views) + number
        details = [drawers[at]((side, side), part_of(whole, window)) for window in windows]
        panels.append(Panel(drawn[at], labels[number] if turn == 0 else "", details, windows))
    if progress is not None:
        progress("drawing", _STEPS_OF_A_VIEW * len(drawers), _STEPS_OF_A_VIEW * len(drawers))
    return panels


def _share_of(progress: Progress | None, view: int, views: int) -> Callable[[int, int], None] | None:
    """Return what shows how much is drawn of one of several views."""
    if progress is None:
        return None
    first, total = _STEPS_OF_A_VIEW * view, _STEPS_OF_A_VIEW * views
    progress("drawing", first, total)
    return lambda done, rows: progress("drawing", first + _STEPS_OF_A_VIEW * done // rows, total)


def with_fixed_crops(view: Drawable, settings: RenderSettings) -> RenderSettings:
    """Return settings whose automatic details are fixed to where there is most to see in one view."""
    if all(crop.centre is not None for crop in settings.crops):
        return settings
    drawn = draw_panels([view], [""], dataclasses.replace(settings, crops=()))[0].view
    windows = _detail_windows(drawn, settings)
    centres = [((left + right) / 2, (upper + lower) / 2) for left, upper, right, lower in windows]
    pairs = zip(settings.crops, centres, strict=True)
    crops = tuple(dataclasses.replace(crop, centre=centre) for crop, centre in pairs)
    return dataclasses.replace(settings, crops=crops)


def background_of(settings: RenderSettings, panels: Sequence[Panel]) -> Background:
    """Choose the background of the panels."""
    if settings.background == "auto":
        lost = is_lost_on_white([panel.view for panel in panels])
        settings = dataclasses.replace(settings, background="grey" if lost else "white")
    colour = settings.background_colour()
    return Background(opacity=0.0) if colour is None else Background(colour)


def richest_window(view: Float32s, side: float) -> Window:
    """Return the square window, the first of equals, filled by the model, with the most varying brightness."""
    height, width = view.shape[:2]
    square = max(1, round(side * min(width, height)))
    brightness = linear_to_srgb(np.clip(view[..., :3].astype(np.float64) @ LUMINANCE, 0, 1))
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


def _sums(values: Float64s, square: int) -> Float64s:
    """Return the sum over each square that fits, by its upper left corner."""
    table = np.pad(values, [(1, 0), (1, 0)]).cumsum(axis=0).cumsum(axis=1)
    near, far = slice(None, -square), slice(square, None)
    return np.asarray(table[far, far] - table[near, far] - table[far, near] + table[near, near])


def _drawers(views: Sequence[Drawable], frames: Sequence[Float64s], settings: RenderSettings) -> list[Draw]:
    """Return what draws each view; models that lie in one place are seen by one camera."""
    rotation = orientation(settings.azimuth, settings.elevation, settings.up)
    aspect = settings.size[0] / settings.size[1]
    shared: tuple[Camera, Float64s] | None = None
    drawers: list[Draw] = []
    for view, shown in zip(views, frames, strict=True):
        if isinstance(view, ImageView):
            drawers.append(view.draw)
            continue
        box = np.stack([shown.min(axis=0), shown.max(axis=0)])
        if shared is None or np.abs(box - shared[1]).max() > _ALIKE * np.ptp(shared[1], axis=0).max():
            camera = fitted(shown, rotation, settings.fov, aspect)
            shared = shared or (camera, box)
        else:
            camera = shared[0]
        drawers.append(partial(view.draw, camera, lit=settings.lit))
    return drawers


def _detail_windows(view: Float32s, settings: RenderSettings) -> list[Window]:
    """Return where details are; automatic ones are chosen in the view of the last file."""
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
