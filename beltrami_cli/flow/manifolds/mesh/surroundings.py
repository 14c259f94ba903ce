"""Neighbours of the samples of a mesh, among which outliers are found."""

from __future__ import annotations

import numpy as np

from beltrami_cli.arrays import Float32s, Indices, Int64s
from beltrami_cli.flow.manifolds.mesh.geometry import MeshGeometry
from beltrami_cli.surface.incidence import Neighbours


class MeshSurroundings:
    """The samples of a mesh and their neighbours; at hubs, only the first neighbours."""

    _MOST = 8  # neighbours of one sample: regular meshes have six

    def __init__(self, mesh: MeshGeometry) -> None:
        self.samples: Indices = np.arange(mesh.size)
        self._edges = mesh.edges
        self._neighbours = Neighbours(mesh.size, mesh.edges, mesh.scaled_lengths)

    def around(self, samples: Indices, reach: int) -> Int64s:
        """Return the samples within `reach` edges of each sample, shape (B, W), once per path to them."""
        near = self._neighbours.first(samples, self._MOST)
        if reach == 1:
            return near
        further = self._neighbours.first(np.maximum(near, 0).reshape(-1), self._MOST)
        further = np.where(near[..., None] >= 0, further.reshape(*near.shape, -1), -1).reshape(len(near), -1)
        further[further == np.asarray(samples)[:, None]] = -1
        return np.concatenate([near, further], axis=1)

    def standing_out(self, planes: Float32s, least: Float32s) -> Indices:
        """Return the samples that differ from most neighbours by more than `least` in a channel."""
        size, stands_out = len(self.samples), np.zeros(len(self.samples), bool)
        degrees = np.bincount(self._edges.reshape(-1), minlength=size)
        for plane, enough in zip(planes, least, strict=True):
            differ = np.abs(np.subtract(*plane[self._edges.T])) > enough
            stands_out |= 2 * np.bincount(self._edges[differ].reshape(-1), minlength=size) > degrees
        return np.flatnonzero(stands_out)
