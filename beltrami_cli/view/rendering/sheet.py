"""Several views in one picture: in rows and columns, with labels above them and enlarged details below."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.surface.colour_values import linear_to_srgb
from beltrami_cli.view.rendering.lettering import lettering

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from beltrami_cli.view.rendering.camera import Window

# Frames of details, told apart by the colour-blind too. M. Okabe, K. Ito, "Color universal design" (2008).
_FRAMES = np.array([[230, 159, 0], [0, 158, 115], [86, 180, 233], [204, 121, 167], [213, 94, 0]]) / 255
_DARK, _LIGHT = 0.1, 0.95
# Linear light above which a channel can hardly be told from white, and the share of an outline that may be so white.
_NEARLY_WHITE, _LOST = 0.85, 0.25
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


@dataclass(frozen=True)
class Background:
    """What is behind models.

    Attributes
    ----------
    colour : tuple of float
        Red, green and blue as display values, 0 to 1.
    opacity : float
        0: nothing is behind them, and the picture gets an alpha channel.
    """

    colour: tuple[float, float, float] = (1.0, 1.0, 1.0)
    opacity: float = 1.0

    @property
    def ink(self) -> float:
        """The grey that is read best on it."""
        return _DARK if self.opacity == 0 or np.dot(self.colour, _LUMINANCE) > 0.4 else _LIGHT


@dataclass(frozen=True)
class Panel:
    """A view with what belongs to it.

    Attributes
    ----------
    view : ndarray of float32, shape (H, W, 4)
        Linear light times opacity, and opacity.
    label : str
        Stands above it; nothing if empty.
    details : sequence of ndarray of float32, shape (h, w, 4)
        Stand below it.
    windows : sequence of Window
        Where in the view the details are.
    """

    view: NDArray[np.float32]
    label: str = ""
    details: Sequence[NDArray[np.float32]] = ()
    windows: Sequence[Window] = ()


def is_lost_on_white(views: Sequence[NDArray[np.float32]]) -> bool:
    """Tell whether more than a quarter of the outlines of what is drawn would be lost on white.

    Parameters
    ----------
    views : sequence of ndarray of float32, shape (H, W, 4)
        Linear light times opacity, and opacity.
    """
    from scipy.ndimage import binary_erosion

    outline, white = 0, 0
    for view in views:
        shown = view[..., 3] > 0.5
        drawn = view[shown & ~binary_erosion(shown, border_value=1)]
        outline += len(drawn)
        white += int(np.count_nonzero((drawn[:, :3] >= _NEARLY_WHITE * drawn[:, 3:]).all(axis=1)))
    return white > _LOST * outline


def arranged(panels: Sequence[Panel | None], columns: int, background: Background) -> NDArray[np.uint8]:
    """Put panels of one size into rows and columns.

    Parameters
    ----------
    panels : sequence of Panel or None
        Row by row; the first is one, None: an empty place.
    columns : int
        How many stand side by side.
    background : Background
        Of everything.

    Returns
    -------
    ndarray of uint8, shape (H, W, 3), or (H, W, 4) on no background
        sRGB, and opacity.
    """
    present = [panel for panel in panels if panel is not None]
    width = present[0].view.shape[1]
    gap = max(2, width // 80)
    labelled = any(panel.label for panel in present)
    pictures = [_panel(panel, gap, background, labelled=labelled) for panel in present]
    blank = _blank(pictures[0].shape[0], width, background)
    remaining = iter(pictures)
    drawn = [blank if panel is None else next(remaining) for panel in panels]
    rows = []
    for first in range(0, len(drawn), columns):
        row = drawn[first : first + columns]
        row += [blank] * (min(columns, len(drawn)) - len(row))
        rows.append(_joined(row, gap, background, axis=1))
    sheet = _joined(rows, gap, background, axis=0)
    return np.rint(255 * np.clip(sheet if background.opacity == 0 else sheet[..., :3], 0, 1)).astype(np.uint8)


def detail_size(width: int, count: int) -> int:
    """Return the side in pixels of details that stand below a view of a width."""
    return int((width - (count - 1) * max(2, width // 80)) // max(count, 2))


def _panel(panel: Panel, gap: int, background: Background, *, labelled: bool) -> NDArray[np.float64]:
    view = displayed(panel.view, background)
    height, width = view.shape[:2]
    thickness = max(2, width // 250)
    parts = []
    if labelled:
        letters = max(11, round(min(width, 900) / 26))
        strip = _blank(round(1.8 * letters), width, background)
        if panel.label:
            cover = lettering(panel.label, (width, len(strip)), letters)[..., None]
            strip = strip * (1 - cover) + np.array([background.ink] * 3 + [1.0]) * cover
        parts.append(strip)
    for number, window in enumerate(panel.windows):
        left, right = (round(window[k] * width) for k in (0, 2))
        upper, lower = (round(window[k] * height) for k in (1, 3))
        _frame(view, (upper, lower, left, right), thickness, number)
    parts.append(view)
    if panel.details:
        details = []
        for number, detail in enumerate(panel.details):
            shown = displayed(detail, background)
            _frame(shown, (0, shown.shape[0], 0, shown.shape[1]), thickness, number)
            details.append(shown)
        row = _joined(details, gap, background, axis=1)
        rest = width - row.shape[1]
        sides = [_blank(len(row), part, background) for part in (rest // 2, rest - rest // 2)]
        parts += [_blank(gap, width, background), np.concatenate([sides[0], row, sides[1]], axis=1)]
    return np.concatenate(parts)


def displayed(view: NDArray[np.float32], background: Background) -> NDArray[np.float64]:
    """Return a view in front of a background as display values with opacity, shape (H, W, 4)."""
    light, opacity = view[..., :3].astype(np.float64), view[..., 3:].astype(np.float64)
    if background.opacity == 0:
        light = np.divide(light, opacity, out=np.zeros_like(light), where=opacity > 0)
        return np.concatenate([linear_to_srgb(np.clip(light, 0, 1)), opacity], axis=2)
    # Halves of pixels are mixed with the background as the eye does, in light.
    behind = _to_light(background)
    mixed = linear_to_srgb(np.clip(light + (1 - opacity) * behind, 0, 1))
    return np.concatenate([mixed, np.ones_like(opacity)], axis=2)


def _to_light(background: Background) -> NDArray[np.float64]:
    from beltrami_cli.surface.colour_values import srgb_to_linear

    return np.asarray(srgb_to_linear(np.array(background.colour)), np.float64)


def _blank(height: int, width: int, background: Background) -> NDArray[np.float64]:
    return np.tile(np.array([*background.colour, background.opacity]), (height, width, 1))


def _joined(
    parts: Sequence[NDArray[np.float64]], gap: int, background: Background, axis: int
) -> NDArray[np.float64]:
    """Put parts next to each other, with gaps between them."""
    height, width = parts[0].shape[:2]
    between = _blank(gap, width, background) if axis == 0 else _blank(height, gap, background)
    pieces = [piece for part in parts for piece in (between, part)]
    return np.concatenate(pieces[1:], axis=axis)


def _frame(picture: NDArray[np.float64], box: tuple[int, int, int, int], thickness: int, number: int) -> None:
    """Draw the border of a box inside it, in place."""
    upper, lower, left, right = box
    part = picture[max(upper, 0) : lower, max(left, 0) : right]
    inner = part[thickness:-thickness, thickness:-thickness].copy()
    part[..., :3], part[..., 3] = _FRAMES[number % len(_FRAMES)], 1
    part[thickness:-thickness, thickness:-thickness] = inner
