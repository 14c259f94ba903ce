"""Hues at the borders of charts, where JPEG mixed them with colours beyond, continued from further inside.

A decoder interpolates halved colour, so that a texel up to two texels from a border has some of the colour beyond it,
which may be of another exposure. Brightness is stored for each texel, and stays as it is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s, Int32s, Int64s
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import OWNED, ROWS, Atlas, within

_MIXED = 2  # texels from a border
# Places around a cell at which colours are looked at, and of how many of these they must not be mixed.
_AROUND = np.mgrid[-5:6, -5:6].reshape(2, -1).T
_FEWEST = 6
# By so much of the spread of these places slopes are drawn to 0, as they are least known where most is beyond a border.
_DRAWN = 0.005
_BLOCK = 1 << 16
LUMA = np.array([0.299, 0.587, 0.114])  # of BT.601, as JPEG has it


def mixed_cells(atlas: Atlas, halved: Sequence[bool]) -> Int64s:
    """Return the owned cells, as flat indices, near borders of charts in textures with halved colour."""
    found, (rows, columns) = [np.zeros(0, np.int64)], atlas.kind.shape
    for band in large_arrays.blocks(rows, ROWS):
        first = max(0, band.start - _MIXED)
        owned = atlas.kind[first : band.stop + _MIXED] == OWNED
        near = owned & within(~owned, _MIXED)
        inside = near[band.start - first :][: band.stop - band.start]
        found.append(np.flatnonzero(inside) + band.start * columns)
    cells = np.concatenate(found)
    texels = atlas.owned_texels[np.searchsorted(atlas.owned_cells, cells)]
    texture = np.searchsorted(atlas.texture_offsets, texels, side="right") - 1
    return np.asarray(cells[np.asarray(halved)[texture]])


def continue_hues(atlas: Atlas, planes: Float32s, cells: Int64s, limits: tuple[float, float]) -> Float32s:
    """Give the mixed cells of red, green and blue the hue that those behind them lead to; return what they had."""
    flat = planes.reshape(len(planes), -1)
    before = flat[:, cells]
    # The chart, counted from 1, of each cell that is not mixed.
    clear = large_arrays.zeros(flat.shape[1], np.int32)
    for block in large_arrays.blocks(len(atlas.owned_cells), large_arrays.SCATTERED):
        clear[atlas.owned_cells[block]] = atlas.chart_of[block] + 1
    charts = clear[cells]
    clear[cells] = 0
    for begin in range(0, len(cells), _BLOCK):
        block = slice(begin, begin + _BLOCK)
        colours, is_known = _continued(flat, clear, cells[block], charts[block], atlas.kind.shape[1])
        own = before[:, block].T
        hued = (colours + ((own - colours) @ LUMA)[:, None]).clip(*limits)
        flat[:, cells[block]] = np.where(is_known[:, None], hued, own).T
    return before


def _continued(
    flat: Float32s, clear: Int32s, cells: Int64s, charts: Int32s, columns: int
) -> tuple[Float64s, Bools]:
    """Return the colours at cells of planes through those around that are not mixed, and whether there are enough."""
    moments = np.zeros((len(cells), 3, 3))
    products = np.zeros((len(cells), 3, len(flat)))
    for down, right in _AROUND.tolist():
        at = (cells + down * columns + right).clip(0, flat.shape[1] - 1)
        rows = np.flatnonzero(clear[at] == charts)
        place = np.array([1.0, down, right])
        moments[rows] += np.outer(place, place)
        products[rows] += place[:, None] * flat[:, at[rows]].T[:, None]
    is_known = moments[:, 0, 0] >= _FEWEST
    drawn = _DRAWN * (moments[:, 1, 1] + moments[:, 2, 2])
    for axis in (1, 2):
        moments[:, axis, axis] += drawn
    moments[~is_known] = np.eye(3)
    return np.asarray(np.linalg.solve(moments, products)[:, 0], np.float64), is_known
