"""Regions of a mesh: sums over its samples, and means over their neighbours."""

from __future__ import annotations

import math

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s
from beltrami_cli.flow.manifolds.domain import Regions
from beltrami_cli.flow.manifolds.mesh.geometry import MeshGeometry
from beltrami_cli.flow.mesh_gaussian import PASS_SCALE, PASS_VARIANCE, MeshGaussian


class SingleSamples(Regions):
    """The samples of a mesh; the mean of each is its own value."""

    width, noise_ratio, side = 4.0, 1.0, 1

    def __init__(self, mesh: MeshGeometry) -> None:
        self._mesh = mesh

    @property
    def shape(self) -> tuple[int, ...]:
        return self._mesh.shape

    def means_of_rows(self, planes: Float32s, rows: slice) -> tuple[slice, Float32s]:
        return rows, planes

    def enlarged(self, planes: Float32s, rows: slice) -> Float32s:
        return planes[:, rows]

    def total(self, planes: Float32s) -> Float64s:
        return np.asarray(planes.sum(axis=1, dtype=np.float64))

    def spread(self, planes: Float32s) -> Float32s:
        """Average planes over the surface, in passes over the neighbours of each sample."""
        mesh = self._mesh
        means = MeshGaussian.of(
            mesh.size, mesh.edges, mesh.lengths, PASS_SCALE, gain=1.0, threads=mesh.threads
        )
        rows = np.ascontiguousarray(planes.T)
        for _ in range(math.ceil(self.width**2 / PASS_VARIANCE)):
            rows = means.smooth(rows)
        return np.ascontiguousarray(rows.T)
