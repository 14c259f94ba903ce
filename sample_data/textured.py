"""The record of a textured sample mesh, and the noise that is put on its images."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from samples import NOISE

if TYPE_CHECKING:
    from numpy.typing import NDArray

Kind = Literal["png8", "png16", "jpeg", "exr"]


@dataclass(frozen=True)
class Texture:
    """An image on a surface, before it is rounded and encoded.

    Attributes
    ----------
    name : str
        Of the material and, where a model has several images, in the file's name.
    pixels : ndarray of float64, shape (H, W, C)
        sRGB display values, 1 to 3 channels; in [0, 1], but for "exr", which is encoded as linear light.
    filled : ndarray of bool, shape (H, W)
        Texels that a triangle covers, and the gutters about them. The others are background.
    kind : {"png8", "png16", "jpeg", "exr"}
        How it is stored.
    """

    name: str
    pixels: NDArray[np.float64]
    filled: NDArray[np.bool_]
    kind: Kind


@dataclass(frozen=True)
class TexturedSample:
    """A small textured mesh of triangles.

    Attributes
    ----------
    positions : ndarray of float64, shape (V, 3)
        As in `Sample`. A vertex at a seam is one vertex.
    coordinates : ndarray of float64, shape (N, 2)
        Texture coordinates: u to the right, v down, (0, 0) the image's upper left corner; rounded to 1e-6.
    vertices, corners : ndarray of int64, shape (F, 3)
        Rows of `positions` and of `coordinates`. A row of coordinates belongs to one vertex.
    material_of : ndarray of int64, shape (F,)
        Index into `textures`, ascending.
    textures : tuple of Texture
        One for each material.
    """

    positions: NDArray[np.float64]
    coordinates: NDArray[np.float64]
    vertices: NDArray[np.int64]
    corners: NDArray[np.int64]
    material_of: NDArray[np.int64]
    textures: tuple[Texture, ...]


def noisy(sample: TexturedSample, seed: int) -> TexturedSample:
    """Add independent Gaussian noise of standard deviation 20/255 to each channel of all texels but the background.

    It is added to the sRGB values, of covered texels and of gutters, as if each image had been taken by a
    camera; the two sides of a seam get noise of their own.
    """
    random = np.random.Generator(np.random.PCG64(seed))
    textures = []
    for texture in sample.textures:
        noise = random.standard_normal(texture.pixels.shape) * NOISE
        pixels = texture.pixels + np.where(texture.filled[:, :, None], noise, 0)
        textures.append(replace(texture, pixels=pixels))
    return replace(sample, textures=tuple(textures))
