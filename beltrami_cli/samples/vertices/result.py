"""Smoothed vertex colours, and how they came about."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from beltrami_cli.flow.tuning.choice import Choice


@dataclass(frozen=True)
class CloudCounts:
    """What was found between points without faces.

    Attributes
    ----------
    triangles : int
        Triangles around the points, each in the tangent plane.
    outliers : int
        Points in none of them, which keep their colours.
    """

    triangles: int
    outliers: int


@dataclass(frozen=True)
class SmoothResult:
    """Smoothed vertex colours, and how they came about.

    Attributes
    ----------
    colours : ndarray of float32, shape (V, C)
        In the same encoding and order as the input's. Vertices that did not change have the input's bits.
    beta : float
        As used, in units of length per unit of colour; 0 if no colour enters the metric.
    spacing : float
        Mean edge length, in the unit of the positions; 0 without edges.
    noise : dict of str to float
        Estimated standard deviation of the noise for each channel that takes part, in the working space.
    samples : int
        Distinct samples: coincident vertices of one colour are one.
    hard_edge_samples : int
        Samples more than there are places: coincident vertices that differ in colour.
    samples_per_kernel : float
        Mean number of samples that a kernel held.
    truncated : int
        Kernels that `max_samples` cut short, over all iterations.
    iterations : int
        How many were run.
    guide_betas : dict of str to float
        As used for each guide, in units of length per unit of the guide.
    positions : ndarray of float64, shape (V, 3), or None
        New positions, if they were smoothed. Vertices that did not move have the input's bits.
    normal_noise, normal_beta : float or None
        If positions were smoothed: the estimated noise of the normals in radians, and the beta used for them, in units
        of length per radian.
    cloud : CloudCounts or None
        For points without faces.
    choice : Choice or None
        Parameters that were chosen from the data, and their estimated error, if any were.
    """

    colours: NDArray[np.float32]
    beta: float
    spacing: float
    noise: dict[str, float]
    samples: int
    hard_edge_samples: int
    samples_per_kernel: float
    truncated: int
    iterations: int
    guide_betas: dict[str, float] = field(default_factory=dict)
    positions: NDArray[np.float64] | None = None
    normal_noise: float | None = None
    normal_beta: float | None = None
    cloud: CloudCounts | None = None
    choice: Choice | None = None
