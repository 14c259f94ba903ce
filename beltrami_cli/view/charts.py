"""Drawings for a report: where and how much colours changed."""

from __future__ import annotations

import html
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.surface.colour_values import colour_by_value
from beltrami_cli.view.pages import picture_tag

if TYPE_CHECKING:
    from collections.abc import Sequence

    from beltrami_cli.arrays import Float64s
    from beltrami_cli.jobs.compare.figures import ComparedColours

_LONGEST = 768  # pixels, of a seam map
_WIDTH, _HEIGHT = 720, 220
# Colours and dashes of the lines of channels: the dashes are for those who cannot distinguish the colours.
_INK = {3: ("var(--red)", "var(--green)", "var(--blue)")}
_DASHES = ("none", "8 4", "2 3")
_NAMES = {3: ("red", "green", "blue")}
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
    inks = _INK.get(widest, ("currentColor",) * widest)
    for number, (count, ink) in enumerate(zip(counts, inks, strict=True)):
        corners = zip(_WIDTH * (np.arange(bins) + 0.5) / bins, _HEIGHT * (1 - count / most), strict=True)
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
        look = f'fill="none" stroke="{ink}" stroke-width="1.5" stroke-dasharray="{_DASHES[number % 3]}"'
        lines.append(f'<polyline {look} points="{points}"/>')
        if widest in _NAMES:
            y = 14 * (number + 1)
            lines.append(f'<line {look} x1="8" x2="36" y1="{y - 4}" y2="{y - 4}"/>')
            lines.append(f'<text x="42" y="{y}">{_NAMES[widest][number]}</text>')
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


def _bins(change: Float64s) -> tuple[int, float]:
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
