"""Parameters that are chosen from the colours on a canvas."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.canvas import apply_kernel
from beltrami_cli.flow.choice import ON_GRIDS, Choice, choose, is_noisy
from beltrami_cli.flow.correlation import is_correlated_on_grid
from beltrami_cli.flow.regularisation import guide_radius
from beltrami_cli.flow.rule import RULE_ON_GRIDS, choose_by_rule
from beltrami_cli.flow.trial_grid import GridTrial
from beltrami_cli.mesh.atlas import OWNED, refresh_halo

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.flow.canvas import Canvas
    from beltrami_cli.flow.cell_fields import CellFields
    from beltrami_cli.flow.parameters import KernelParameters
    from beltrami_cli.mesh.atlas import Atlas

# Cells on which parameters are tried, as a share of all, so that trying takes no longer than smoothing: some sixty
# iterations are tried, each twice. Fewer than so many cells tell too little, and take about a second.
_SHARE_TRIED = 1 / 25
_LEAST_TRIED = 40_000
# More tell nothing new: of so many the risk is known to some hundredths of a dB.
_MOST_TRIED = 500_000

# Rows in which correlated noise is looked for, in so many bands.
_ROWS, _BANDS = 64, 32


def choose_on_canvas(
    canvas: Canvas, planes: NDArray[np.float32], sigma: NDArray[np.float64], unit: float
) -> tuple[KernelParameters, Choice | None]:
    """Choose the free parameters; without noise they stay as they are, and nothing is smoothed.

    Parameters
    ----------
    canvas : Canvas
        With parameters of which some are free.
    planes : ndarray of float32, shape (N, R, C)
        Colours, halo included.
    sigma : ndarray of float64, shape (N,)
        Estimated noise per channel.
    unit : float
        The texel pitch in units of length.

    Returns
    -------
    parameters : KernelParameters
        With nothing free.
    choice : Choice or None
        What was chosen; None: nothing.
    """
    wanted, atlas = canvas.parameters, canvas.atlas
    if not (is_noisy(sigma) and len(atlas.owned_cells)):
        parameters = dataclasses.replace(wanted, free=())
        if "iterations" in wanted.free:
            parameters = dataclasses.replace(parameters, iterations=0)
        return parameters, None
    rows = _some_rows(len(atlas.kind))
    correlated = not wanted.fast and is_correlated_on_grid(planes[:, rows], atlas.kind[rows] == OWNED)
    if wanted.fast or correlated:
        metric = canvas.metric
        return choose_by_rule(
            metric.counting, unit, metric.beta, wanted, RULE_ON_GRIDS, correlated=correlated
        )

    def iterate(
        atlas: Atlas, cells: CellFields, metric: tuple[NDArray[np.float32], float], planes: NDArray[np.float32],
        t: float,
    ) -> NDArray[np.float32]:  # fmt: skip
        parameters = dataclasses.replace(wanted, free=(), t=t)
        smoothed, _ = apply_kernel(
            atlas.kind, atlas.squared_lengths, cells, metric, planes, parameters, parameters.thread_count
        )
        refresh_halo(smoothed, atlas)
        return smoothed

    budget = min(max(_LEAST_TRIED, int(len(atlas.owned_cells) * _SHARE_TRIED)), _MOST_TRIED)
    reach = wanted.window // 2 + guide_radius(wanted.metric_scale)
    trial = GridTrial(atlas, planes, canvas.cells, canvas.metric, iterate, budget, reach)
    return choose(
        trial, trial.samples, sigma, canvas.metric.counting, unit, canvas.metric.beta, wanted, ON_GRIDS
    )


def _some_rows(count: int) -> slice | NDArray[np.intp]:
    """Choose bands of rows, evenly spread; all rows if there are not many."""
    if count <= _ROWS * _BANDS:
        return slice(None)
    first = np.linspace(0, count - _ROWS, _BANDS).astype(int)
    return (first[:, None] + np.arange(_ROWS)).reshape(-1)
