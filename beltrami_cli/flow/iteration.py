"""N iterations of the short-time Beltrami kernel on a sampled surface."""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import UsageError
from beltrami_cli.flow.choice import ON_MESHES, Choice, choose, is_noisy
from beltrami_cli.flow.clipping import find_clipped
from beltrami_cli.flow.geometry import GeometryParameters, MovingPositions
from beltrami_cli.flow.mesh_metric import MeshMetric
from beltrami_cli.flow.one_kernel import SampledKernel, kernel_values
from beltrami_cli.flow.partitions.splitting import wanted_split
from beltrami_cli.flow.patches import choose_patches
from beltrami_cli.flow.progress import shifted
from beltrami_cli.flow.result import VertexFlowResult
from beltrami_cli.flow.risk import wanted_probes
from beltrami_cli.flow.rule import RULE_ON_MESHES, choose_by_rule
from beltrami_cli.flow.spacing import edges_in_space, local_spacing, mean_side
from beltrami_cli.flow.trial_mesh import MeshTrial, SampleFields, fingerprints, random_signs
from beltrami_cli.surface.geometry import vertex_areas

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from beltrami_cli._native import SegmentManifold, TriangulatedManifold
    from beltrami_cli.flow.guidance import Guide
    from beltrami_cli.flow.parameters import KernelParameters
    from beltrami_cli.surface.records import SampledSurface

# How far, in edges, kernels of pieces are first expected to reach for each sample spacing.
_EDGES_PER_SPACING = 2.0


class BeltramiFlow:
    """The image manifold of a sampled surface, ready to be smoothed.

    Samples are kept in a cache-friendly order inside; what goes in and comes out is in the caller's order.

    Parameters
    ----------
    surface : SampledSurface
        Positions, triangles and colours of S samples.
    parameters : KernelParameters
        What to run with.
    guides : sequence of Guide
        Channels that enter the metric and stay as they are; S rows each.
    metric_channels : sequence of int, optional
        Which of the N colour channels enter the metric; without it all.
    geometry : GeometryParameters, optional
        How the positions are smoothed along; without it they stay.

    Attributes
    ----------
    mean_edge_length : float
        Over distinct edges with a length in space, in the surface's own unit; 0 without any.
    sigma : ndarray of float64, shape (N,)
        Estimated noise per channel.
    beta : float
        As used, in units of length per unit of colour; 0 if no colour enters the metric.
    guide_betas : dict of str to float
        Units of length per unit of each guide, by its name.
    parameters : KernelParameters
        As used, with nothing free.
    choice : Choice or None
        What of them was chosen from the data; None: nothing was.
    moving : MovingPositions or None
        The positions, if they are smoothed.
    """

    def __init__(
        self,
        surface: SampledSurface,
        parameters: KernelParameters,
        *,
        guides: Sequence[Guide] = (),
        metric_channels: Sequence[int] | None = None,
        geometry: GeometryParameters | None = None,
    ) -> None:
        from beltrami_cli._native import SegmentManifold, TriangulatedManifold, vertex_order

        self.parameters = parameters
        self._order = vertex_order(surface.positions, surface.all_faces)
        rank = np.empty_like(self._order)
        rank[self._order] = np.arange(len(rank), dtype=rank.dtype)
        self._positions = surface.positions[self._order]
        self._colours = surface.colours[self._order]
        length = mean_side(surface.positions, surface.faces) if parameters.units == "world" else 1.0
        solver = SegmentManifold if parameters.is_along_segments(length) else TriangulatedManifold
        self._manifold: SegmentManifold | TriangulatedManifold = solver(rank[surface.all_faces], len(rank))
        # The walls of hard edges join samples at one place: they say nothing about spacing or noise.
        edges, lengths = edges_in_space(self._manifold.edges(), self._positions)
        self.mean_edge_length = float(lengths.mean()) if len(lengths) else 0.0
        spacing = local_spacing(len(rank), edges, lengths)
        self._scales: NDArray[np.float32] | None = None
        if parameters.units == "spacing":
            self._scales = (1 / spacing).astype(np.float32)
        unit = self.mean_edge_length if parameters.units == "world" else 1.0
        in_spacings = lengths / np.sqrt(spacing[edges[:, 0]] * spacing[edges[:, 1]])
        guides = [dataclasses.replace(guide, values=guide.values[self._order]) for guide in guides]
        metric = MeshMetric(edges, in_spacings, self._colours, unit, parameters, guides, metric_channels)
        self._metric, self.sigma = metric, metric.sigma
        self.guide_betas = metric.guide_betas
        self._weights: NDArray[np.float32] | None = None
        if parameters.weights == "area":
            self._weights = vertex_areas(self._positions, rank[surface.faces])
        self.choice: Choice | None = None
        if (
            geometry is not None
        ):  # positions move by as many iterations, and what is best for colours is not for them
            self.parameters = parameters = dataclasses.replace(parameters, free=())
        if parameters.is_open:
            self._choose(rank[surface.all_faces], edges, unit)
            parameters = self.parameters
        self.beta = metric.beta
        self._clipped = None
        if parameters.clipping == "restore" and self.beta > 0 and parameters.iterations:
            joined = np.zeros(len(rank), bool)
            joined[edges] = True  # isolated samples keep their colours, and say nothing of the others'
            self._clipped = find_clipped(self._colours[joined], self.sigma)
        # Only pieces need the triangles once more.
        self._split = wanted_split()
        self._faces = None if self._split is None else rank[surface.all_faces]
        self.moving: MovingPositions | None = None
        if geometry is not None:
            if self._split is not None:
                raise UsageError("vertices are not moved in pieces; leave out --pieces, or --smooth-geometry")
            places = GeometryParameters(geometry.places[self._order], geometry.normal_beta)
            self.moving = MovingPositions(
                self._positions, rank[surface.faces], edges, self.mean_edge_length or 1.0, unit, places
            )

    def _choose(self, faces: NDArray[np.int32], edges: NDArray[np.int32], unit: float) -> None:
        """Choose the free parameters, and tell the metric of them."""
        parameters, metric = dataclasses.replace(self.parameters, free=()), self._metric
        if is_noisy(self.sigma) and self.parameters.fast:
            parameters, self.choice = choose_by_rule(
                metric.counting, unit, metric.beta, self.parameters, RULE_ON_MESHES
            )
        elif is_noisy(self.sigma) and len(edges):
            around = fingerprints(self._colours, edges)
            sample = choose_patches(self._colours, around, edges)
            probes = wanted_probes(int(np.count_nonzero(sample.counting)))
            signs = random_signs(self._colours, around, probes)
            fields = SampleFields(self._positions, self._colours, signs, self._scales, self._weights)
            trial = MeshTrial(sample, fields, faces, self._manifold, self._metric, parameters)
            parameters, self.choice = choose(
                trial, trial.samples, self.sigma, self._metric.counting, unit, self._metric.beta,
                self.parameters, ON_MESHES,
            )  # fmt: skip
        elif "iterations" in self.parameters.free:
            parameters = dataclasses.replace(parameters, iterations=0)
        self.parameters = parameters
        self._metric.use(parameters)

    def run(self, progress: Callable[[int, int], None] | None = None) -> VertexFlowResult:
        """Run all iterations.

        Parameters
        ----------
        progress : callable, optional
            Called with the samples done so far and the samples to do, over all iterations; may raise to stop.

        Returns
        -------
        VertexFlowResult
        """
        parameters, count = self.parameters, len(self._order)
        channels = self._colours.shape[1]
        iterate = self._iterate if self._split is None else self._iterate_in_pieces
        colours, samples, truncated = iterate(self._with_marks(), progress)
        if self._clipped is not None:
            self._clipped.restore(colours.T[:channels], colours.T[channels:])
        self._colours = colours = np.ascontiguousarray(colours[:, :channels])
        return VertexFlowResult(
            spacing=self.mean_edge_length,
            beta=self.beta,
            sigma=self.sigma,
            samples_per_kernel=samples / max(1, parameters.iterations * count),
            choice=self.choice,
            colours=self._in_order(colours),
            truncated=truncated,
            positions=None if self.moving is None else self._in_order(self.moving.positions),
        )

    def _iterate(
        self, colours: NDArray[np.float32], progress: Callable[[int, int], None] | None
    ) -> tuple[NDArray[np.float32], float, int]:
        """Run all iterations; return the colours, the samples held, and the kernels cut short."""
        parameters, count, samples, truncated = self.parameters, len(self._order), 0, 0
        channels = self._colours.shape[1]
        for iteration in range(parameters.iterations):
            self._set_metric(np.ascontiguousarray(colours[:, :channels]), iteration)
            colours, held, cut = self._average(
                colours, shifted(progress, iteration * count, parameters.iterations * count)
            )
            samples += held
            truncated += cut
        return colours, samples, truncated

    def _iterate_in_pieces(
        self, colours: NDArray[np.float32], progress: Callable[[int, int], None] | None
    ) -> tuple[NDArray[np.float32], float, int]:
        """Do what `_iterate` does, to the last bit, piece by piece; the samples held are estimated."""
        parameters, faces, split = self.parameters, self._faces, self._split
        if faces is None or split is None or not parameters.iterations:
            return colours, 0, 0
        from beltrami_cli._native import SegmentManifold
        from beltrami_cli.flow.partitions.mesh import MeshFields, cut_mesh

        fields = MeshFields(
            self._positions, faces, self._manifold.edges(), self._scales, self._weights, self._metric,
            self._colours.shape[1], parameters, isinstance(self._manifold, SegmentManifold),
        )  # fmt: skip
        spacing = self.mean_edge_length if parameters.units == "world" else 1.0
        # Edges are shorter here and longer there; what proves too narrow is cut anew.
        reach = min(len(colours), 2 + int(_EDGES_PER_SPACING * parameters.radius / (spacing or 1.0)))
        done = split.run(partial(cut_mesh, fields), reach, colours, parameters.iterations, progress)
        return done.values, done.samples, done.truncated

    def _with_marks(self) -> NDArray[np.float32]:
        """Return the channels to average: the colours, and the marks of samples that were cut off."""
        if self._clipped is None:
            return self._colours
        return np.concatenate([self._colours, self._clipped.marks(self._colours.T).T], axis=1)

    def _average(
        self, colours: NDArray[np.float32], progress: Callable[[int], None] | None
    ) -> tuple[NDArray[np.float32], int, int]:
        """Average the colours, and the positions if they move, by eq. (9)."""
        if self.moving is None:
            return self._apply_kernel(colours, progress)
        before, width = self.moving.channels(), colours.shape[1]
        smoothed, held, cut = self._apply_kernel(np.concatenate([colours, before], axis=1), progress)
        self.moving.move(before, smoothed[:, width:], lambda channels: self._apply_kernel(channels, None)[0])
        self._positions = self.moving.positions
        return np.ascontiguousarray(smoothed[:, :width]), held, cut

    def _apply_kernel(
        self, channels: NDArray[np.float32], progress: Callable[[int], None] | None
    ) -> tuple[NDArray[np.float32], int, int]:
        """Average channels in the present metric; return them, the samples held, and the kernels cut short."""
        parameters = self.parameters
        return self._manifold.smooth(
            channels,
            self._weights,
            parameters.t,
            parameters.radius,
            parameters.max_samples,
            parameters.thread_count,
            progress,
        )

    def kernel_at(self, sample: int) -> SampledKernel:
        """Return the kernel that one more iteration, after those that were run, would have at a sample."""
        parameters = self.parameters
        self._set_metric(self._colours, parameters.iterations)
        (source,) = np.flatnonzero(self._order == sample)
        held, distances = self._manifold.distances(int(source), parameters.radius, parameters.max_samples)
        weights = kernel_values(distances, parameters.t)
        if self._weights is not None:
            weights = weights * self._weights[held]
        return SampledKernel(self._order[held].astype(np.int64), distances, weights, self._colours[held])

    def _set_metric(self, colours: NDArray[np.float32], iteration: int) -> None:
        """Induce the metric, eq. (1), for an iteration, by colours in the inner order."""
        normals = None if self.moving is None else (self.moving.normals, self.moving.beta)
        channels, beta = self._metric.channels(colours, iteration, normals)
        threads = self.parameters.thread_count
        self._manifold.update_metric(self._positions, channels, beta, self._scales, threads)

    def _in_order(self, rows: NDArray[Any]) -> NDArray[Any]:
        """Bring rows back to the order that the caller gave them in."""
        ordered = np.empty_like(rows)
        ordered[self._order] = rows
        return ordered

    def probe_samples(self, kernels: int) -> float:
        """Measure how many samples a kernel of the first iteration holds, from some kernels spread evenly."""
        self._set_metric(self._colours, 0)
        sources = np.linspace(0, len(self._order) - 1, min(kernels, len(self._order)), dtype=int)
        limits = (self.parameters.radius, self.parameters.max_samples)
        return float(np.mean([len(self._manifold.distances(int(s), *limits)[0]) for s in sources]))
