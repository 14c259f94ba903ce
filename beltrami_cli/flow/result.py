"""What comes out of a flow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from beltrami_cli.flow.choice import Choice


@dataclass(frozen=True)
class FlowResult:
    """How smoothed samples came about.

    Attributes
    ----------
    spacing : float
        Mean sample spacing, in the surface's own unit of length; 0 where samples have no neighbours.
    beta : float
        As used, in units of length per unit of colour.
    sigma : ndarray of float64, shape (N,)
        Estimated noise of the input.
    samples_per_kernel : float
        Mean over samples and iterations; 0 without iterations.
    choice : Choice or None
        Parameters that were chosen from the data, if any were.
    """

    spacing: float
    beta: float
    sigma: NDArray[np.float64]
    samples_per_kernel: float
    choice: Choice | None


@dataclass(frozen=True)
class VertexFlowResult(FlowResult):
    """Smoothed vertices, too.

    Attributes
    ----------
    colours : ndarray of float32, shape (S, N)
        Colours of the samples, in the order given.
    truncated : int
        Kernels that `max_samples` cut short, over all iterations.
    positions : ndarray of float64, shape (S, 3), or None
        New positions, if they were smoothed.
    """

    colours: NDArray[np.float32]
    truncated: int
    positions: NDArray[np.float64] | None
