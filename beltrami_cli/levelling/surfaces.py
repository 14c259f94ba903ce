"""Exposures of the charts of a canvas, and of the parts of a mesh that come from one photograph, taken out."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.levelling.charts import find_exposures
from beltrami_cli.levelling.correction import Correction
from beltrami_cli.levelling.mesh_steps import steps_over_edges
from beltrami_cli.levelling.steps import ChartPlaces, steps_over_seams
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import refresh_halo

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.levelling.charts import Levelled
    from beltrami_cli.surface.atlas import Atlas, Indices

_NOWHERE = np.zeros((0, 2))  # places, where they make no difference


def level_canvas(
    atlas: Atlas, planes: NDArray[np.float32], strength: float, fixed: NDArray[np.bool_] | None = None
) -> tuple[Levelled, float]:
    """Take exposures out of planes, shape (N, R, C), in place; return also the mean change, 0 if they stay."""
    places, columns = ChartPlaces.of(atlas), atlas.kind.shape[1]
    found = find_exposures(steps_over_seams(atlas, planes, places), strength, fixed)
    flat = planes.reshape(len(planes), -1)

    def samples(
        rows: NDArray[np.int64] | slice,
    ) -> tuple[NDArray[np.float32], Indices, NDArray[np.float64]]:
        cells, charts = atlas.owned_cells[rows], atlas.chart_of[rows]
        is_tilted = found.exposures is not None and found.exposures.is_tilted
        return flat[:, cells].T, charts, places.at(cells, charts, columns) if is_tilted else _NOWHERE

    change = 0.0
    if found.exposures is not None:
        correction = Correction(found, strength, fixed)
        change = correction.keep_means(len(atlas.owned_cells), samples)
        for block in large_arrays.blocks(len(atlas.owned_cells) if change else 0, large_arrays.SCATTERED):
            flat[:, atlas.owned_cells[block]] = correction.of(*samples(block)).T
    refresh_halo(planes, atlas)
    return found, change


def level_mesh(
    positions: NDArray[np.float64],
    faces: NDArray[np.int32],
    colours: NDArray[np.float32],
    photographs: NDArray[np.int64],
    strength: float,
) -> tuple[Levelled, float, NDArray[np.float32]]:
    """Take exposures out of the colours of vertices, shape (S, N), each of one photograph."""
    steps, charts, places = steps_over_edges(positions, faces, colours.astype(np.float64), photographs)
    found = find_exposures(steps, strength)
    if found.exposures is None:
        return found, 0.0, colours
    correction = Correction(found, strength)
    change = correction.keep_means(len(colours), lambda rows: (colours[rows], charts[rows], places[rows]))
    return found, change, correction.of(colours, charts, places) if change else colours
