"""Panels, arranged in one picture with labels and frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw

from beltrami_cli.arrays import Float32s, Float64s, Uint8s
from beltrami_cli.errors import ProcessingError, one_line
from beltrami_cli.formats.image.opening import error_of
from beltrami_cli.surface.colour_map import as_bytes
from beltrami_cli.surface.colour_values import LUMINANCE, linear_to_srgb, srgb_to_linear
from beltrami_cli.view.drawing.cameras import Window
from beltrami_cli.view.settings import Colour

# Frames of details, distinct for the colour-blind too. M. Okabe, K. Ito, "Color universal design" (2008).
_FRAMES = [(230, 159, 0), (0, 158, 115), (86, 180, 233), (204, 121, 167), (213, 94, 0)]
_DARK, _LIGHT = 26, 242  # greys of letters, of 255
_LIGHT_GROUND = 0.4  # luminance, beyond which letters are dark
_FONT = "DroidSans"  # which OpenImageIO contains


@dataclass(frozen=True)
class Panel:
    """A view, shape (H, W, 4), with a label above it, details below it, and their windows in the view."""

    view: Float32s
    label: str = ""
    details: Sequence[Float32s] = ()
    windows: Sequence[Window] = ()


def arranged(rows: Sequence[Sequence[Panel | None]], background: Colour) -> Uint8s:
    """Arrange panels of one size in rows, as sRGB (H, W, 3), or (H, W, 4) without background."""
    shown = [panel for row in rows for panel in row if panel is not None]
    height, width = shown[0].view.shape[:2]
    gap = gap_of(width)
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


def gap_of(width: int) -> int:
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
