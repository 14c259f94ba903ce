"""N iterations of the short-time Beltrami kernel on a sampled surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.noise import choose_beta, estimate_sigma
from beltrami_cli.mesh.areas import vertex_areas

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from beltrami_cli._native import TriangulatedManifold
    from beltrami_cli.flow.parameters import KernelParameters
    from beltrami_cli.mesh.surface import SampledSurface


@dataclass(frozen=True)
class FlowResult:
    """Smoothed samples, and how they came about.

    Attributes
    ----------
    colours : ndarray of float32, shape (S, N)
        Colours of the samples, in the order given.
    spacing : float
        The unit of length that was used, in the surface's own: mean sample spacing, or 1.
    beta : float
        As used, in units of length per unit of colour.
    sigma : ndarray of float64, shape (N,)
        Estimated noise of the input.
    samples_per_kernel : float
        Mean over samples and iterations; 0 without iterations.
    truncated : int
        Kernels that `max_samples` cut short, over all iterations.
    """

    colours: NDArray[np.float32]
    spacing: float
    beta: float
    sigma: NDArray[np.float64]
    samples_per_kernel: float
    truncated: int


class BeltramiFlow:
    """The image manifold of a sampled surface, ready to be smoothed.

    Samples are kept in a cache-friendly order inside; what goes in and comes out is in the caller's order.

    Parameters
    ----------
    surface : SampledSurface
        Positions, triangles and colours of S samples.
    parameters : KernelParameters
        What to run with.

    """

    def __init__(self, surface: SampledSurface, parameters: KernelParameters) -> None:
        from beltrami_cli._native import TriangulatedManifold, morton_order

        self.parameters = parameters
        self._order = morton_order(surface.positions)
        rank = np.empty_like(self._order)
        rank[self._order] = np.arange(len(rank), dtype=rank.dtype)
        self._positions = surface.positions[self._order]
        self._colours = surface.colours[self._order]
        self._manifold: TriangulatedManifold = TriangulatedManifold(
            rank[surface.all_faces], len(rank)
        )
        edges = self._manifold.edges()
        lengths = _edge_lengths(self._positions, edges)
        self.mean_edge_length = _mean(lengths)
        self.spacing = _spacing(self.mean_edge_length, parameters)
        self._positions /= self.spacing
        # The walls of hard edges join samples at one place: their colour steps are no noise.
        self.sigma = estimate_sigma(self._colours, edges[lengths > 0])
        if parameters.beta is not None:
            self.beta = parameters.beta
        else:
            self.beta = choose_beta(self.sigma) * self.mean_edge_length / self.spacing
        self._weights: NDArray[np.float32] | None = None
        if parameters.weights == "area":
            self._weights = vertex_areas(self._positions, rank[surface.faces])

    def run(self, progress: Callable[[int, int], None] | None = None) -> FlowResult:
        """Run all iterations.

        Parameters
        ----------
        progress : callable, optional
            Called with the samples done so far and the samples to do, over all iterations; may raise to stop.

        Returns
        -------
        FlowResult
        """
        parameters, count = self.parameters, len(self._order)
        colours, samples, truncated = self._colours, 0, 0
        for iteration in range(parameters.iterations):
            report = None
            if progress is not None:
                before = iteration * count

                def report(done: int, before: int = before) -> None:
                    progress(before + done, parameters.iterations * count)

            self.set_metric(colours)
            colours, held, cut = self._manifold.smooth(
                colours,
                self._weights,
                parameters.t,
                parameters.radius,
                parameters.max_samples,
                parameters.thread_count,
                report,
            )
            samples += held
            truncated += cut
        smoothed = np.empty_like(colours)
        smoothed[self._order] = colours
        kernels = max(1, parameters.iterations * count)
        return FlowResult(smoothed, self.spacing, self.beta, self.sigma, samples / kernels, truncated)

    def set_metric(self, colours: NDArray[np.float32]) -> None:
        """Induce the metric, eq. (1), by colours in the inner order."""
        self._manifold.update_metric(self._positions, colours, self.beta, True, self.parameters.thread_count)

    def probe_samples(self, kernels: int) -> float:
        """Measure how many samples a kernel of the first iteration holds, from some kernels spread evenly."""
        self.set_metric(self._colours)
        sources = np.linspace(0, len(self._order) - 1, min(kernels, len(self._order)), dtype=int)
        limits = (self.parameters.radius, self.parameters.max_samples)
        return float(np.mean([len(self._manifold.distances(int(s), *limits)[0]) for s in sources]))


def _edge_lengths(positions: NDArray[np.float64], edges: NDArray[np.int32]) -> NDArray[np.float64]:
    squared = np.zeros(len(edges))
    for axis in range(positions.shape[1]):
        squared += (positions[edges[:, 0], axis] - positions[edges[:, 1], axis]) ** 2
    return np.sqrt(squared)


def _mean(lengths: NDArray[np.float64]) -> float:
    """Mean length of the edges that have one; edges within a place belong to hard colour edges."""
    return float(lengths.sum() / max(1, np.count_nonzero(lengths)))


def _spacing(mean_length: float, parameters: KernelParameters) -> float:
    """Choose the unit of length; a surface without edges has none, and needs none."""
    return mean_length if parameters.units == "spacing" and mean_length > 0 else 1.0
