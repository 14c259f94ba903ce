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

from beltrami_cli.flow.mesh_manifold import MeshManifold
from beltrami_cli.flow.parameters import KernelParameters

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.flow.manifold import Manifold

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


def find_hubs(size: int, edges: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Find the vertices with very many edges."""
    return np.asarray(np.bincount(edges.ravel(), minlength=size) > _HUB)


def without_hubs(size: int, edges: NDArray[np.int32]) -> NDArray[np.int32]:
    """Leave out the edges at hubs."""
    hubs = find_hubs(size, edges)
    return edges[~hubs[edges].any(axis=1)] if hubs.any() else edges


def is_surface(manifold: MeshManifold) -> bool:
    """Whether parts of the mesh tell what is best for it: it is no tangle, and most samples are not beside hubs."""
    beside = np.count_nonzero(find_hubs(manifold.size, manifold.edges)[manifold.edges])
    return not _is_tangled(manifold) and bool(beside <= manifold.size / 2)


def bounded(manifold: Manifold, parameters: KernelParameters) -> KernelParameters:
    """Return parameters with fewer samples a kernel, if the mesh needs that and the limit is the default."""
    if not isinstance(manifold, MeshManifold) or parameters.max_samples != KernelParameters.max_samples:
        return parameters
    beside = _degrees(manifold).astype(np.float64)
    if not _is_tangled(manifold) and np.square(beside[beside > _HUB]).sum() < _MOST_BESIDE_HUBS:
        return parameters
    most = math.ceil(_LARGEST * _samples_on_surface(manifold, parameters))
    return dataclasses.replace(parameters, max_samples=min(parameters.max_samples, most))


def announce(manifold: Manifold, parameters: KernelParameters) -> None:
    """Say how much work is ahead."""
    each = min(_samples_on_surface(manifold, parameters), parameters.window**2)
    samples = manifold.kernels * each
    if isinstance(manifold, MeshManifold):
        each = min(_samples_on_surface(manifold, parameters), parameters.max_samples)
        degrees = _degrees(manifold)
        beside = manifold.size if _is_tangled(manifold) else int(degrees[degrees > _HUB].sum())
        beside = min(beside, manifold.size)
        samples = (manifold.size - beside) * each + beside * min(parameters.max_samples, manifold.size)
    samples *= parameters.iterations
    LOG.info(
        "work: %d kernels in each of %d iterations, at most some %.2g million samples",
        manifold.kernels, parameters.iterations, samples / 1e6,
    )  # fmt: skip


def _degrees(manifold: MeshManifold) -> NDArray[np.int64]:
    return np.bincount(manifold.edges.ravel(), minlength=manifold.size)


def _is_tangled(manifold: MeshManifold) -> bool:
    joined = int(np.count_nonzero(_degrees(manifold)))
    return joined >= _SMALL and joined - len(manifold.edges) + len(manifold.faces) < _TANGLED * joined


def _samples_on_surface(manifold: Manifold, parameters: KernelParameters) -> float:
    return 1 + _DENSITY * (parameters.radius / (manifold.unit or 1)) ** 2
