"""Which textures of a surface a user means."""

from __future__ import annotations

import dataclasses
from fnmatch import fnmatch
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from beltrami_cli.samples.settings import TextureSettings
    from beltrami_cli.surface.records import Texture, TexturedSurface


def choose_textures(surface: TexturedSurface, wanted: TextureSettings) -> TexturedSurface:
    """Keep the textures that the globs choose, which may be none."""

    def fits(texture: Texture) -> bool:
        by_name = not wanted.names or any(fnmatch(texture.name, glob) for glob in wanted.names)
        by_material = not wanted.materials or any(
            fnmatch(material, glob) for material in texture.materials for glob in wanted.materials
        )
        return by_name and by_material

    return only_textures(surface, [i for i, texture in enumerate(surface.textures) if fits(texture)])


def only_textures(surface: TexturedSurface, kept: list[int]) -> TexturedSurface:
    """Keep the textures of these indices; triangles of the others have none."""
    new_index = np.full(len(surface.textures) + 1, -1, np.int32)
    new_index[kept] = np.arange(len(kept), dtype=np.int32)
    return dataclasses.replace(
        surface,
        textures=tuple(surface.textures[index] for index in kept),
        texture_of=new_index[surface.texture_of],
    )
