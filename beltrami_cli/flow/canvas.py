"""A canvas with all that the flow knows of it, and one iteration of the kernel on cells side by side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from beltrami_cli.flow.regularisation import guide_radius

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from beltrami_cli.flow.cell_fields import CellFields
    from beltrami_cli.flow.grid_metric import GridMetric
    from beltrami_cli.flow.parameters import KernelParameters
    from beltrami_cli.surface.atlas import Atlas

# The paper's scheme looks for the support of an obtuse quadrant so many cells away.
_FURTHEST_SUPPORT = 10

# The widest window that the sweeps are made for; a wider one is looked through by a heap march.
_WIDEST_SWEEP = 15


@dataclass(frozen=True)
class Canvas:
    """A canvas as the flow has it.

    Attributes
    ----------
    atlas : Atlas
        With R x C cells, T of them owned, which are the samples.
    cells : CellFields
        Of the whole canvas.
    metric : GridMetric
        Of the whole canvas.
    channels : int
        How many of the values are colours, which the metric is made of.
    parameters : KernelParameters
        What to run with.
    """

    atlas: Atlas
    cells: CellFields
    metric: GridMetric
    channels: int
    parameters: KernelParameters

    @property
    def margin(self) -> int:
        """How many cells around a cell its result in one iteration depends on."""
        parameters = self.parameters
        support = _FURTHEST_SUPPORT if scheme_of(parameters) == "metric" else 0
        blurred = guide_radius(parameters.metric_scale) if parameters.metric_steps else 0
        return parameters.window // 2 + 1 + support + blurred


def scheme_of(parameters: KernelParameters) -> str:
    """Return what the compiled core calls the way to take distances."""
    if parameters.scheme == "metric":
        return "metric"
    return "sweep" if parameters.window <= _WIDEST_SWEEP else "triangles"


def apply_kernel(
    kind: NDArray[np.uint8],
    squared_lengths: NDArray[np.float32],
    cells: CellFields,
    metric: tuple[NDArray[np.float32], float],
    planes: NDArray[np.float32],
    parameters: KernelParameters,
    threads: int,
    progress: Callable[[int], None] | None = None,
) -> tuple[NDArray[np.float32], int]:
    """Average the planes of some cells side by side by their kernels, eq. (9).

    Parameters
    ----------
    kind : ndarray of uint8, shape (R', C')
        EMPTY, OWNED or HALO, as in `Atlas`.
    squared_lengths : ndarray of float32, shape (4, R', C')
        As in `Atlas`.
    cells : CellFields
        Of these cells.
    metric : (ndarray of float32, float)
        Planes that distances are taken from, and their beta.
    planes : ndarray of float32, shape (N, R', C')
        What is averaged.
    parameters : KernelParameters
        What to run with.
    threads : int
        The result does not depend on it.
    progress : callable, optional
        Called with the cells done so far; may raise to stop.

    Returns
    -------
    smoothed : ndarray of float32, shape (N, R', C')
        With new values in OWNED cells.
    held : int
        Samples that all kernels held together.
    """
    from beltrami_cli._native import smooth_grid

    distances, beta = metric
    return smooth_grid(
        kind, squared_lengths, cells.scale, cells.repeats, distances, planes, beta, parameters.t, parameters.radius,
        parameters.window // 2, scheme_of(parameters), 0, threads, progress,
    )  # fmt: skip
