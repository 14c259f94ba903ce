"""How far around a cell smoothing reads."""

from __future__ import annotations

from beltrami_cli._native import FURTHEST_SUPPORT, PATCH_REACH
from beltrami_cli.flow.manifolds.grid.gaussian import gaussian_reach
from beltrami_cli.flow.parameters import KernelParameters


def canvas_margin(parameters: KernelParameters) -> int:
    """Return the number of cells beyond a chart that kernels and patches read."""
    of_kernel = parameters.window // 2 + _metric_reach(parameters)
    return max(of_kernel, PATCH_REACH if parameters.takes_patches else 0)


def kernel_margin(parameters: KernelParameters) -> int:
    """Return the number of cells to each side of a cell that influence its average in one iteration."""
    support = FURTHEST_SUPPORT if parameters.scheme == "metric" else 0
    return parameters.window // 2 + 1 + support + _metric_reach(parameters)


def _metric_reach(parameters: KernelParameters) -> int:
    """Reach of the Gaussian of the regularised metric."""
    return gaussian_reach(parameters.metric_scale) if parameters.metric_steps else 0
