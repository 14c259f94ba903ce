"""Estimation of the noise, and variance stabilisation of the colours that manifolds are made from."""

from __future__ import annotations

import dataclasses

import numpy as np

from beltrami_cli.arrays import Float32s
from beltrami_cli.flow.corrections.outliers import fill_outliers
from beltrami_cli.flow.manifolds.blocks import SUMMED_ROWS
from beltrami_cli.flow.manifolds.grid.canvas import fill_canvas, on_canvas
from beltrami_cli.flow.manifolds.grid.manifold import CanvasColours, ColouredCanvas
from beltrami_cli.flow.manifolds.grid.seams import find_colour_jumps, halo_beyond
from beltrami_cli.flow.manifolds.grid.surroundings import CanvasSurroundings
from beltrami_cli.flow.manifolds.mesh.manifold import ColouredMesh, MeshColours
from beltrami_cli.flow.manifolds.mesh.surroundings import MeshSurroundings
from beltrami_cli.flow.manifolds.stabilised_colours import Outliers
from beltrami_cli.flow.noise.clusters import VertexClusters
from beltrami_cli.flow.noise.grid_squares import GridSquares
from beltrami_cli.flow.noise.model import NoiseModel
from beltrami_cli.flow.noise.reading import NoiseOfSamples, estimate_noise
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import EMPTY, refresh_halo, without_halo


def estimate_on_mesh(mesh: ColouredMesh) -> MeshColours:
    """Fill the outliers of the colours, estimate the noise of the other samples, and stabilise its variance."""
    parameters, geometry = mesh.parameters, mesh.geometry
    channels, outliers = fill_outliers(
        mesh.colours.T, MeshSurroundings(geometry), parameters, is_light=mesh.is_light
    )
    graph = geometry.graph(channels.T, mesh.resources)
    noise = estimate_noise(
        channels, VertexClusters.of(graph), parameters.given_noise,
        varies=parameters.stabilises_noise and mesh.moving is None, strength=parameters.strength,
        of_samples=None if mesh.deviations is None else NoiseOfSamples.of(mesh.deviations),
    )  # fmt: skip
    if noise.stabiliser is not None:
        channels = noise.stabiliser.stabilised(channels)
    return MeshColours(stack=channels.T, noise=noise, outliers=outliers, graph=graph)


def estimate_on_canvas(canvas: ColouredCanvas) -> CanvasColours:
    """Put colours on the canvas, fill outliers, estimate the noise of the other cells, and stabilise its variance."""
    parameters, atlas, is_light = canvas.parameters, canvas.atlas, canvas.light is not None
    planes = fill_canvas(atlas, canvas.channels, canvas.colours_of)
    planes, outliers = fill_outliers(planes, CanvasSurroundings(atlas), parameters, is_light=is_light)
    if outliers is not None:
        refresh_halo(planes, atlas)
    of_samples = None
    if canvas.deviations is not None:
        of_samples = NoiseOfSamples.of(canvas.deviations)
        relative = on_canvas(atlas, of_samples.relative)
        relative[relative == 0] = 1  # empty cells
        of_samples = dataclasses.replace(of_samples, relative=relative)
    noise = estimate_noise(
        planes, GridSquares.of(atlas.is_owned), parameters.given_noise, varies=parameters.stabilises_noise,
        strength=parameters.strength, of_samples=of_samples,
    )  # fmt: skip
    if noise.stabiliser is not None:
        # These planes are not shared, and a copy would double the memory.
        noise.stabiliser.stabilise_in_place(planes)
    return _end_at_jumps_in_place(canvas, planes, noise, outliers)


def with_known_noise(canvas: ColouredCanvas, rows: Float32s, noise: NoiseModel) -> CanvasColours:
    """Put stabilised colours of the owned cells, shape (T, N), on the canvas, with a known noise model."""
    return _end_at_jumps_in_place(canvas, on_canvas(canvas.atlas, rows), noise, None)


def _end_at_jumps_in_place(
    canvas: ColouredCanvas, planes: Float32s, noise: NoiseModel, outliers: Outliers | None
) -> CanvasColours:
    """End the canvas at the seams over which colours jump, by emptying the halo cells beyond them."""
    atlas, different = canvas.atlas, np.zeros(max(1, canvas.atlas.seams), bool)
    # If colours do not enter the metric, a jump in colour is not an edge.
    if canvas.parameters.beta != 0 and (canvas.metric_channels is None or len(canvas.metric_channels)):
        different = find_colour_jumps(atlas, planes, noise.largest_sigma)
    if different.any():
        atlas = without_halo(atlas, halo_beyond(atlas, different))
        for rows in large_arrays.blocks(len(atlas.kind), SUMMED_ROWS):
            planes[:, rows][:, atlas.kind[rows] == EMPTY] = 0
    jumps = int(np.count_nonzero(different))
    return CanvasColours(stack=planes, noise=noise, outliers=outliers, atlas=atlas, jumps=jumps)
