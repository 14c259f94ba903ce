"""One iteration: its metric, the averages by its kernels, and one of these kernels.

Equations as in `manifold`.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Float32s, Int64s
from beltrami_cli.flow.manifolds.geometry import Gaussian, Stack
from beltrami_cli.flow.manifolds.moving_positions import MovingPositions
from beltrami_cli.flow.parameters import KernelParameters


@dataclass(frozen=True)
class Step:
    """One iteration: beta in length per unit of colour, the time step, and whether the metric is regularised."""

    beta: float
    t: float
    regularised: bool


@dataclass(frozen=True)
class Metric:
    """The metric of an iteration, eq. (1).

    On a grid, and on a mesh in chunks, averaging induces it part by part from the first stack. The metric of a whole
    mesh is a `MeshMetric`.
    """

    step: Step
    gaussian: Gaussian | None  # None: not regularised


@dataclass(frozen=True)
class Averaged:
    """Averages of channels by eq. (9), the number of samples in all kernels, and of truncated kernels."""

    stacks: list[Stack]
    samples: float
    truncated: int = 0
    moving: MovingPositions | None = None  # after the iteration


@dataclass(frozen=True)
class SampledKernel:
    """The K samples in the kernel of one sample p, ordered by distance; p is the first."""

    samples: Int64s  # shape (K,)
    distances: Float32s  # d(p, q), in the unit of length of the parameters; 0 at p
    weights: Float32s  # w_q exp(-d(p, q)^2 / (4 t)), eqs. (8, 9), not yet divided by their sum
    colours: Float32s  # I(q), before the iteration, in the working space, shape (K, N)
    offsets: Int64s | None = None  # on a grid, rows and columns from p, shape (K, 2)


def at_step(parameters: KernelParameters, step: Step) -> KernelParameters:
    """Set the time step of an iteration, which determines the radius of kernels."""
    return parameters if step.t == parameters.t else dataclasses.replace(parameters, t=step.t)


def kernel_values(distances: Float32s, t: float) -> Float32s:
    """exp(-d^2 / (4 t)), eq. (8)."""
    return np.asarray(np.exp(-np.square(distances.astype(np.float64)) / (4 * t)), np.float32)
