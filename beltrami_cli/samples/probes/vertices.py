"""Kernels on the vertices of a mesh or a point cloud."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.samples.probes.probe import MeshView, Probe

if TYPE_CHECKING:
    from beltrami_cli.arrays import Array, Bools, Int32s, Int64s
    from beltrami_cli.flow.beltrami_flow import BeltramiFlow
    from beltrami_cli.flow.mesh_manifold import MeshManifold
    from beltrami_cli.flow.records import SampledKernel
    from beltrami_cli.samples.probes.probe import Location
    from beltrami_cli.surface.grouping import VertexSampling
    from beltrami_cli.surface.records import PaintedVertices


@dataclass
class VertexProbe(Probe):
    """Painted vertices; `whole`: the whole mesh is shown, not only twice as far around as the kernel reaches."""

    flow: BeltramiFlow[MeshManifold]
    painted: PaintedVertices
    sampling: VertexSampling
    name: str
    whole: bool

    def find(self, location: Location) -> tuple[int, dict[str, object]]:
        vertex = location.vertex_among(self.painted.positions, self.name)
        facts = {"at": f"vertex {vertex}", "position": self.painted.positions[vertex].tolist()}
        return int(self.sampling.sample_of[vertex]), facts

    def facts(self, kernel: SampledKernel) -> dict[str, object]:
        return {"cut_short": len(kernel.samples) == self.flow.parameters.max_samples}

    def columns(self, samples: Int64s) -> dict[str, Array]:
        vertices = self.sampling.first_vertex[samples]
        return {"vertex": vertices, **dict(zip("xyz", self.painted.positions[vertices].T, strict=True))}

    def view(self, kernel: SampledKernel) -> MeshView:
        shades = self.colours.shades(self.flow.values())
        distances = np.full(len(shades), np.nan, np.float32)
        weights = np.zeros(len(shades), np.float32)
        distances[kernel.samples], weights[kernel.samples] = kernel.distances, kernel.weights
        painted, sampling = self.painted, self.sampling
        of = sampling.sample_of
        view = MeshView(painted.positions, painted.faces, shades[of], distances[of], weights[of])
        if self.whole:
            return view
        places = sampling.place_of[of]
        near = np.zeros(sampling.places, bool)
        near[sampling.place_of[kernel.samples[0]]] = True
        held = np.zeros(sampling.places, bool)
        held[sampling.place_of[kernel.samples]] = True
        return _cut(view, _surroundings(places[painted.faces], near, held)[places])


def _surroundings(faces: Int32s, near: Bools, held: Bools) -> Bools:
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


def _spread(faces: Int32s, near: Bools) -> Bools:
    wider = near.copy()
    wider[faces[near[faces].any(axis=1)]] = True
    return wider


def _cut(view: MeshView, kept: Bools) -> MeshView:
    """Keep some of the vertices, and the triangles between them."""
    number = np.cumsum(kept, dtype=np.int32) - 1
    faces = number[view.faces[kept[view.faces].all(axis=1)]]
    fields = [field.name for field in dataclasses.fields(view) if field.name != "faces"]
    return MeshView(faces=faces, **{name: getattr(view, name)[kept] for name in fields})
