"""Neighbours of the cells of a canvas, among which outliers are found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Float32s, Indices, Int64s
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import EMPTY, HALO, OWNED, Atlas
from beltrami_cli.surface.grid_atlas import STEPS, ends_of


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
