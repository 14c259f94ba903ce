"""Views with their details and labels: drawn, and arranged in one picture."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s, Uint8s
from beltrami_cli.jobs.progress import Progress, tracked
from beltrami_cli.surface.colour_values import LUMINANCE, linear_to_srgb
from beltrami_cli.view.drawing.arranging import Panel, arranged, gap_of
from beltrami_cli.view.drawing.cameras import Camera, Window, fitted, framed, orientation, part_of
from beltrami_cli.view.drawing.image_view import ImageView
from beltrami_cli.view.drawing.views import Drawable
from beltrami_cli.view.settings import RenderSettings

_GREY = 128 / 255  # background where the outline is invisible on white
# Share of an outline that may be twice as close to white as to grey: beyond a lightness L* of 85.
_MAX_LOST_SHARE = 0.25

Draw = Callable[..., Float32s]  # called with size and window

_SAME_CAMERA = 0.1  # largest difference of bounding boxes, in sizes of the first, that share a camera
_COVERED = 0.98  # least share of a detail that the model fills, if possible
_STEPS = 8  # positions tried along each side of a detail


def draw_views(
    views: Sequence[Drawable], labels: Sequence[str], settings: RenderSettings, progress: Progress | None = None
) -> Uint8s:  # fmt: skip
    """Draw all views, each with a label that may be empty, and arrange them: sRGB, with opacity on no background."""
    panels = draw_panels(views, labels, settings, progress)
    rows = [panels] if settings.side_by_side else [[panel] for panel in panels]
    return arranged(rows, fixed_settings(settings, *panels).background_colour())


def draw_panels(
    views: Sequence[Drawable],
    labels: Sequence[str],
    settings: RenderSettings,
    progress: Progress | None = None,
) -> list[Panel]:
    drawers = _drawers(views, settings)
    half = 0.5 / settings.zoom
    whole = 0.5 - half, 0.5 - half, 0.5 + half, 0.5 + half
    drawn = [draw(settings.size, whole) for draw in tracked(drawers, "drawing", progress)]
    (width, height), count, windows = settings.size, len(settings.crops), list[Window]()
    for crop in settings.crops:
        if crop.centre is None:  # automatic details are chosen in the view of the last file
            windows.append(most_detailed_window(drawn[-1], crop.side))
            continue
        (x, y), half = crop.centre, crop.side * min(width, height) / 2
        windows.append((x - half / width, y - half / height, x + half / width, y + half / height))
    side = int((width - (count - 1) * gap_of(width)) // max(count, 2))
    panels = []
    for draw, view, label in zip(drawers, drawn, labels, strict=True):
        details = [draw((side, side), part_of(whole, window)) for window in windows]
        panels.append(Panel(view, label, details, windows))
    return panels


def _drawers(views: Sequence[Drawable], settings: RenderSettings) -> list[Draw]:
    """Return a drawing function for each view; models at the same place share a camera."""
    rotation = orientation(*settings.angles, settings.up)
    aspect = settings.size[0] / settings.size[1]
    shared: tuple[Camera, Float64s] | None = None
    drawers: list[Draw] = []
    for view in views:
        if isinstance(view, ImageView):
            drawers.append(view.draw)
            continue
        shown = framed(view.positions, view.faces)
        box = np.stack([shown.min(axis=0), shown.max(axis=0)])
        if shared is None or np.abs(box - shared[1]).max() > _SAME_CAMERA * np.ptp(shared[1], axis=0).max():
            camera = fitted(shown, rotation, settings.fov, aspect)
            shared = shared or (camera, box)
        else:
            camera = shared[0]
        drawers.append(partial(view.draw, camera, lit=settings.lit))
    return drawers


def fixed_settings(settings: RenderSettings, *panels: Panel) -> RenderSettings:
    """Return settings with the details of the first panel, and a background for all views."""
    crops = []
    for crop, (left, upper, right, lower) in zip(settings.crops, panels[0].windows, strict=True):
        crops.append(dataclasses.replace(crop, centre=((left + right) / 2, (upper + lower) / 2)))
    background = settings.background
    if background == "auto":
        background = "grey" if is_lost_on_white([panel.view for panel in panels]) else "white"
    return dataclasses.replace(settings, crops=tuple(crops), background=background)


def is_lost_on_white(views: Sequence[Float32s]) -> bool:
    """Whether more than a quarter of the outlines is much closer to white than to grey."""
    outline, white = 0, 0
    for view in views:
        shown = view[..., 3] > 0.5
        around = np.pad(shown, 1, constant_values=True)
        inner = around[2:, 1:-1] & around[:-2, 1:-1] & around[1:-1, 2:] & around[1:-1, :-2]
        drawn = view[shown & ~inner]
        colours = linear_to_srgb(np.clip(drawn[:, :3] / drawn[:, 3:], 0, 1))
        outline += len(drawn)
        white += int(np.count_nonzero(2 * (1 - colours).max(axis=1) < np.abs(colours - _GREY).max(axis=1)))
    return white > _MAX_LOST_SHARE * outline


def most_detailed_window(view: Float32s, side: float) -> Window:
    """Return the square window filled by the model in which brightness varies most (the first of equals)."""
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
    """Return the sums over all squares inside, by upper left corner."""
    table = np.pad(values, [(1, 0), (1, 0)]).cumsum(axis=0).cumsum(axis=1)
    near, far = slice(None, -square), slice(square, None)
    return np.asarray(table[far, far] - table[near, far] - table[far, near] + table[near, near])
