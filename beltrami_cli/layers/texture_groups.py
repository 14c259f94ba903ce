"""Textures of a slot that are smoothed together, and apart from others.

Textures that touch each other nowhere on the surface have noise and parameters of their own: the fibres of a carpet are
no noise of a plain wall, and parameters that suit wood smooth the wall too little.
"""

from __future__ import annotations

import numpy as np

from beltrami_cli.arrays import Float64s, Int64s
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.image.reading import measure_image
from beltrami_cli.layers.texel_colours import only_textures
from beltrami_cli.surface.grouping import group_places
from beltrami_cli.surface.records import TexturedSurface

# Covered texels by which noise and parameters are found well; parts of a surface with fewer are put together.
_ENOUGH_TEXELS = 1 << 16


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

    # A graph of textures and of the edges of their triangles.
    place_of, first = group_places(surface.positions, surface.space_of, surface.faces)
    faces = np.flatnonzero(surface.texture_of >= 0)
    places = place_of[surface.faces[faces]]
    pairs = np.sort(np.stack([places, np.roll(places, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    keys, edge = np.unique(pairs[:, 0].astype(np.int64) * len(first) + pairs[:, 1], return_inverse=True)
    count = len(surface.textures)
    at, size = (count + edge, np.repeat(surface.texture_of[faces], 3)), count + len(keys)
    met = coo_array((np.ones(len(edge), bool), at), shape=(size, size))
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
