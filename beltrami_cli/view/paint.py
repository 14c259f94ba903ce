"""What surfaces are painted with: colours in linear light at any point of their triangles.

Textures are averaged where they are seen from afar, by L. Williams, "Pyramidal parametrics", SIGGRAPH 1983,
doi:10.1145/800059.801126.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s, Int32s
from beltrami_cli.surface.baking import look_up
from beltrami_cli.surface.records import TexturedSurface, Wrap

Sheet = Float32s
"""An image in linear light with opacity, shape (H, W, 4); colours are not multiplied by it."""

_EXACT = 1 << 13  # texels from the origin up to which single precision does
_UNPAINTED = 0.32  # linear light of a middle grey


class VertexPaint:
    """Linear light at vertices, (V, 3), interpolated between them."""

    is_opaque = True  # whether nothing behind the surface can be seen through it
    is_linear = True  # whether colours change steadily across each triangle

    def __init__(self, faces: Int32s, colours: Float64s) -> None:
        self._corners = colours.astype(np.float32)[faces]

    def __call__(self, faces: Int32s, weights: Float32s, footprints: Float64s) -> Float32s:
        """Return linear red, green, blue and opacity, (K, 4), at points of faces with barycentric weights, (K, 3)."""
        mixed = np.ones((len(faces), 4), np.float32)
        mixed[:, :3] = _interpolated(self._corners, faces, weights)
        return mixed


class TexturePaint:
    """Textures, looked up bilinearly; in smaller copies of themselves where a point stands for several texels."""

    is_linear = False

    def __init__(self, surface: TexturedSurface, sheets: Sequence[Sheet], areas: Float64s) -> None:
        self._surface = surface
        self._pyramids = [Pyramid(sheet) for sheet in sheets]
        first, second = (surface.uv[:, k] - surface.uv[:, 0] for k in (1, 2))
        covered = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / 2
        sizes = np.array([0, *(sheet.shape[0] * sheet.shape[1] for sheet in sheets)], float)
        texels = covered * sizes[surface.texture_of + 1]
        with np.errstate(over="ignore"):
            self._density = np.divide(texels, areas, out=np.zeros_like(areas), where=areas > 0)
        # As many bits as are needed to resolve parts of a texel.
        largest = np.abs(surface.uv).max(initial=0) * max((max(sheet.shape) for sheet in sheets), default=1)
        self._uv = surface.uv.astype(np.float32) if largest < _EXACT else surface.uv
        self._is_one = len(sheets) == 1 and bool((surface.texture_of == 0).all())
        self.is_opaque = all(
            pyramid.is_opaque or not texture.alpha_hides
            for pyramid, texture in zip(self._pyramids, surface.textures, strict=True)
        )

    def __call__(self, faces: Int32s, weights: Float32s, footprints: Float64s) -> Float32s:
        if self._is_one:
            return self._looked_up(0, faces, weights, footprints)
        colours = np.full((len(faces), 4), _UNPAINTED, np.float32)
        colours[:, 3] = 1
        of = self._surface.texture_of[faces]
        for number in range(len(self._pyramids)):
            mine = np.flatnonzero(of == number)
            if len(mine):
                colours[mine] = self._looked_up(number, faces[mine], weights[mine], footprints[mine])
        return colours

    def _looked_up(self, number: int, faces: Int32s, weights: Float32s, footprints: Float64s) -> Float32s:
        texture = self._surface.textures[number]
        uv = _interpolated(self._uv, faces, weights)
        found = self._pyramids[number].look_up(uv, texture.wrap, footprints * self._density[faces])
        if not texture.alpha_hides:
            found[:, 3] = 1
        return found


Paint = VertexPaint | TexturePaint


class Pyramid:
    """An image, and its copies of half the size down to a single texel, which are made when they are needed."""

    def __init__(self, sheet: Sheet) -> None:
        self._levels = [np.ascontiguousarray(sheet)]
        self._last = int(np.ceil(np.log2(max(sheet.shape[:2]))))
        self.shape = sheet.shape
        self.is_opaque = bool((sheet[..., 3] == 1).all())

    def level(self, number: int) -> Sheet:
        """Return a copy; the first is the image itself."""
        while len(self._levels) <= number:
            self._levels.append(_halved(self._levels[-1], is_opaque=self.is_opaque))
        return self._levels[number]

    def look_up(self, uv: Float64s, wrap: tuple[Wrap, Wrap], texels: Float64s) -> Float32s:
        """Interpolate at places, (K, 2), v down, that stand for areas of `texels`, (K,), of the first level; (K, 4)."""
        if not texels.size or texels.max() <= 1:
            return look_up(self.level(0), uv, wrap, None if self.is_opaque else 3, np.float32)
        at = np.clip(np.log2(np.maximum(texels, 1)) / 2, 0, self._last)
        lower = at.astype(np.int64)
        part = (at - lower).astype(np.float32)
        first, last = int(lower.min()), int(lower.max())
        if first == last:
            return self._between(first, uv, wrap, part)
        colours = np.empty((len(uv), 4), np.float32)
        for number in range(first, last + 1):
            mine = np.flatnonzero(lower == number)
            if len(mine):
                colours[mine] = self._between(number, uv[mine], wrap, part[mine])
        return colours

    def _between(self, number: int, uv: Float64s, wrap: tuple[Wrap, Wrap], part: Float32s) -> Float32s:
        """Interpolate in a copy and, to a part, in the next smaller one."""
        alpha = None if self.is_opaque else 3
        colours = look_up(self.level(number), uv, wrap, alpha, np.float32)
        if part.any():
            smaller = look_up(self.level(number + 1), uv, wrap, alpha, np.float32)
            smaller -= colours
            smaller *= part[:, None]
            colours += smaller
        return colours


def _interpolated(corners: Array, faces: Int32s, weights: Float32s) -> Array:
    """Interpolate numbers at the corners of all faces, (F, 3, X), at points of some of them; (K, X)."""
    three = corners.take(faces, axis=0)
    return three[:, 0] * weights[:, :1] + three[:, 1] * weights[:, 1:2] + three[:, 2] * weights[:, 2:]


def _halved(sheet: Sheet, *, is_opaque: bool) -> Sheet:
    """Average two by two texels, by their opacity; the last of an odd number is counted twice."""
    odd = sheet.shape[0] % 2, sheet.shape[1] % 2
    padded = np.pad(sheet, [(0, odd[0]), (0, odd[1]), (0, 0)], mode="edge") if any(odd) else sheet
    four = [padded[row::2, column::2] for row in (0, 1) for column in (0, 1)]
    if is_opaque:
        return np.asarray((four[0] + four[1] + four[2] + four[3]) / 4, np.float32)
    stack = np.stack(four)
    opacity = stack[..., 3:].mean(axis=0)
    weighted = (stack[..., :3] * stack[..., 3:]).mean(axis=0)
    colours = np.divide(weighted, opacity, out=stack[..., :3].mean(axis=0), where=opacity > 0)
    return np.concatenate([colours, opacity], axis=2)
