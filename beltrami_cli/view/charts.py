"""Drawings for a report: where and how much colours changed."""

from __future__ import annotations

import html
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.jobs.colour_map import colour_by_value
from beltrami_cli.surface.colour_values import linear_to_srgb
from beltrami_cli.view.camera import pixels_of
from beltrami_cli.view.drawing import richest_window
from beltrami_cli.view.pages import data_address, picture_tag

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from beltrami_cli.jobs.compare.figures import ComparedColours

_CROP = 384  # pixels a side
_LONGEST = 768  # pixels, of a seam map
_WIDTH, _HEIGHT = 720, 220
_INK = {3: ("#d62728", "#2ca02c", "#1f77b4"), 1: ("#888888",)}
_STEPS = 64
_FEW = 4.0  # 255ths; larger changes are counted in bins of whole numbers
_WHITE = 1.0


def histogram(pairs: Sequence[ComparedColours]) -> str:
    """Return a drawing of how often channels changed by how much, in steps of 1/255."""
    widest = max(pair.test.shape[1] for pair in pairs)
    changes = [
        pair.test.astype(np.float64) - pair.reference for pair in pairs if pair.test.shape[1] == widest
    ]
    change = 255 * np.concatenate(changes)
    bins, reach = _bins(change)
    inside = np.clip(change, -reach, reach)
    counts = [np.histogram(channel, bins, (-reach, reach))[0] for channel in inside.T]
    most = max(1, max(int(count.max()) for count in counts))
    lines = []
    for count, ink in zip(counts, _INK.get(widest, ("currentColor",) * widest), strict=True):
        corners = zip(_WIDTH * (np.arange(bins) + 0.5) / bins, _HEIGHT * (1 - count / most), strict=True)
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
        lines.append(f'<polyline fill="none" stroke="{ink}" stroke-width="1.5" points="{points}"/>')
    marks = []
    for share, anchor in ((-1, "start"), (-0.5, "middle"), (0, "middle"), (0.5, "middle"), (1, "end")):
        at = f'x="{_WIDTH * (0.5 + 0.5 * share):.0f}" y="{_HEIGHT + 14}" text-anchor="{anchor}"'
        marks.append(f"<text {at}>{share * reach:+.1f}</text>")
    axis = f'<line x1="0" x2="{_WIDTH}" y1="{_HEIGHT}" y2="{_HEIGHT}" stroke="currentColor"/>'
    body = "\n".join([*lines, axis, *marks])
    return (
        f'<svg width="{_WIDTH}" height="{_HEIGHT + 20}" viewBox="0 0 {_WIDTH} {_HEIGHT + 20}" role="img" '
        f'aria-label="histogram of the change">\n{body}\n</svg>\n<p>After minus before, in 255ths of full scale.</p>'
    )


def _bins(change: NDArray[np.float64]) -> tuple[int, float]:
    """Return the number of bins of a histogram of changes in 255ths, and its largest change."""
    wanted = max(1.0, float(np.percentile(np.abs(change), 99.5))) if change.size else 1.0
    step = -(-2 * wanted // _STEPS) // 2 * 2 + 1 if wanted > _FEW else 2 * wanted / _STEPS
    bins = 2 * int(wanted // step) + 1
    return bins, step * bins / 2


def seam_map(pair: ComparedColours) -> str:
    """Return a picture of how much a texture, `size` = (rows, columns), changed near its seams; empty without seams."""
    if pair.size is None or pair.near_seams is None or not pair.near_seams.any():
        return ""
    stride = max(1, -(-max(pair.size) // _LONGEST))
    small = tuple(-(-side // stride) for side in pair.size)
    amount = np.abs(pair.test.astype(np.float64) - pair.reference).max(axis=1)
    largest = max(float(amount[pair.near_seams].max()), 1 / 255)
    columns, rows = pair.index.T // stride
    values, covered = np.full(small, -1.0, np.float32), np.zeros(small, bool)
    covered[rows, columns] = True
    near = pair.near_seams
    np.maximum.at(values, (rows[near], columns[near]), (amount[near] / largest).astype(np.float32))
    shades = np.where(covered[..., None], 0.6, _WHITE) * np.ones((*small, 3))
    drawn = colour_by_value(np.maximum(values, 0), shades.astype(np.float32), values >= 0)
    tag = picture_tag(np.rint(255 * drawn).astype(np.uint8), f"seams of {pair.name}")
    caption = f"{html.escape(pair.name)}: brightest {255 * largest:.1f}/255"
    return f"<figure>{tag}<figcaption>{caption}</figcaption></figure>"


def swipe(before: NDArray[np.float32], after: NDArray[np.float32], name: str) -> str:
    """Return the part of two images, (H, W, 4), with most to see, at full size and one over the other."""
    height, width = after.shape[:2]
    seen = after.copy()
    seen[..., :3] *= seen[..., 3:]
    window = richest_window(seen, min(1.0, _CROP / min(height, width)))
    rows, columns = pixels_of(window, width, height)
    cut = [sheet[rows, columns] for sheet in (before, after)]
    sources = [
        data_address(np.rint(255 * np.asarray(linear_to_srgb(part[..., :3]))).astype(np.uint8))
        for part in cut
    ]
    shown_height, shown_width = cut[1].shape[:2]
    zoom = max(1, _CROP // max(1, shown_width))
    shape = f'width="{shown_width * zoom}" height="{shown_height * zoom}"'
    title = html.escape(name, quote=True)
    images = "".join(
        f'<img {shape} style="max-width:none" alt="{title}, {when}" src="{source}">'
        for when, source in zip(("before", "after"), sources, strict=True)
    )
    return (
        f'<figure><div class="swipe">{images}<span class="line"></span></div>'
        f'<input type="range" min="0" max="100" value="50" aria-label="swipe" style="width:{shown_width * zoom}px">'
        f"<figcaption>{title}: {shown_width} x {shown_height} pixels at {columns.start}, {rows.start}"
        "</figcaption></figure>"
    )
