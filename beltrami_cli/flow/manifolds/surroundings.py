"""Neighbours of samples on both kinds of surfaces, among which outliers are found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Float32s, Indices, Int64s
from beltrami_cli.flow.manifolds.mesh_geometry import MeshGeometry
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import EMPTY, HALO, OWNED, Atlas
from beltrami_cli.surface.grid_atlas import STEPS, ends_of
from beltrami_cli.surface.incidence import Neighbours


@dataclass(frozen=True)
class CanvasSurroundings:
    """The owned cells of a canvas and their neighbours; halo cells stand for the owned cells they show."""

    atlas: Atlas

    @property
    def samples(self) -> Indices:
        return self.atlas.owned_cells

    def around(self, samples: Indices, reach: int) -> Int64s:
        """Return the owned cells within `reach` rows and columns of each cell, shape (B, W), padded by -1."""
        atlas, steps = self.atlas, np.arange(-reach, reach + 1)
        cell = np.asarray(samples, np.int64)[:, None]
        offsets = (steps[:, None] * atlas.kind.shape[1] + steps).reshape(-1)
        cells: Int64s = cell + offsets[offsets != 0]
        kind = atlas.kind.reshape(-1).take(cells, mode="clip")
        if len(atlas.halo.cells):
            halo = kind == HALO
            cells[halo] = atlas.halo.nearest[np.searchsorted(atlas.halo.cells, cells[halo])]
        cells[(kind == EMPTY) | (cells == cell)] = -1
        return cells

    def standing_out(self, planes: Float32s, least: Float32s) -> Indices:
        """Return the owned cells that differ from five of eight neighbours by more than `least` in a channel."""
        kind, found = self.atlas.kind, [np.zeros(0, np.int64)]
        for rows in large_arrays.blocks(len(kind), max(1, large_arrays.CACHED // kind.shape[1])):
            around, stands_out = slice(max(0, rows.start - 1), rows.stop + 1), np.zeros(1, bool)
            for plane, enough in zip(planes[:, around], least, strict=True):
                count = np.zeros(plane.shape, np.uint8)
                for step in STEPS:
                    here, there = ends_of(step)
                    differ = np.abs(plane[here] - plane[there]) > enough
                    count[here] += differ
                    count[there] += differ
                stands_out = stands_out | (count > 4)
            inside = stands_out[rows.start - around.start :][: rows.stop - rows.start]
            found.append(np.flatnonzero(inside & (kind[rows] == OWNED)) + rows.start * kind.shape[1])
        return np.concatenate(found)


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
