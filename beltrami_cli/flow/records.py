"""What an iteration on a manifold takes, what it gives, and how much work its kernels are.

On an even surface a kernel holds as many samples as its area. It holds far more around a vertex of very many triangles,
a hub, and in a tangle: triangles that are no surface, such as vertices joined at random, all a few edges apart.
There the kernels are bounded.
"""

from __future__ import annotations

import dataclasses
import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s, Int32s, Int64s
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.surface.atlas import Indices

if TYPE_CHECKING:
    from beltrami_cli.flow.moving_positions import MovingPositions

LOG = logging.getLogger(__name__)
"""Says how much work is ahead, before it starts."""

# Edges at one vertex. The poles of spheres and the caps of cylinders have fewer.
_HUB = 512

# Samples that kernels around hubs would hold, from which on it takes seconds.
_MOST_NEAR_HUBS = 1_000_000

# A small tangle takes no time. On surfaces V - E + F is about 0, whatever their handles and borders are.
_SMALL, _TANGLED = 1_000, -1 / 4

# Samples of the largest kernels there, as a multiple of what they would hold on an even surface.
_LARGEST = 2


@dataclass(frozen=True)
class Step:
    """One iteration: beta in units of length per unit of colour, the time step, whether the metric is regularised."""

    beta: float
    t: float
    regularised: bool


@dataclass(frozen=True)
class Averaged:
    """Averages of channels by eq. (9), how many samples the kernels held, and how many kernels were cut short."""

    stacks: list[Float32s]
    samples: float
    truncated: int = 0
    moving: MovingPositions | None = None  # after the iteration


@dataclass(frozen=True)
class Mixing:
    """How N channels are mixed so that each can be estimated by itself, shape (N, N), and their noise, shape (N,)."""

    forth: Float32s
    back: Float32s
    variances: Float32s
    shrinkage: Float32s  # what the noise is multiplied by, with a pilot, where there is no detail, shape (N,)
    least_ratio: float = 0.0  # ... and at least, where there is
    strength: float = 1.0  # ... and besides, everywhere
    has_pilot: bool = field(default=False, kw_only=True)  # patches are compared on an estimate

    @property
    def parts(self) -> tuple[Float32s, Float32s, Float32s, Float32s, float, float]:
        return self.forth, self.back, self.variances, self.shrinkage, self.least_ratio, self.strength


@dataclass(frozen=True)
class NewColours:
    """Colours of S samples, read block by block, and the colours that continue them beyond seams."""

    take: Callable[[slice, Bools | slice], Float32s]  # a block's rows, all or by a mask
    places: Indices  # texels or pixels of the samples, shape (S,)
    beyond_places: Indices  # texels or pixels around charts, shape (G,)
    beyond: Float32s  # their colours, shape (G, N)
    positions: Float64s | None = None  # of the samples, shape (S, 3), if they moved

    @classmethod
    def of(
        cls,
        rows: Float32s,
        places: Indices | None = None,
        beyond_places: Indices | None = None,
        beyond: Float32s | None = None,
    ) -> NewColours:
        """Give the rows of a table, shape (S, N)."""
        none = np.zeros(0, np.int64)
        return cls(
            lambda block, inside: rows[block][inside],
            np.arange(len(rows)) if places is None else places,
            none if beyond_places is None else beyond_places,
            np.zeros((0, rows.shape[1]), np.float32) if beyond is None else beyond,
        )

    def mapped(self, each: Callable[[Float32s], Float32s]) -> NewColours:
        """Return what a function makes of rows of colours."""
        take = self.take
        return dataclasses.replace(
            self, take=lambda block, inside: each(take(block, inside)), beyond=each(self.beyond)
        )

    def table(self) -> Float32s:
        """Return all rows, shape (S, N)."""
        return self.take(slice(None), slice(None))


def at_step(parameters: KernelParameters, step: Step) -> KernelParameters:
    """Return parameters with the time step of an iteration, which the radius of kernels follows."""
    return parameters if step.t == parameters.t else dataclasses.replace(parameters, t=step.t)


@dataclass(frozen=True)
class SampledKernel:
    """The K samples in the kernel of one sample p, p first and the others by their distance."""

    samples: Int64s  # shape (K,)
    distances: Float32s  # d(p, q), in the unit of length of the parameters; 0 at p
    weights: Float32s  # w_q exp(-d(p, q)^2 / (4 t)), eqs. (8, 9), not yet divided by their sum
    colours: Float32s  # I(q), before the iteration, in the working space, shape (K, N)
    offsets: Int64s | None = None  # on a grid, rows and columns from p, shape (K, 2)


def kernel_values(distances: Float32s, t: float) -> Float32s:
    """Return exp(-d^2 / (4 t)), eq. (8)."""
    return np.asarray(np.exp(-np.square(distances.astype(np.float64)) / (4 * t)), np.float32)


def find_hubs(size: int, edges: Int32s) -> Bools:
    """Return which vertices have very many edges."""
    return np.asarray(np.bincount(edges.ravel(), minlength=size) > _HUB)


def without_hubs(size: int, edges: Int32s) -> Int32s:
    """Leave out the edges at hubs."""
    hubs = find_hubs(size, edges)
    return edges[~hubs[edges].any(axis=1)] if hubs.any() else edges


class KernelWork:
    """Work with kernels that a window bounds, as on a grid."""

    def __init__(self, kernels: int, unit: float) -> None:
        self.kernels = kernels
        self._unit = unit or 1.0

    @property
    def is_surface(self) -> bool:
        """Whether the best parameters of parts are the best ones of the whole."""
        return True

    def bounded(self, parameters: KernelParameters) -> KernelParameters:
        """Return parameters with fewer samples a kernel, if the samples need that and the limit is the default."""
        return parameters

    def samples(self, parameters: KernelParameters) -> float:
        """Return how many samples all kernels of an iteration hold, at most."""
        return self.kernels * min(self._on_even_surface(parameters), parameters.window**2)

    def announce(self, parameters: KernelParameters) -> None:
        LOG.info(
            "work: %d kernels in each of %d iterations, at most some %.2g million samples",
            self.kernels, parameters.iterations, parameters.iterations * self.samples(parameters) / 1e6,
        )  # fmt: skip

    def _on_even_surface(self, parameters: KernelParameters) -> float:
        """Return how many samples a kernel holds where triangles are equilateral, with an area of sqrt(3) / 4."""
        circle, of_sample = math.pi * (parameters.radius / self._unit) ** 2, math.sqrt(3) / 2
        return 1 + circle / of_sample


class MeshWork(KernelWork):
    """Work with the kernels of triangles, where hubs and tangles cost more."""

    def __init__(self, kernels: int, unit: float, edges: Int32s, faces: int) -> None:
        super().__init__(kernels, unit)
        degrees = np.bincount(edges.ravel(), minlength=kernels)
        joined = int(np.count_nonzero(degrees))
        self._is_tangled = joined >= _SMALL and joined - len(edges) + faces < _TANGLED * joined
        self._hub_degrees = degrees[degrees > _HUB]
        self._edges = edges

    @property
    def is_surface(self) -> bool:
        """Whether it is no tangle, and most samples are not next to hubs."""
        near_hubs = np.count_nonzero(find_hubs(self.kernels, self._edges)[self._edges])
        return not self._is_tangled and bool(near_hubs <= self.kernels / 2)

    def bounded(self, parameters: KernelParameters) -> KernelParameters:
        """Bound kernels around hubs and in tangles by twice what they would hold on an even surface."""
        if parameters.max_samples != KernelParameters.max_samples:
            return parameters
        near_hubs = np.square(self._hub_degrees.astype(np.float64)).sum()
        if not self._is_tangled and near_hubs < _MOST_NEAR_HUBS:
            return parameters
        most = math.ceil(_LARGEST * self._on_even_surface(parameters))
        return dataclasses.replace(parameters, max_samples=min(parameters.max_samples, most))

    def samples(self, parameters: KernelParameters) -> float:
        """Return how many samples all kernels of an iteration hold, at most."""
        near_hubs = self.kernels if self._is_tangled else min(int(self._hub_degrees.sum()), self.kernels)
        each = min(self._on_even_surface(parameters), parameters.max_samples)
        return (self.kernels - near_hubs) * each + near_hubs * min(parameters.max_samples, self.kernels)
