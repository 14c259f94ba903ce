"""Parameters that are chosen from the colours on a canvas."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

from beltrami_cli.flow.canvas import apply_kernel
from beltrami_cli.flow.choice import ON_GRIDS, Choice, choose, is_noisy
from beltrami_cli.flow.regularisation import guide_radius
from beltrami_cli.flow.rule import RULE_ON_GRIDS, choose_by_rule
from beltrami_cli.flow.trial_grid import GridTrial
from beltrami_cli.surface.atlas import refresh_halo

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from beltrami_cli.flow.canvas import Canvas
    from beltrami_cli.flow.cell_fields import CellFields
    from beltrami_cli.flow.parameters import KernelParameters
    from beltrami_cli.surface.atlas import Atlas

# Cells on which parameters are tried, as a share of all, so that trying takes no longer than smoothing: some sixty
# iterations are tried, each twice. Fewer than so many cells tell too little, and take about a second.
_SHARE_TRIED = 1 / 25
_LEAST_TRIED = 40_000
# More tell nothing new: of so many the risk is known to a tenth of a dB or better.
_MOST_TRIED = 100_000

# Of noise in common less is told than there is: by low quantiles, and as if it were Gaussian, though coarse steps leave
# it as a few large details, which kernels keep as if they were edges. So smoothness counts more. Enlarged pictures gain
# 0.9 dB by that, and what JPEG left 0.5 dB.
_IN_COMMON = 1.5


def choose_on_canvas(
    canvas: Canvas,
    planes: NDArray[np.float32],
    sigma: NDArray[np.float64],
    unit: float,
    octaves: NDArray[np.float64] | None,
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
    octaves : ndarray of float64, shape (L, N, N), or None
        The noise that neighbouring cells have in common, see `noise_in_common`; None: it is independent.

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
    if wanted.fast:
        return choose_by_rule(canvas.metric.counting, unit, canvas.metric.beta, wanted, RULE_ON_GRIDS)

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
    trial = GridTrial(atlas, planes, canvas.cells, canvas.metric, iterate, budget, reach, octaves)
    parameters, choice = choose(
        trial, trial.samples, sigma, canvas.metric.counting, unit, canvas.metric.beta, wanted, ON_GRIDS,
        smoothness=1.0 if octaves is None else _IN_COMMON,
    )  # fmt: skip
    return parameters, dataclasses.replace(choice, correlated=octaves is not None)
