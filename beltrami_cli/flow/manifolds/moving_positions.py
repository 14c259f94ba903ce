"""Smoothing of positions along with the colours, with normals that preserve creases.

The positions are channels of the embedding like the colours, and are averaged by the same kernel. With the metric of
the surface alone this is motion by mean curvature, which smooths creases like noise. So the normals enter the metric as
features that distinguish creases from noise, as in bilateral filters for meshes [1]_ [2]_. What the average removes is
averaged once more and added back (Tukey's twicing [3]_): K X becomes (2 K - K^2) X. Noise is reduced by nearly as much,
and curved parts do not shrink to first order. Vertices move only in the directions that change the shape. Sliding along
the surface would compress triangles at creases, where kernels extend to one side only.

References
----------
.. [1] S. Fleishman, I. Drori, D. Cohen-Or, "Bilateral mesh denoising", SIGGRAPH 2003, doi:10.1145/882262.882368
.. [2] Y. Zheng, H. Fu, O. Au, C. Tai, "Bilateral normal filtering for mesh denoising", IEEE Trans. Visualization and
   Computer Graphics 17(10), 2011, doi:10.1109/TVCG.2010.264
.. [3] J. W. Tukey, "Exploratory data analysis", Addison-Wesley 1977, section 16
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s, Int32s
from beltrami_cli.flow.manifolds.beta import choose_beta
from beltrami_cli.flow.vertex_graph import sums_around
from beltrami_cli.surface.geometry import normal_tensors, on_boundary, vertex_normals

Average = Callable[[Float32s], Float32s]

# Length of the noise of normals in sample spacings (beta sigma): the flat optimum of the remaining error in smooth
# parts and at creases, on noisy cubes, cylinders, spheres and a head.
_NORMAL_BETA_SIGMA = 1.5

# Minimum number of neighbours for the residual of a normal: at a border, their mean is biased to one side.
_NEIGHBOURS = 3

# Maximum length, in sample spacings, of the usual turn of the normal between neighbours. At this value curved parts are
# still smoothed and creases preserved, on a capped cylinder and on a head.
_TURN_COUNTS = 0.8


@dataclass(frozen=True)
class PositionParameters:
    """Parameters of the smoothing of positions; samples with one place number, shape (S,), move together."""

    places: Int32s
    # Strength of crease preservation: length per difference of normals (nearly radians); 0: none; None: by
    # `choose_normal_beta`.
    normal_beta: float | None = None


@dataclass(frozen=True, eq=False)
class MovingPositions:
    """The positions and normals of a surface, before or after iterations."""

    positions: Float64s
    normals: Float32s
    sigma: float  # of the normals, about each of two axes, in radians
    beta: float  # of the normals
    faces: Int32s
    places: Int32s
    spacing: float
    origin: Float64s  # subtracted first: float32 in the core would lose digits far from the origin
    leads: Bools  # false without triangles: moves only with coincident samples
    stays: Bools  # at open borders, which would shrink and open cracks to adjacent surfaces

    @classmethod
    def of(
        cls,
        positions: Float64s,
        faces: Int32s,
        edges: Int32s,
        *,
        spacing: float,
        unit: float,
        parameters: PositionParameters,
    ) -> MovingPositions:
        """Measure the normals; `unit`: unit of length in sample spacings."""
        places = parameters.places
        count = int(places.max(initial=-1)) + 1
        normals = vertex_normals(positions, faces, places)
        sigma, beta = estimate_normal_sigma(normals, edges), parameters.normal_beta
        return cls(
            positions=positions, normals=normals, sigma=sigma,
            beta=choose_normal_beta(normals, edges, sigma) * unit if beta is None else beta, faces=faces,
            places=places, spacing=spacing, origin=positions.mean(axis=0) if len(positions) else np.zeros(3),
            leads=np.bincount(faces.ravel(), minlength=len(positions)) > 0,
            stays=on_boundary(places[faces], count)[places],
        )  # fmt: skip

    def channels(self) -> Float32s:
        """Return the positions as channels to be averaged, shape (S, 3), in sample spacings."""
        return ((self.positions - self.origin) / self.spacing).astype(np.float32)

    def moved(self, before: Float32s, after: Float32s, average: Average) -> MovingPositions:
        """Return the positions after an iteration; borders are fixed, and coincident samples move together."""
        taken = before - after
        moves = (average(taken).astype(np.float64) - taken) * self.spacing
        # Directions are normals of the smoothed shape, since the normals of a spike are those of its sides.
        tensors = normal_tensors(self.positions + moves, self.faces, self.places)
        moves = np.einsum("sij,sj->si", tensors[self.places], moves)
        moves[self.stays | ~self.leads] = 0
        leads = np.maximum(np.bincount(self.places, self.leads), 1)
        for axis in range(moves.shape[1]):
            moves[:, axis] = (np.bincount(self.places, moves[:, axis]) / leads)[self.places]
        positions = self.positions + moves
        normals = vertex_normals(positions, self.faces, self.places)
        return dataclasses.replace(self, positions=positions, normals=normals)


def estimate_normal_sigma(normals: Float32s, edges: Int32s) -> float:
    """Estimate the noise of unit normals, shape (S, 3): standard deviation about each of two axes, in radians."""
    # Lengths of the residuals, not components, so that the result is invariant to rotation.
    squares = sum(np.square(residual) for residual in _residuals(normals, edges))
    if not np.size(squares):
        return 0.0
    return float(np.sqrt(np.median(squares)) / _median_length())


def _residuals(normals: Float32s, edges: Int32s) -> list[Float64s]:
    """Return the differences of normals from the mean of their neighbours, by component, in units of their noise."""
    degree = np.bincount(edges.ravel(), minlength=len(normals))
    inside = degree >= _NEIGHBOURS
    means = sums_around(normals.astype(np.float64), edges)[inside] / degree[inside, None]
    scale = np.sqrt(degree[inside] / (degree[inside] + 1.0))
    return list(((normals[inside] - means) * scale[:, None]).T)


def choose_normal_beta(normals: Float32s, edges: Int32s, sigma: float) -> float:
    """Choose beta, in spacings per radian, so that creases stop the kernel, but noise and usual curvature do not."""
    by_noise = choose_beta(np.array([sigma]), _NORMAL_BETA_SIGMA)
    if not len(edges):
        return by_noise
    median = float(np.median(np.linalg.norm(normals[edges[:, 0]] - normals[edges[:, 1]], axis=1)))
    # The difference of two noisy normals has twice the variance about each axis.
    turn = np.sqrt(max(0.0, median**2 - 2 * (sigma * _median_length()) ** 2))
    return min(by_noise, _TURN_COUNTS / turn) if turn > 0 else by_noise


def _median_length() -> float:
    """Return the median length of a vector of two independent unit normal variables."""
    return math.sqrt(2 * math.log(2))
