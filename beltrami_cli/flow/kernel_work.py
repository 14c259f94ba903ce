"""How much work kernels are, and a bound for triangles among which they would hold far too many samples.

On an even surface a kernel holds as many samples as its area. It holds far more beside a vertex of very many triangles,
a hub, and in a tangle: triangles that are no surface, as vertices joined at random, all of which are a few edges apart.
"""

from __future__ import annotations

import dataclasses
import logging
import math
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.parameters import KernelParameters

if TYPE_CHECKING:
    from beltrami_cli.arrays import Bools, Int32s

LOG = logging.getLogger(__name__)
"""Says how much work is ahead, before it starts."""

# Edges at one vertex. The poles of spheres and the caps of cylinders have fewer.
_HUB = 512

# Samples that kernels beside hubs would hold, from which it takes seconds.
_MOST_BESIDE_HUBS = 1_000_000

# A small tangle takes no time. On surfaces V - E + F is about 0, whatever their handles and borders are.
_SMALL, _TANGLED = 1_000, -1 / 4

# Samples in a circle of radius 1 where triangles are equilateral, with sides of 1.
_DENSITY = 2 * math.pi / math.sqrt(3)

# Samples of the largest kernels there, as a multiple of what they would hold on an even surface.
_LARGEST = 2


def find_hubs(size: int, edges: Int32s) -> Bools:
    """Find the vertices with very many edges."""
    return np.asarray(np.bincount(edges.ravel(), minlength=size) > _HUB)


def without_hubs(size: int, edges: Int32s) -> Int32s:
    """Leave out the edges at hubs."""
    hubs = find_hubs(size, edges)
    return edges[~hubs[edges].any(axis=1)] if hubs.any() else edges


class KernelWork:
    """Work with kernels that a window bounds, whatever the samples are: those of a grid."""

    def __init__(self, kernels: int, unit: float) -> None:
        self.kernels = kernels
        self._unit = unit or 1.0

    @property
    def is_surface(self) -> bool:
        """Whether what is best for parts is best for the whole."""
        return True

    def bounded(self, parameters: KernelParameters) -> KernelParameters:
        """Return parameters with fewer samples a kernel, if the samples need that and the limit is the default."""
        return parameters

    def samples(self, parameters: KernelParameters) -> float:
        """Return how many samples all kernels of an iteration hold, at most."""
        return self.kernels * min(self._on_even_surface(parameters), parameters.window**2)

    def announce(self, parameters: KernelParameters) -> None:
        """Log how much work is ahead."""
        LOG.info(
            "work: %d kernels in each of %d iterations, at most some %.2g million samples",
            self.kernels, parameters.iterations, parameters.iterations * self.samples(parameters) / 1e6,
        )  # fmt: skip

    def _on_even_surface(self, parameters: KernelParameters) -> float:
        """Return how many samples a kernel holds where samples are evenly spread."""
        return 1 + _DENSITY * (parameters.radius / self._unit) ** 2


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
        """Whether it is no tangle, and most samples are not beside hubs."""
        beside = np.count_nonzero(find_hubs(self.kernels, self._edges)[self._edges])
        return not self._is_tangled and bool(beside <= self.kernels / 2)

    def bounded(self, parameters: KernelParameters) -> KernelParameters:
        """Bound kernels beside hubs and in tangles by twice what they would hold on an even surface."""
        if parameters.max_samples != KernelParameters.max_samples:
            return parameters
        beside = np.square(self._hub_degrees.astype(np.float64)).sum()
        if not self._is_tangled and beside < _MOST_BESIDE_HUBS:
            return parameters
        most = math.ceil(_LARGEST * self._on_even_surface(parameters))
        return dataclasses.replace(parameters, max_samples=min(parameters.max_samples, most))

    def samples(self, parameters: KernelParameters) -> float:
        """Return how many samples all kernels of an iteration hold, at most."""
        beside = self.kernels if self._is_tangled else min(int(self._hub_degrees.sum()), self.kernels)
        each = min(self._on_even_surface(parameters), parameters.max_samples)
        return (self.kernels - beside) * each + beside * min(parameters.max_samples, self.kernels)
