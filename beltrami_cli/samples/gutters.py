"""Which texels around charts continue the charts beside them, and which show something else and keep their colours."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int64s
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import Indices

# A step between two texels has the noise of both; beyond this many deviations of what smoothing took away it is real.
_REAL_STEP = 3.0
# The neighbours of a texel, row and column, in the order in which `fill_gutter` takes their colours.
_AROUND = ((0, -1), (-1, 0), (1, 0), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1))


@dataclass(frozen=True)
class Refilled:
    """A picture whose charts are repainted, and continued beyond seams, but not yet filled around them."""

    old: Array  # its pixels as they were, shape (H, W, C)
    new: Array  # and as they are now
    covered: Bools  # (H, W)
    known: Bools  # (H, W): texels around charts whose colours stay as they are now
    shown: Callable[[Array], Float32s]  # colours, shape (K, N), of pixels, shape (K, C)

    def before(self, texels: Indices) -> Float32s:
        return self.shown(_rows(self.old)[texels])

    def after(self, texels: Indices) -> Float32s:
        return self.shown(_rows(self.new)[texels])

    def restore(self, texels: Indices) -> None:
        """Give texels, in place, the colours that they had, which they keep."""
        _rows(self.new)[texels] = _rows(self.old)[texels]
        self.known.reshape(-1)[texels] = True


def keep_others(refilled: Refilled, border: Indices, lone: Indices) -> None:
    """Let texels that faces look up, but that do not continue the chart beside them, keep their colours, in place.

    A texel continues its chart if the step to the covered texel beside it was, but for noise, what it is now; or if
    there was none, and then it is left to be filled from there. Others are painted otherwise: the edge of a colour that
    lies on the chart's border, or of another chart. Of lone texels it is not known which part of the surface they show.
    """
    refilled.restore(lone)
    beside = _covered_beside(refilled.covered, border)
    border, beside = border[beside >= 0], beside[beside >= 0]
    limit = _REAL_STEP * _taken_away(refilled, beside)
    for block in large_arrays.blocks(len(border), large_arrays.SCATTERED):
        texels, nearest = border[block], beside[block]
        step = refilled.before(texels) - refilled.before(nearest)
        now = refilled.after(texels) - refilled.after(nearest)
        has_halo = refilled.known.reshape(-1)[texels]
        continues = has_halo & (_size(step - now) <= limit)
        is_alike = _size(step) <= limit
        refilled.known.reshape(-1)[texels[~continues & is_alike]] = False
        refilled.restore(texels[~continues & ~is_alike])


def _rows(pixels: Array) -> Array:
    return pixels.reshape(-1, pixels.shape[2])


def _covered_beside(covered: Bools, texels: Indices) -> Int64s:
    """Return a covered neighbour of each texel, the nearest; -1 where there is none."""
    height, width = covered.shape
    rows, columns = np.divmod(texels, width)
    found = np.full(len(texels), -1, np.int64)
    for down, right in _AROUND:
        row, column = rows + down, columns + right
        inside = (found < 0) & (row >= 0) & (row < height) & (column >= 0) & (column < width)
        inside[inside] = covered[row[inside], column[inside]]
        found[inside] = row[inside] * np.int64(width) + column[inside]
    return found


def _taken_away(refilled: Refilled, texels: Indices) -> float:
    """Return the root mean square by which texels changed."""
    total = 0.0
    for block in large_arrays.blocks(len(texels), large_arrays.SCATTERED):
        change = refilled.after(texels[block]) - refilled.before(texels[block])
        total += float(np.square(_size(change)).sum())
    return float(np.sqrt(total / max(1, len(texels))))


def _size(differences: Float32s) -> Float64s:
    """Return the root mean square over the channels."""
    return np.asarray(np.sqrt(np.square(differences, dtype=np.float64).mean(axis=1)))
