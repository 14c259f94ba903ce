"""Several views in one picture: in rows and columns, with labels above them and enlarged details below."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import PurePath, PurePosixPath

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s, Uint8s
from beltrami_cli.errors import ProcessingError, one_line
from beltrami_cli.formats.image.reading import error_of
from beltrami_cli.surface.records import as_bytes, linear_to_srgb, srgb_to_linear
from beltrami_cli.view.camera import Window, pixels_of

# Frames of details, distinct for the colour-blind too. M. Okabe, K. Ito, "Color universal design" (2008).
_FRAMES = np.array([[230, 159, 0], [0, 158, 115], [86, 180, 233], [204, 121, 167], [213, 94, 0]]) / 255
_DARK, _LIGHT = 0.1, 0.95  # greys of letters
_GREY = 128 / 255  # the background where white hides the outline
_LOST = (
    0.25  # share of an outline that may be twice as close to white as to grey, beyond a lightness L* of 85
)
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
_FONT = "DroidSans"  # which OpenImageIO contains


@dataclass(frozen=True)
class Background:
    """Display values from 0 to 1 behind models; an opacity of 0 makes a picture with an alpha channel."""

    colour: tuple[float, float, float] = (1.0, 1.0, 1.0)
    opacity: float = 1.0


@dataclass(frozen=True)
class Panel:
    """A view, shape (H, W, 4), with a label above it, details below it, and their windows in the view."""

    view: Float32s
    label: str = ""
    details: Sequence[Float32s] = ()
    windows: Sequence[Window] = ()


def distinct_labels(paths: Sequence[str]) -> list[str]:
    """Return the names of files; of files with equal names, also what differs in their folders."""
    parts = [PurePath(path).parts for path in paths]
    labels = []
    for own in parts:
        folders_of = [other[:-1] for other in parts if other[-1:] == own[-1:]]
        first = _shared(folders_of)
        last = _shared([folders[first:][::-1] for folders in folders_of])
        differing = own[first : len(own) - 1 - last]
        between = ("...",) if last and differing else ()
        labels.append(str(PurePosixPath(*differing, *between, *own[-1:])))
    return labels


def _shared(rows: Sequence[Sequence[str]]) -> int:
    """Return how many words all rows begin with."""
    columns = zip(*rows, strict=False)  # as long as the shortest
    return len([*takewhile(lambda column: len({*column}) == 1, columns)])


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
    return white > _LOST * outline


def arranged(panels: Sequence[Panel | None], columns: int, background: Background) -> Uint8s:
    """Arrange panels of one size in rows and columns, as sRGB (H, W, 3), or (H, W, 4) without background."""
    labelled = any(panel.label for panel in panels if panel is not None)
    pictures = [None if panel is None else _drawn(panel, background, labelled=labelled) for panel in panels]
    height, width, _ = next(picture.shape for picture in pictures if picture is not None)
    blank, gap = _blank(height, width, background), _gap(width)
    drawn = [blank if picture is None else picture for picture in pictures]
    rows = []
    for first in range(0, len(drawn), columns):
        row = drawn[first : first + columns]
        row += [blank] * (min(columns, len(drawn)) - len(row))
        rows.append(_joined(row, gap, background, axis=1))
    sheet = _joined(rows, gap, background, axis=0)
    return as_bytes(np.clip(sheet if background.opacity == 0 else sheet[..., :3], 0, 1))


def detail_size(width: int, count: int) -> int:
    """Return the side in pixels of details that stand below a view of a width."""
    return int((width - (count - 1) * _gap(width)) // max(count, 2))


def displayed(view: Float32s, background: Background) -> Float64s:
    """Return a view in front of a background as display values with opacity, (H, W, 4)."""
    light, opacity = view[..., :3].astype(np.float64), view[..., 3:].astype(np.float64)
    if background.opacity == 0:
        light = np.divide(light, opacity, out=np.zeros_like(light), where=opacity > 0)
        return np.concatenate([linear_to_srgb(np.clip(light, 0, 1)), opacity], axis=2)
    # Partly covered pixels are mixed with the background in linear light, as the eye does.
    behind = np.asarray(srgb_to_linear(np.array(background.colour)), np.float64)
    mixed = linear_to_srgb(np.clip(light + (1 - opacity) * behind, 0, 1))
    return np.concatenate([mixed, np.ones_like(opacity)], axis=2)


def _gap(width: int) -> int:
    return max(2, width // 80)


def _drawn(panel: Panel, background: Background, *, labelled: bool) -> Float64s:
    """Return the label, the view with frames, and the details of a panel, one below the other."""
    view = displayed(panel.view, background)
    height, width = view.shape[:2]
    thickness = max(2, width // 250)
    for number, window in enumerate(panel.windows):
        _draw_frame(view[pixels_of(window, width, height)], thickness, number)
    parts = [_label(panel.label, width, background)] if labelled else []
    parts.append(view)
    if panel.details:
        details = [displayed(detail, background) for detail in panel.details]
        for number, detail in enumerate(details):
            _draw_frame(detail, thickness, number)
        row = _joined(details, _gap(width), background, axis=1)
        rest = width - row.shape[1]
        sides = [_blank(len(row), part, background) for part in (rest // 2, rest - rest // 2)]
        parts += [_blank(_gap(width), width, background), np.concatenate([sides[0], row, sides[1]], axis=1)]
    return np.concatenate(parts)


def _label(text: str, width: int, background: Background) -> Float64s:
    letters = max(11, round(min(width, 900) / 26))
    strip = _blank(round(1.8 * letters), width, background)
    if not text:
        return strip
    cover = _lettering(text, (width, len(strip)), letters)[..., None]
    is_light = background.opacity == 0 or np.dot(background.colour, LUMINANCE) > 0.4
    return strip * (1 - cover) + np.array([_DARK if is_light else _LIGHT] * 3 + [1.0]) * cover


def _lettering(text: str, size: tuple[int, int], height: int) -> Float32s:
    """Return how much of each pixel of a strip is covered by a line of text in its middle, 0 to 1."""
    import OpenImageIO

    words = text = one_line(text)
    box = OpenImageIO.ImageBufAlgo.text_size(words, height, _FONT)
    while box.width > 0.96 * size[0] and text:
        text = text[1:]
        words = "..." + text
        box = OpenImageIO.ImageBufAlgo.text_size(words, height, _FONT)
    strip = OpenImageIO.ImageBuf(OpenImageIO.ImageSpec(*size, 1, "float"))
    x = (size[0] - box.width) // 2 - box.xbegin
    y = round(size[1] / 2 + 0.36 * height)  # the base line; small letters and capitals look centred
    if not OpenImageIO.ImageBufAlgo.render_text(strip, x, y, words, height, _FONT, (1.0,)):
        raise ProcessingError(f"labels cannot be drawn ({error_of(strip)}); use --no-labels")
    return np.clip(np.asarray(strip.get_pixels(OpenImageIO.FLOAT), np.float32)[..., 0], 0, 1)


def _blank(height: int, width: int, background: Background) -> Float64s:
    return np.tile(np.array([*background.colour, background.opacity]), (height, width, 1))


def _joined(parts: Sequence[Float64s], gap: int, background: Background, axis: int) -> Float64s:
    """Put parts next to each other, with gaps between them."""
    height, width = parts[0].shape[:2]
    between = _blank(gap, width, background) if axis == 0 else _blank(height, gap, background)
    pieces = [piece for part in parts for piece in (between, part)]
    return np.concatenate(pieces[1:], axis=axis)


def _draw_frame(picture: Float64s, thickness: int, number: int) -> None:
    inner = picture[thickness:-thickness, thickness:-thickness].copy()
    picture[..., :3], picture[..., 3] = _FRAMES[number % len(_FRAMES)], 1
    picture[thickness:-thickness, thickness:-thickness] = inner
