"""Gutters: texels around charts, which bilinear lookups at their borders read."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from beltrami_cli._native import nearest_marked
from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Indices, Int64s
from beltrami_cli.surface import large_arrays


def fill_gutter(
    pixels: Array, covered: Bools, width: int | None, known: Bools | None = None,
    threads: int = 1, channels: Sequence[int] | None = None, opacity: Float32s | None = None,
) -> None:  # fmt: skip
    """Fill texels around charts, in place, with the colour of the nearest covered texel."""
    # `width`: maximum distance in texels; None: unlimited. `known`: uncovered texels that already have their colours,
    # as from beyond a seam, and are not filled. `opacity`: alpha by which colours are multiplied, replaced by that of
    # the new texel; not 0 where covered.
    table = pixels.reshape(-1, pixels.shape[2])
    visible = None if opacity is None else opacity.reshape(-1)
    for texels, nearest in nearest_covered(covered, width, known, threads):
        share = None if visible is None else visible[texels] / visible[nearest]
        for channel in range(pixels.shape[2]) if channels is None else channels:
            colours = table[nearest, channel]
            table[texels, channel] = colours if share is None else _scaled(colours, share)


def nearest_covered(
    covered: Bools, width: int | None, left_out: Bools | None = None, threads: int = 1
) -> Iterator[tuple[Int64s, Int64s]]:
    """Yield, band by band, uncovered texels and the nearest covered texel of each within the width."""
    reach = sum(covered.shape) if width is None else width
    for band in large_arrays.blocks(len(covered), max(large_arrays.ROWS, reach)):
        target = ~covered[band]
        if left_out is not None:
            target &= ~left_out[band]
        if not target.any():
            continue
        first, last = max(0, band.start - reach), band.stop + reach
        wanted = np.zeros(covered[first:last].shape, bool)
        wanted[band.start - first : band.stop - first] = target
        texels, nearest = nearest_marked(np.ascontiguousarray(covered[first:last]), wanted, reach, threads)
        offset = first * covered.shape[1]
        yield texels + offset, nearest + offset


def _scaled(colours: Array, share: Float32s) -> Array:
    scaled = colours * share
    if colours.dtype.kind != "f":
        scaled = np.minimum(np.rint(scaled), np.iinfo(colours.dtype).max)
    return scaled.astype(colours.dtype)


def within(covered: Bools, reach: int) -> Bools:
    """Return a mask of the cells at most `reach` rows and columns from a covered cell."""
    near, known = covered, 0
    while known < reach:
        # Dilate by shifted copies. The step is the largest that leaves no gap between them, also at the edges of the
        # canvas, where half of the neighbourhood is outside.
        step = min(known + 1, reach - known)
        for axis in (0, 1):
            ahead, behind = [slice(None), slice(None)], [slice(None), slice(None)]
            ahead[axis], behind[axis] = slice(step, None), slice(None, -step)
            grown = near.copy()
            grown[*ahead] |= near[*behind]
            grown[*behind] |= near[*ahead]
            near = grown
        known += step
    return near


# A step between two texels has the noise of both. It is real if it exceeds so many deviations of the removed noise.
_REAL_STEP = 3.0


def keep_foreign_texels(
    old: Array, new: Array, covered: Bools, known: Bools, shown: Callable[[Array], Float32s], *,
    width: int, lone: Indices, threads: int,
) -> None:  # fmt: skip
    """Restore the old colours of texels around charts that do not extend the adjacent chart, in place.

    A texel extends its chart if its old step to the nearest covered texel was, except for noise, the same as the new
    one, or if there was no step; it is then filled from that texel. Other texels are background, the border of a colour
    on the chart's border, or belong to another chart, material or model. Single texels of those may resemble the chart,
    so half of the uncovered texels around must extend it too. For `lone` texels it is unknown which part of the surface
    they show.

    `old`, `new`: pixels before and after, (H, W, C), which `shown` converts to colours. Texels that are `known`, (H,
    W), are not filled later.
    """
    rows, new_rows, is_known = old.reshape(covered.size, -1), new.reshape(covered.size, -1), known.reshape(-1)
    limit = _REAL_STEP * _rms_change_at_borders(rows, new_rows, covered, shown)
    candidates, continues = np.flatnonzero(is_known), np.zeros(covered.shape, bool)
    for texels, nearest in nearest_covered(covered, width + 1 if width else 0, threads=threads):
        for block in large_arrays.blocks(len(texels), large_arrays.CACHED):
            here, there = texels[block], nearest[block]
            step = shown(rows[here]) - shown(rows[there])
            is_halo = is_known[here]
            halo = here[is_halo]
            now = shown(new_rows[halo]) - shown(new_rows[there[is_halo]])
            follows = _rms_over_channels(step[is_halo] - now) <= limit
            is_known[halo] = follows
            has_no_step = _rms_over_channels(step) <= limit
            has_no_step[is_halo] |= follows
            continues.reshape(-1)[here] = has_no_step
    continues &= _is_half(continues, ~covered)
    continues.reshape(-1)[lone] = False
    stays = ~(continues | covered)
    restored = candidates[stays.reshape(-1)[candidates]]
    new_rows[restored] = rows[restored]
    known[stays] = True


def _is_half(marked: Bools, counted: Bools) -> Bools:
    """Return where at least half of the counted texels in a 3 x 3 window are marked, including the centre."""
    is_half = np.empty(marked.shape, bool)
    for rows in large_arrays.blocks(len(marked), large_arrays.ROWS):
        first = max(0, rows.start - 1)
        # Sums of slices: importing the filters of SciPy takes longer than smoothing a small texture.
        balance = np.pad(
            2 * marked[first : rows.stop + 1].astype(np.int8) - counted[first : rows.stop + 1], 1
        )
        balance = balance[:-2] + balance[1:-1] + balance[2:]
        balance = balance[:, :-2] + balance[:, 1:-1] + balance[:, 2:]
        is_half[rows] = balance[rows.start - first :][: rows.stop - rows.start] >= 0
    return is_half


def _rms_change_at_borders(
    old: Array, new: Array, covered: Bools, shown: Callable[[Array], Float32s]
) -> float:
    edge = np.flatnonzero(covered & within(~covered, 1))
    total = 0.0
    for block in large_arrays.blocks(len(edge), large_arrays.CACHED):
        change = shown(new[edge[block]]) - shown(old[edge[block]])
        total += float(np.square(_rms_over_channels(change)).sum())
    return float(np.sqrt(total / max(1, len(edge))))


def _rms_over_channels(differences: Float32s) -> Float64s:
    return np.asarray(np.sqrt(np.square(differences, dtype=np.float64).mean(axis=1)))
