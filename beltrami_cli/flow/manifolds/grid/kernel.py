"""The kernel on a grid, by the compiled core: averages of all cells, and distances within the window of one cell."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from beltrami_cli._native import FURTHEST_SUPPORT, grid_distances, smooth_grid
from beltrami_cli.arrays import Float32s
from beltrami_cli.flow.manifolds.grid.geometry import GridGeometry
from beltrami_cli.flow.manifolds.metric_channels import MetricChannels
from beltrami_cli.flow.parameters import KernelParameters

# Widest window that the sweeps support; wider windows use fast marching with a heap.
_WIDEST_SWEEP = 15


def average_planes(
    grid: GridGeometry, parameters: KernelParameters, channels: MetricChannels, planes: Sequence[Float32s],
    progress: Callable[[int], None] | None,
) -> tuple[Float32s, int]:  # fmt: skip
    """Average planes in one pass; return also the number of samples in all kernels."""
    return smooth_grid(
        grid.atlas.kind, grid.atlas.squared_lengths, grid.scale, grid.repeats, channels.stack, planes, channels.beta,
        parameters.t, parameters.radius, parameters.window // 2, _scheme_of(parameters),
        parameters.thread_count, progress,
    )  # fmt: skip


def distances_in_window(
    grid: GridGeometry, parameters: KernelParameters, channels: MetricChannels, centre: tuple[int, int]
) -> Float32s:
    """Measure distances from a cell to those in its window, infinite beyond the kernel's radius."""
    reach = parameters.window // 2
    # Include supports, and the neighbours that determine the metric and its scale. Stencils of a whole canvas take
    # long.
    around = reach + FURTHEST_SUPPORT + 2
    top, left = (max(0, place - around) for place in centre)
    part = np.s_[..., top : centre[0] + around + 1, left : centre[1] + around + 1]
    kind = np.ascontiguousarray(grid.atlas.kind[part])
    return grid_distances(
        kind, np.ascontiguousarray(grid.atlas.squared_lengths[part]),
        None if grid.scale is None else np.ascontiguousarray(grid.scale[part]),
        np.ascontiguousarray(channels.stack[part]), channels.beta, parameters.radius, reach, _scheme_of(parameters),
        (centre[0] - top) * kind.shape[1] + centre[1] - left,
    )  # fmt: skip


def _scheme_of(parameters: KernelParameters) -> str:
    if parameters.scheme == "metric":
        return "metric"
    return "sweep" if parameters.window <= _WIDEST_SWEEP else "triangles"
