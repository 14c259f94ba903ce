"""Hues at the borders of charts, extrapolated from further inside.

JPEG mixes hues at the borders of charts with colours beyond: a decoder interpolates subsampled chroma, so that texels
near a border contain some of the colour beyond it, which may have another exposure. Such hues are extrapolated from
further inside the chart. Brightness is stored for each texel, and is not extrapolated.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s, Int32s, Int64s
from beltrami_cli.levelling.steps import RIDGE
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import OWNED, Atlas
from beltrami_cli.surface.colour_values import limits_of
from beltrami_cli.surface.gutters import within

LUMA = np.array([0.299, 0.587, 0.114])  # of BT.601, as JPEG has it


def mixed_cells(atlas: Atlas, spans: Sequence[int]) -> Int64s:
    """Return the owned cells (flat indices) so close to a border of a chart that a decoder mixed their hue."""
    parts, (rows, columns), reach = [np.zeros(0, np.int64)], atlas.kind.shape, max(spans)
    for band in large_arrays.blocks(rows, large_arrays.ROWS):
        first = max(0, band.start - reach)
        owned = atlas.kind[first : band.stop + reach] == OWNED
        near = owned & within(~owned, reach)
        inside = near[band.start - first :][: band.stop - band.start]
        parts.append(np.flatnonzero(inside) + band.start * columns)
    cells = np.concatenate(parts)
    texels = atlas.owned_texels[np.searchsorted(atlas.owned_cells, cells)]
    texture = atlas.texture_of(texels)
    return np.asarray(cells[np.asarray(spans)[texture] > 1])


def continue_hues_in_place(atlas: Atlas, planes: Float32s, cells: Int64s, span: int) -> Float32s:
    """Replace the hue of mixed cells by that extrapolated from the cells behind; return the old colours."""
    flat, limits = planes.reshape(len(planes), -1), limits_of(planes)
    before = flat[:, cells]
    # The chart of each cell that is not mixed, counted from 1.
    clear = large_arrays.zeros(flat.shape[1], np.int32)
    for block in large_arrays.blocks(len(atlas.owned_cells), large_arrays.SCATTERED):
        clear[atlas.owned_cells[block]] = atlas.chart_of[block] + 1
    charts = clear[cells]
    clear[cells] = 0
    for block in large_arrays.blocks(len(cells), large_arrays.CACHED):
        colours, is_known = _continued(flat, clear, cells[block], charts[block], atlas.kind.shape[1], span)
        stored = before[:, block].T
        hued = (colours + ((stored - colours) @ LUMA)[:, None]).clip(*limits)
        flat[:, cells[block]] = np.where(is_known[:, None], hued, stored).T
    return before


def _continued(
    flat: Float32s, clear: Int32s, cells: Int64s, charts: Int32s, columns: int, span: int
) -> tuple[Float64s, Bools]:
    """Extrapolate colours to cells by linear regression on nearby unmixed cells; return also where these suffice."""
    moments = np.zeros((len(cells), 3, 3))
    products = np.zeros((len(cells), 3, len(flat)))
    reach = 2 * span + 1  # twice the width of mixed colours
    for down, right in np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1).T.tolist():
        at = (cells + down * columns + right).clip(0, flat.shape[1] - 1)
        rows = np.flatnonzero(clear[at] == charts)
        place = np.array([1.0, down, right])
        moments[rows] += np.outer(place, place)
        products[rows] += place[:, None] * flat[:, at[rows]].T[:, None]
    is_known = moments[:, 0, 0] >= 2 * len(place)  # cells for each unknown of the regression
    drawn = RIDGE * (moments[:, 1, 1] + moments[:, 2, 2])
    for axis in (1, 2):
        moments[:, axis, axis] += drawn
    moments[~is_known] = np.eye(3)
    return np.asarray(np.linalg.solve(moments, products)[:, 0], np.float64), is_known
