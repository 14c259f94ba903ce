"""Workload of kernels on triangles.

On a surface with regular connectivity, the number of samples in a kernel is proportional to its area. It is far larger
around a hub, which is a vertex of very high valence, and where connectivity is irregular, as with vertices joined at
random, which are all a few edges apart. The kernels there are bounded.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from beltrami_cli.arrays import Int32s
from beltrami_cli.flow.manifolds.kernel_work import KernelWork
from beltrami_cli.flow.parameters import KernelParameters

# Minimum valence of a hub; poles of spheres and caps of cylinders have fewer edges.
_HUB = 512

# Number of samples in kernels around hubs from which on they take seconds.
_MAX_NEAR_HUBS = 1_000_000

# Minimum number of joined vertices, since small meshes take no time, and bound of (V - E + F) / V below which
# connectivity is irregular. On surfaces V - E + F is about 0, whatever their handles and borders.
_SMALL_MESH, _IRREGULAR = 1_000, -1 / 4

# Bound of kernels there, as a multiple of the number of samples on an even surface.
_MAX_EXCESS = 2


class MeshWork(KernelWork):
    def __init__(self, kernels: int, unit: float, edges: Int32s, faces: int) -> None:
        super().__init__(kernels, unit)
        degrees = np.bincount(edges.ravel(), minlength=kernels)
        joined = int(np.count_nonzero(degrees))
        self._is_irregular = joined >= _SMALL_MESH and joined - len(edges) + faces < _IRREGULAR * joined
        self._hub_degrees = degrees[degrees > _HUB]

    @property
    def has_uniform_density(self) -> bool:
        """Whether connectivity is regular, and most samples are not next to hubs."""
        return not self._is_irregular and bool(self._hub_degrees.sum() <= self.kernels / 2)

    def bounded(self, parameters: KernelParameters) -> KernelParameters:
        """Bound kernels around hubs and of irregular connectivity by twice their size on an even surface."""
        if parameters.max_samples != KernelParameters.max_samples:
            return parameters
        near_hubs = np.square(self._hub_degrees.astype(np.float64)).sum()
        if not self._is_irregular and near_hubs < _MAX_NEAR_HUBS:
            return parameters
        most = math.ceil(_MAX_EXCESS * self._on_even_surface(parameters))
        return dataclasses.replace(parameters, max_samples=min(parameters.max_samples, most))

    def samples(self, parameters: KernelParameters) -> float:
        near_hubs = self.kernels if self._is_irregular else min(int(self._hub_degrees.sum()), self.kernels)
        each = min(self._on_even_surface(parameters), parameters.max_samples)
        return (self.kernels - near_hubs) * each + near_hubs * min(parameters.max_samples, self.kernels)


def without_hubs(size: int, edges: Int32s) -> Int32s:
    hubs = np.bincount(edges.ravel(), minlength=size) > _HUB
    return edges[~hubs[edges].any(axis=1)] if hubs.any() else edges
