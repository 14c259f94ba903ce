"""Which textures of a surface are selected, and which of them are smoothed together.

Textures that touch nowhere on the surface get separate noise and parameters. The fibres of a carpet are not noise of a
plain wall, and parameters that suit wood smooth the wall too little.
"""

from __future__ import annotations

import dataclasses
from fnmatch import fnmatch

import numpy as np

from beltrami_cli.arrays import Float64s, Int32s
from beltrami_cli.formats.image.sizes import measure_image
from beltrami_cli.layers.settings import TextureSettings
from beltrami_cli.surface.grouping import connected, group_places
from beltrami_cli.surface.records import Texture, TexturedSurface


def choose_textures(surface: TexturedSurface, wanted: TextureSettings) -> TexturedSurface:
    """Select the textures that match the globs, possibly none."""

    def fits(texture: Texture) -> bool:
        by_name = not wanted.names or any(fnmatch(texture.name, glob) for glob in wanted.names)
        by_material = not wanted.materials or any(
            fnmatch(material, glob) for material in texture.materials for glob in wanted.materials
        )
        return by_name and by_material

    return only_textures(surface, [i for i, texture in enumerate(surface.textures) if fits(texture)])


def only_textures(surface: TexturedSurface, kept: list[int]) -> TexturedSurface:
    """Select textures by index; triangles of the others have none."""
    new_index = np.full(len(surface.textures) + 1, -1, np.int32)
    new_index[kept] = np.arange(len(kept), dtype=np.int32)
    textures = tuple(surface.textures[index] for index in kept)
    return dataclasses.replace(surface, textures=textures, texture_of=new_index[surface.texture_of])


# Covered texels that suffice to estimate noise and parameters; smaller parts of a surface are combined.
_SUFFICIENT_TEXELS = 1 << 16


def separate_surfaces(surface: TexturedSurface) -> list[TexturedSurface]:
    """Split the textures of a surface into groups that touch."""
    if len(surface.textures) < 2:
        return [surface]
    parts = _large_parts(_touching(surface), covered_texels(surface))
    return [only_textures(surface, part) for part in parts] if len(parts) > 1 else [surface]


def covered_texels(surface: TexturedSurface) -> Float64s:
    """Estimate how many texels of each texture are covered by triangles, without decoding it."""
    sizes = [measure_image(texture.data, texture.name) for texture in surface.textures]
    # An image whose size cannot be read counts as 0; its decoder raises the error later. The last 0 stands for
    # triangles without a texture.
    texels = np.array([0 if size is None else size.texels for size in sizes] + [0], np.float64)
    (a, b), (c, d) = np.moveaxis(np.diff(surface.uv, axis=1), 0, 2)
    areas = np.nan_to_num(np.abs(a * d - b * c) / 2)
    areas = np.bincount(surface.texture_of % len(texels), areas, len(texels))
    return np.asarray((texels * np.minimum(areas, 1))[:-1], np.float64)


def _touching(surface: TexturedSurface) -> Int32s:
    """Return a group number for each texture, shape (T,), equal if a path over the surface connects two textures."""
    # A graph of textures and of the edges of their triangles.
    place_of, first = group_places(surface.positions, surface.space_of, surface.faces)
    faces = np.flatnonzero(surface.texture_of >= 0)
    places = place_of[surface.faces[faces]]
    pairs = np.sort(np.stack([places, np.roll(places, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    keys, edge = np.unique(pairs[:, 0].astype(np.int64) * len(first) + pairs[:, 1], return_inverse=True)
    count = len(surface.textures)
    shown = np.column_stack([count + edge, np.repeat(surface.texture_of[faces], 3)])
    return connected(count + len(keys), shown)[:count]


def _large_parts(part_of: Int32s, covered: Float64s) -> list[list[int]]:
    """Return the textures of each group, in order; groups with few texels are combined, or join the largest."""
    texels = np.bincount(part_of, covered)
    small = texels < _SUFFICIENT_TEXELS
    if texels[small].sum() < _SUFFICIENT_TEXELS:
        small[texels.argmax()] |= small.any()
    number = np.where(small, len(texels), np.arange(len(texels)))[part_of]
    parts = [np.flatnonzero(number == each).tolist() for each in np.unique(number)]
    return sorted(parts)
