"""Views with their details and labels: drawn, and arranged in one picture."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from PIL import Image, ImageDraw

from beltrami_cli.arrays import Float32s, Float64s, Uint8s
from beltrami_cli.errors import ProcessingError, one_line
from beltrami_cli.formats.image.opening import error_of
from beltrami_cli.jobs.progress import Progress, tracked
from beltrami_cli.surface.colour_values import LUMINANCE, as_bytes, linear_to_srgb, srgb_to_linear
from beltrami_cli.view.settings import Colour, RenderSettings
from beltrami_cli.view.tracing import Camera, Window, fitted, orientation, part_of
from beltrami_cli.view.views import Drawable, ImageView, framed

# Frames of details, distinct for the colour-blind too. M. Okabe, K. Ito, "Color universal design" (2008).
_FRAMES = [(230, 159, 0), (0, 158, 115), (86, 180, 233), (204, 121, 167), (213, 94, 0)]
_DARK, _LIGHT = 26, 242  # greys of letters, of 255
_LIGHT_GROUND = 0.4  # luminance, beyond which letters are dark
_GREY = 128 / 255  # background where the outline is invisible on white
# Share of an outline that may be twice as close to white as to grey: beyond a lightness L* of 85.
_MAX_LOST_SHARE = 0.25
_FONT = "DroidSans"  # which OpenImageIO contains

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
    return arranged(rows, fixed_looks(settings, *panels).background_colour())


@dataclass(frozen=True)
class Panel:
    """A view, shape (H, W, 4), with a label above it, details below it, and their windows in the view."""

    view: Float32s
    label: str = ""
    details: Sequence[Float32s] = ()
    windows: Sequence[Window] = ()


def draw_panels(
    views: Sequence[Drawable],
    labels: Sequence[str],
    settings: RenderSettings,
    progress: Progress | None = None,
) -> list[Panel]:
    """Draw all views with their details."""
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
    side = int((width - (count - 1) * _gap(width)) // max(count, 2))
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


def fixed_looks(settings: RenderSettings, *panels: Panel) -> RenderSettings:
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


def arranged(rows: Sequence[Sequence[Panel | None]], background: Colour) -> Uint8s:
    """Arrange panels of one size in rows, as sRGB (H, W, 3), or (H, W, 4) without background."""
    shown = [panel for row in rows for panel in row if panel is not None]
    height, width = shown[0].view.shape[:2]
    gap = _gap(width)
    strip = round(1.8 * _letters(width)) if any(panel.label for panel in shown) else 0
    below = gap + len(shown[0].details[0]) if shown[0].details else 0
    across, down = width + gap, strip + height + below + gap
    size = len(rows[0]) * across - gap, len(rows) * down - gap
    ground = as_bytes(np.array(background))
    sheet = Image.new("RGBA", size, tuple(ground.tolist()))
    for number, panel in np.ndenumerate(np.array(rows, object)):
        if panel is None:
            continue
        top, left = number[0] * down, number[1] * across
        if panel.label:
            _draw_label(sheet, (left, top, width, strip), panel.label, background)
        view, thickness = _image_of(panel.view, background), max(2, width // 250)
        for index, window in enumerate(panel.windows):
            corners = [round(share * side) for share, side in zip(window, (width, height) * 2, strict=True)]
            _draw_frame(view, corners, thickness, index)
        sheet.paste(view, (left, top + strip))
        row = [_image_of(detail, background) for detail in panel.details]
        left += (width - sum(detail.width + gap for detail in row) + gap) // 2
        for index, detail in enumerate(row):
            _draw_frame(detail, [0, 0, *detail.size], thickness, index)
            sheet.paste(detail, (left, top + strip + height + gap))
            left += detail.width + gap
    pixels = np.asarray(sheet)
    return pixels if background[3] == 0 else np.ascontiguousarray(pixels[..., :3])


def displayed(view: Float32s, background: Colour) -> Float64s:
    """Return a view in front of a background as display values with opacity, (H, W, 4)."""
    light, opacity = view[..., :3].astype(np.float64), view[..., 3:].astype(np.float64)
    if background[3] == 0:
        light = np.divide(light, opacity, out=np.zeros_like(light), where=opacity > 0)
        return np.concatenate([linear_to_srgb(np.clip(light, 0, 1)), opacity], axis=2)
    # Partly covered pixels are mixed with the background in linear light, as the eye does.
    behind = np.asarray(srgb_to_linear(np.array(background[:3])), np.float64)
    mixed = linear_to_srgb(np.clip(light + (1 - opacity) * behind, 0, 1))
    return np.concatenate([mixed, np.ones_like(opacity)], axis=2)


def _gap(width: int) -> int:
    return max(2, width // 80)


def _image_of(view: Float32s, background: Colour) -> Image.Image:
    return Image.fromarray(as_bytes(np.clip(displayed(view, background), 0, 1)))


def _draw_frame(image: Image.Image, corners: Sequence[int], thickness: int, number: int) -> None:
    """Draw the border of a rectangle, as far as it lies in the image."""
    left, upper = max(corners[0], 0), max(corners[1], 0)
    right, lower = min(corners[2], image.width), min(corners[3], image.height)
    if left < right and upper < lower:
        box, colour = (left, upper, right - 1, lower - 1), _FRAMES[number % len(_FRAMES)]
        ImageDraw.Draw(image).rectangle(box, outline=(*colour, 255), width=thickness)


def _letters(width: int) -> int:
    """Return the height of letters above a view."""
    return max(11, round(min(width, 900) / 26))


def _draw_label(sheet: Image.Image, strip: tuple[int, int, int, int], text: str, background: Colour) -> None:
    """Write a line of text, or its end, into the middle of a strip: left, top, width and height."""
    import OpenImageIO

    left, top, width, depth = strip
    height = _letters(width)
    words = text = one_line(text)
    while (box := OpenImageIO.ImageBufAlgo.text_size(words, height, _FONT)).width > 0.96 * width and text:
        text = text[1:]
        words = "..." + text
    cover = OpenImageIO.ImageBuf(OpenImageIO.ImageSpec(width, depth, 1, "float"))
    x = (width - box.width) // 2 - box.xbegin
    y = round(depth / 2 + 0.36 * height)  # base line: small letters and capitals look centred
    if not OpenImageIO.ImageBufAlgo.render_text(cover, x, y, words, height, _FONT, (1.0,)):
        raise ProcessingError(f"labels cannot be drawn ({error_of(cover)}); use --no-labels")
    is_light = background[3] == 0 or np.dot(background[:3], LUMINANCE) > _LIGHT_GROUND
    mask = Image.fromarray(np.asarray(cover.get_pixels(OpenImageIO.UINT8))[..., 0])
    sheet.paste((*[_DARK if is_light else _LIGHT] * 3, 255), (left, top), mask)
