"""The kernel of a vertex."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access
from beltrami_cli.jobs.kernel.study import KernelStudy, MeshView, Shown, describe, table
from beltrami_cli.samples.vertices.guides import vertex_guides
from beltrami_cli.samples.vertices.point_cloud import with_surface
from beltrami_cli.samples.vertices.prepare import prepare

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from beltrami_cli.flow.kernel_probe import SampledKernel
    from beltrami_cli.formats.document import Document
    from beltrami_cli.jobs.kernel.place import Place
    from beltrami_cli.samples.settings.smooth import SmoothSettings
    from beltrami_cli.surface.records import PaintedVertices
    from beltrami_cli.surface.vertex_sampling import VertexSampling


def study_vertex(
    document: Document,
    place: Place,
    settings: SmoothSettings,
    *,
    whole: bool,
    progress: Callable[[int, int], None] | None = None,
    access: Access = EVERYTHING_INSIDE,
) -> KernelStudy:
    """Study the kernel of a vertex after the iterations that the settings ask for.

    Parameters
    ----------
    document : Document
        With vertex colours.
    place : Place
        An index or a position.
    settings : SmoothSettings
        As for smoothing.
    whole : bool
        Whether the whole mesh is shown, or only twice as far around as the kernel reaches.
    progress : callable, optional
        Of the iterations before.
    access : Access
        What may be read, for guides.

    Returns
    -------
    KernelStudy

    Raises
    ------
    UsageError, InputError
        If the place names no vertex.
    """
    painted = with_surface(document.painted(), settings)
    vertex = place.vertex_among(painted.positions, document.name)
    prepared = prepare(painted, settings, vertex_guides(document, settings, access))
    flow, sampling = prepared.flow(settings), prepared.sampling
    shown = Shown(tuple(painted.channels[i] for i in prepared.channels.taking_part), settings.space)
    flow.run(progress)
    shades = shown.shades(flow.values())
    kernel = flow.kernel_at(int(sampling.sample_of[vertex]))
    vertices = sampling.first_vertex[kernel.samples]
    facts = {
        "at": f"vertex {vertex}",
        "position": painted.positions[vertex].tolist(),
        "cut_short": len(kernel.samples) == settings.kernel.max_samples,
    }
    columns = {"vertex": vertices, **dict(zip("xyz", painted.positions[vertices].T, strict=True))}
    return KernelStudy(
        {**facts, **describe(kernel, shown, settings.kernel, flow.beta)},
        {**columns, **table(kernel, shown)},
        settings.kernel.radius,
        _view(painted, sampling, kernel, shades, whole=whole),
    )


def _view(
    painted: PaintedVertices,
    sampling: VertexSampling,
    kernel: SampledKernel,
    shades: NDArray[np.float32],
    *,
    whole: bool,
) -> MeshView:
    distances = np.full(len(shades), np.nan, np.float32)
    weights = np.zeros(len(shades), np.float32)
    distances[kernel.samples], weights[kernel.samples] = kernel.distances, kernel.weights
    of = sampling.sample_of
    view = MeshView(painted.positions, painted.faces, shades[of], distances[of], weights[of])
    if whole:
        return view
    places = sampling.place_of[of]
    near = np.zeros(sampling.places, bool)
    near[sampling.place_of[kernel.samples[0]]] = True
    held = np.zeros(sampling.places, bool)
    held[sampling.place_of[kernel.samples]] = True
    return _cut(view, _surroundings(places[painted.faces], near, held)[places])


def _surroundings(
    faces: NDArray[np.int32], near: NDArray[np.bool_], held: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Spread over triangles until all that is held is near, and as often again."""
    steps = 0
    while not near[held].all():
        near, before = _spread(faces, near), near
        steps += 1
        if (near == before).all():  # the rest is reached over edges that are in no triangle
            near = near | held
    for _ in range(steps + 2):
        near = _spread(faces, near)
    return near


def _spread(faces: NDArray[np.int32], near: NDArray[np.bool_]) -> NDArray[np.bool_]:
    wider = near.copy()
    wider[faces[near[faces].any(axis=1)]] = True
    return wider


def _cut(view: MeshView, kept: NDArray[np.bool_]) -> MeshView:
    """Keep some of the vertices, and the triangles between them."""
    number = np.cumsum(kept, dtype=np.int32) - 1
    faces = number[view.faces[kept[view.faces].all(axis=1)]]
    parts = {
        field.name: getattr(view, field.name)[kept]
        for field in dataclasses.fields(view)
        if field.name != "faces"
    }
    return MeshView(faces=faces, **parts)
