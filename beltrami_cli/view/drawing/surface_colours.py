"""Colours of surfaces at points of their triangles: interpolated between vertices, or looked up in textures.

Textures are averaged where they are seen from afar, by L. Williams, "Pyramidal parametrics", SIGGRAPH 1983,
doi:10.1145/800059.801126.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s, Int32s
from beltrami_cli.surface.lookups import look_up
from beltrami_cli.surface.records import TexturedSurface, Wrap
from beltrami_cli.view.light import LinearPixels

_MAX_EXACT_TEXEL = 1 << 13  # texels from the origin up to which single precision is sufficient
_UNTEXTURED = 0.32  # linear light of a middle grey


class InterpolatedColours:
    """Linear light at vertices, (V, 3), interpolated between them."""

    is_opaque = True  # whether the surface hides everything behind it

    def __init__(self, faces: Int32s, colours: Float64s) -> None:
        self._corners = colours.astype(np.float32)[faces]

    def __call__(self, faces: Int32s, weights: Float32s, footprints: Float64s) -> Float32s:
        """Return light times opacity, and opacity, (K, 4), at points of faces with barycentric weights, (K, 3)."""
        mixed = np.ones((len(faces), 4), np.float32)
        mixed[:, :3] = _interpolated(self._corners, faces, weights)
        return mixed


class TextureColours:
    """Textures with bilinear interpolation, and smaller copies for points that cover several texels."""

    def __init__(self, surface: TexturedSurface, images: Sequence[LinearPixels], areas: Float64s) -> None:
        self._surface = surface
        for image, texture in zip(images, surface.textures, strict=True):
            if not texture.alpha_hides:
                image[..., 3] = 1
        self._pyramids = [Pyramid(image) for image in images]
        first, second = (surface.uv[:, k] - surface.uv[:, 0] for k in (1, 2))
        covered = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / 2
        sizes = np.array([0, *(image.shape[0] * image.shape[1] for image in images)], float)
        texels = covered * sizes[surface.texture_of + 1]
        with np.errstate(over="ignore"):
            self._density = np.divide(texels, areas, out=np.zeros_like(areas), where=areas > 0)
        # As many bits as are needed to resolve parts of a texel.
        largest = np.abs(surface.uv).max(initial=0) * max((max(image.shape) for image in images), default=1)
        self._uv = surface.uv.astype(np.float32) if largest < _MAX_EXACT_TEXEL else surface.uv
        self.is_opaque = all(pyramid.is_opaque for pyramid in self._pyramids)

    def __call__(self, faces: Int32s, weights: Float32s, footprints: Float64s) -> Float32s:
        colours = np.full((len(faces), 4), _UNTEXTURED, np.float32)
        colours[:, 3] = 1
        of, uv = self._surface.texture_of[faces], _interpolated(self._uv, faces, weights)
        texels = footprints * self._density[faces]
        for number, texture in enumerate(self._surface.textures):
            mine = np.flatnonzero(of == number)
            colours[mine] = self._pyramids[number].look_up(uv[mine], texture.wrap, texels[mine])
        return colours


SurfaceColours = InterpolatedColours | TextureColours


class Pyramid:
    """An image, and its copies of half the size down to a single texel, which are made when they are needed.

    Colours are multiplied by the opacity, in place, so that transparent texels do not count in averages.
    """

    def __init__(self, image: LinearPixels) -> None:
        self.is_opaque = bool((image[..., 3] == 1).all())
        if not self.is_opaque:
            image[..., :3] *= image[..., 3:]
        self._levels = [np.ascontiguousarray(image)]
        self._last = int(np.ceil(np.log2(max(image.shape[:2]))))

    def look_up(self, uv: Float64s, wrap: tuple[Wrap, Wrap], texels: Float64s) -> Float32s:
        """Interpolate at places, (K, 2), v down, that stand for areas of `texels`, (K,), of the first level; (K, 4)."""
        at = np.clip(np.log2(np.maximum(texels, 1)) / 2, 0, self._last)
        lower = at.astype(np.int64)
        part = (at - lower).astype(np.float32)[:, None]
        colours = np.empty((len(uv), 4), np.float32)
        for number in range(int(lower.min(initial=self._last)), int(lower.max(initial=-1)) + 1):
            mine = np.flatnonzero(lower == number)
            colours[mine] = look_up(self._level(number), uv[mine], wrap, precision=np.float32)
            between = mine[part[mine, 0] > 0]
            if len(between):  # blended with the next smaller copy
                smaller = look_up(self._level(number + 1), uv[between], wrap, precision=np.float32)
                colours[between] += part[between] * (smaller - colours[between])
        return colours

    def _level(self, number: int) -> LinearPixels:
        while len(self._levels) <= number:
            last = self._levels[-1]
            # The last of an odd number of texels is counted twice.
            even = np.pad(last, [(0, side % 2) for side in last.shape[:2]] + [(0, 0)], mode="edge")
            four = [even[row::2, column::2] for row in (0, 1) for column in (0, 1)]
            self._levels.append(np.asarray((four[0] + four[1] + four[2] + four[3]) / 4, np.float32))
        return self._levels[number]


def _interpolated(corners: Array, faces: Int32s, weights: Float32s) -> Array:
    """Interpolate numbers at the corners of all faces, (F, 3, X), at points of some of them; (K, X)."""
    three = corners.take(faces, axis=0)
    return three[:, 0] * weights[:, :1] + three[:, 1] * weights[:, 1:2] + three[:, 2] * weights[:, 2:]
