"""Textures of a slot that are smoothed together, and apart from others.

Textures that touch each other nowhere on the surface have noise and parameters of their own: the fibres of a carpet are
no noise of a plain wall, and parameters that suit wood smooth the wall too little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from beltrami_cli.arrays import Float64s, Int64s
from beltrami_cli.flow.grid_manifold import Whole
from beltrami_cli.flow.noise.model import NoiseModel
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.image.reading import measure_image
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.layers.texel_colours import only_textures
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import Atlas, texels_by_texture
from beltrami_cli.surface.grouping import group_places
from beltrami_cli.surface.records import TexturedSurface

# Covered texels by which noise and parameters are found well; parts of a surface with fewer are put together.
_ENOUGH_TEXELS = 1 << 16


@dataclass(frozen=True)
class TextureGroup:
    """Textures that are smoothed together, and the triangles around them, which are only looked at."""

    label: str
    surface: TexturedSurface
    own: frozenset[str]  # keys of the textures that are written back
    common: Common

    def counts(self, atlas: Atlas, own: Sequence[int]) -> dict[str, int]:
        """Return how many charts and texels are of its own textures, given by their numbers; nothing, if all are."""
        if len(own) == len(atlas.texture_offsets) - 1:
            return {}
        charts, covered = set[int](), 0
        for block in large_arrays.blocks(len(atlas.owned_texels)):
            texels = atlas.owned_texels[block]
            for index, inside, there in texels_by_texture(atlas.texture_offsets, texels):
                if index in own:
                    charts |= {*np.unique(atlas.chart_of[block][inside]).tolist()}
                    covered += len(there)
        return {"charts": len(charts), "covered": covered}


@dataclass(frozen=True)
class Common:
    """Shared by all groups: the settings, the unit of length, and the noise, if it is one for all."""

    settings: SmoothSettings
    unit: float
    noise: NoiseModel | None
    names: tuple[str, ...]  # the channels that it is the noise of
    described: dict[str, Any] = field(default_factory=dict)  # by the names of the fields of reports

    def whole(self, names: tuple[str, ...]) -> Whole:
        """Return what a group of these channels takes: not the noise, if it is grey alone and others are not."""
        return Whole(self.unit, self.noise if names == self.names else None)


def separate_surfaces(surface: TexturedSurface, kernel: KernelParameters) -> list[TexturedSurface]:
    """Part textures so that those which touch are together; one part, if nothing is chosen from the colours."""
    if len(surface.textures) < 2 or not kernel.is_open:
        return [surface]
    covered = np.array([_covered(surface, index) for index in range(len(surface.textures))])
    parts = _large_parts(_touching(surface), covered)
    return [only_textures(surface, part) for part in parts] if len(parts) > 1 else [surface]


def _covered(surface: TexturedSurface, index: int) -> float:
    """Return about how many texels of a texture triangles cover, without decoding it."""
    texture = surface.textures[index]
    size = measure_image(texture.data, texture.name)
    if size is None:  # its decoder raises the error
        return 0.0
    u, v = np.moveaxis(np.diff(surface.uv[surface.texture_of == index], axis=1), 1, 0)
    area = float(np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum()) / 2
    return size.texels * min(1.0, area)


def _touching(surface: TexturedSurface) -> Int64s:
    """Give textures the same number where a path over the surface joins them, shape (T,)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    borders, count = Borders.of(surface), len(surface.textures)
    edges, row = np.unique(borders.edge, return_inverse=True)
    at = (count + row, borders.texture)
    size = count + len(edges)
    met = coo_array((np.ones(len(row), bool), at), shape=(size, size))
    numbers: Int64s = connected_components(met, directed=False)[1][:count].astype(np.int64)
    return numbers


def _large_parts(part_of: Int64s, covered: Float64s) -> list[list[int]]:
    """Return the textures of each part, in their order; parts of few texels are one, or join the largest."""
    texels = np.bincount(part_of, covered)
    small = texels < _ENOUGH_TEXELS
    if texels[small].sum() < _ENOUGH_TEXELS:
        small[texels.argmax()] |= small.any()
    number = np.where(small, len(texels), np.arange(len(texels)))[part_of]
    parts = [np.flatnonzero(number == each).tolist() for each in np.unique(number)]
    return sorted(parts)


@dataclass(frozen=True)
class Borders:
    """Edges at which triangles of several textures meet, a row for each triangle there."""

    edge: Int64s  # number of the edge, ascending
    texture: Int64s
    ends: Int64s  # rows of positions, shape (E, 2)

    @classmethod
    def of(cls, surface: TexturedSurface) -> Borders:
        place_of, first = group_places(surface.positions, surface.space_of, surface.faces)
        faces = np.flatnonzero(surface.texture_of >= 0)
        places = place_of[surface.faces[faces]]
        pairs = np.sort(np.stack([places, np.roll(places, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
        keys, number = np.unique(pairs[:, 0].astype(np.int64) * len(first) + pairs[:, 1], return_inverse=True)
        texture = np.repeat(surface.texture_of[faces], 3).astype(np.int64)
        low, high = np.full(len(keys), len(surface.textures)), np.full(len(keys), -1)
        np.minimum.at(low, number, texture)
        np.maximum.at(high, number, texture)
        rows = np.flatnonzero((low != high)[number])
        rows = rows[np.argsort(number[rows], kind="stable")]
        return cls(number[rows], texture[rows], first[pairs[rows]].astype(np.int64))
