"""Draw files in one picture: read, place the cameras, draw, arrange, write."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import OutputError, UsageError
from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access
from beltrami_cli.formats.document import Written
from beltrami_cli.formats.image import format_of_suffix, write_image
from beltrami_cli.formats.image.fresh import fresh_picture
from beltrami_cli.pipeline.render.views import open_view
from beltrami_cli.pipeline.settings.render import DEFAULT_RENDER, MOST_PIXELS, RenderSettings
from beltrami_cli.pipeline.writing.output import Output
from beltrami_cli.rendering.camera import Window, fitted, orientation
from beltrami_cli.rendering.details import richest_window
from beltrami_cli.rendering.image_view import ImageView
from beltrami_cli.rendering.sheet import Background, Panel, arranged, detail_size

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from beltrami_cli.pipeline.render.views import Drawable
    from beltrami_cli.rendering.camera import Camera

    Draw = Callable[[Window, tuple[int, int]], NDArray[np.float32]]

_ALIKE = 0.1  # of the size of the first model that boxes of others may differ by and be seen by one camera


def render_file(
    sources: Sequence[str | os.PathLike[str]],
    target: str | os.PathLike[str],
    settings: RenderSettings = DEFAULT_RENDER,
    *,
    overwrite: bool = False,
    progress: Callable[[str, int, int], None] | None = None,
    access: Access = EVERYTHING_INSIDE,
) -> tuple[int, int]:
    """Draw models, points and images side by side, and write the picture.

    Parameters
    ----------
    sources : sequence of path
        The files, at least one.
    target : path
        An image of any format that can be written; "-" for standard output, as PNG.
    settings : RenderSettings
        The camera, the light, the layout.
    overwrite : bool
        Whether an existing file may be replaced.
    progress : callable, optional
        Called with a label, the views drawn and the views to draw; may raise to stop.
    access : Access
        What may be read.

    Returns
    -------
    (int, int)
        Width and height of the picture.

    Raises
    ------
    UsageError
        If settings contradict the files or each other, or the target's name is of no image.
    InputError
        If a file cannot be read or has no colours.
    OutputError
        If the target cannot be written, or is one of the sources.
    ProcessingError
        If the package that draws surfaces is not installed.
    """
    names, path = [os.fspath(source) for source in sources], os.fspath(target)
    suffix = picture_suffix(path)
    labels = _labels(names, settings)
    _check_size(len(names), settings)
    _check_target(names, path)
    output = Output(path, overwrite=overwrite)
    views = [open_view(name, settings, access) for name in names]
    picture = draw_views(views, labels, settings, progress)
    output.write(encoded(picture, path, suffix))
    return picture.shape[1], picture.shape[0]


def picture_suffix(target: str) -> str:
    """Return the extension that tells the format of a picture, with the dot.

    Raises
    ------
    UsageError
        If it tells none that can be written.
    """
    suffix = ".png" if target == "-" else Path(target).suffix.lower()
    if format_of_suffix(suffix) is None:
        raise UsageError(f"{target}: its name tells no image format; call it .png")
    return suffix


def encoded(picture: NDArray[np.uint8], target: str, suffix: str) -> Written:
    """Return a picture as the file that it is written as."""
    file = write_image(fresh_picture(picture, target), picture, suffix=suffix, small=True)
    return Written(main=[file.data])


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
        As for `render_file`.

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
    return arranged(panels, _columns(columns, len(views), settings), background_of(settings))


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


def background_of(settings: RenderSettings) -> Background:
    """Return what is behind models."""
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


def _labels(names: Sequence[str], settings: RenderSettings) -> list[str]:
    labels = settings.labels
    if labels is None:
        return [Path(name).name for name in names] if len(names) > 1 else [""]
    if labels and len(labels) != len(names):
        raise UsageError(f"there are {len(labels)} labels for {len(names)} files; give one --label for each")
    return list(labels) or [""] * len(names)


def _check_size(files: int, settings: RenderSettings) -> None:
    pixels = files * max(1, settings.turntable) * settings.size[0] * settings.size[1]
    if pixels > MOST_PIXELS:
        raise UsageError(
            f"all views have {pixels} pixels together, but at most {MOST_PIXELS} are drawn; lower --size"
        )


def _check_target(names: Sequence[str], target: str) -> None:
    if target != "-" and Path(target).resolve() in {Path(name).resolve() for name in names if name != "-"}:
        raise OutputError(target, "it is one of the files to be drawn", "name a picture as the last argument")
