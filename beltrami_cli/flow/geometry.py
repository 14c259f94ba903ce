"""Positions that are smoothed along with the colours, and the normals that keep their creases.

The positions are channels of the embedding like the colours, and are averaged by the same kernel. In the metric of the
surface alone that is motion by mean curvature, which smooths creases like noise. So the normals enter the metric too,
as features that distinguish creases from noise, as in the bilateral filters for meshes [1]_ [2]_. What the average
removes is averaged once more and added back (Tukey's twicing [3]_): K X becomes (2 K - K^2) X, in which noise falls
nearly as far, and curved parts do not shrink to first order. Vertices move only in the directions that change the
shape: sliding along the surface would compress triangles beside creases, where kernels extend to one side only.

References
----------
.. [1] S. Fleishman, I. Drori, D. Cohen-Or, "Bilateral mesh denoising", SIGGRAPH 2003, doi:10.1145/882262.882368
.. [2] Y. Zheng, H. Fu, O. Au, C. Tai, "Bilateral normal filtering for mesh denoising", IEEE Trans. Visualization and
   Computer Graphics 17(10), 2011, doi:10.1109/TVCG.2010.264
.. [3] J. W. Tukey, "Exploratory data analysis", Addison-Wesley 1977, section 16
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s, Int32s
from beltrami_cli.flow.embedding import choose_beta
from beltrami_cli.flow.noise.mesh import residuals
from beltrami_cli.surface.geometry import normal_tensors, on_boundary, vertex_normals

Average = Callable[[Float32s], Float32s]


@dataclass(frozen=True)
class GeometryParameters:
    """How positions are smoothed: samples of one place, shape (S,), move together."""

    places: Int32s
    # How strongly creases are kept: units of length per difference of normals (nearly radians), 0: not at all, None: by
    # `choose_normal_beta`.
    normal_beta: float | None = None


class MovingPositions:
    """The positions and normals of a surface while they are smoothed; `unit`: the spacing in units of length."""

    def __init__(
        self,
        positions: Float64s,
        faces: Int32s,
        edges: Int32s,
        spacing: float,
        unit: float,
        parameters: GeometryParameters,
    ) -> None:
        self._faces, self._spacing, self._places = faces, spacing, parameters.places
        # A sample without triangles moves only together with the others at its place.
        self._leads = np.bincount(faces.ravel(), minlength=len(positions)) > 0
        self._leads_at = np.bincount(self._places, self._leads)
        # An open border would shrink along itself, and cracks would open where another surface touches it.
        self._stays = on_boundary(self._places[faces], len(self._leads_at))[self._places]
        # The core takes float32: coordinates far from the origin would lose their digits there.
        self._origin = positions.mean(axis=0) if len(positions) else np.zeros(3)
        self.positions = positions
        self.normals = vertex_normals(positions, faces, self._places)
        self.sigma = estimate_normal_sigma(self.normals, edges)
        chosen = parameters.normal_beta
        self.beta = choose_normal_beta(self.normals, edges, self.sigma) * unit if chosen is None else chosen

    def channels(self) -> Float32s:
        """Return the positions as channels to be averaged, shape (S, 3), in sample spacings."""
        return ((self.positions - self._origin) / self._spacing).astype(np.float32)

    def move(self, before: Float32s, after: Float32s, average: Average) -> None:
        """Move the positions; borders stay fixed, and samples of one place stay together."""
        taken = before - after
        moves = (average(taken).astype(np.float64) - taken) * self._spacing
        # Directions come from the smoothed shape: the normals of a spike are those of its sides.
        tensors = normal_tensors(self.positions + moves, self._faces, self._places)
        moves = np.einsum("sij,sj->si", tensors[self._places], moves)
        moves[self._stays | ~self._leads] = 0
        for axis in range(moves.shape[1]):
            total = np.bincount(self._places, moves[:, axis], len(self._leads_at))
            moves[:, axis] = (total / np.maximum(self._leads_at, 1))[self._places]
        self.positions = self.positions + moves
        self.normals = vertex_normals(self.positions, self._faces, self._places)


# The length of a vector of two independent normal numbers has the median sqrt(2 ln 2).
_SIGMA_PER_MEDIAN_LENGTH = 1 / np.sqrt(2 * np.log(2))

# Length of the noise of normals in sample spacings: beta sigma. On noisy cubes, cylinders, spheres and a head, the flat
# optimum of the remaining noise in smooth parts and at creases.
_NORMAL_BETA_SIGMA = 1.5

# Bound on the length, in sample spacings, of the usual turn of the normal from a vertex to the next: on a capped
# cylinder and on a head, the value at which curved parts are still smoothed and creases still stay.
_TURN_COUNTS = 0.8


def estimate_normal_sigma(normals: Float32s, edges: Int32s) -> float:
    """Estimate the noise of unit normals, shape (S, 3): standard deviation about each of two axes, in radians."""
    # Lengths of the residuals, not components, so that rotating the surface changes nothing.
    squares = sum(np.square(residual) for residual in residuals(normals, edges))
    if not np.size(squares):
        return 0.0
    return float(_SIGMA_PER_MEDIAN_LENGTH * np.sqrt(np.median(squares)))


def choose_normal_beta(normals: Float32s, edges: Int32s, sigma: float) -> float:
    """Choose beta, in spacings per radian, so that creases stop the kernel, but not noise or usual curvature."""
    by_noise = choose_beta(np.array([sigma]), _NORMAL_BETA_SIGMA)
    if not len(edges):
        return by_noise
    median = float(np.median(np.linalg.norm(normals[edges[:, 0]] - normals[edges[:, 1]], axis=1)))
    # Of two noisy normals, the difference has twice the variance of one about each axis.
    turn = np.sqrt(max(0.0, median**2 - 2 * (sigma / _SIGMA_PER_MEDIAN_LENGTH) ** 2))
    return min(by_noise, _TURN_COUNTS / turn) if turn > 0 else by_noise
