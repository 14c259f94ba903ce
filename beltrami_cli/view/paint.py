"""What surfaces are painted with: colours in linear light at any point of their triangles.

Textures are averaged where they are seen from afar, by L. Williams, "Pyramidal parametrics", SIGGRAPH 1983,
doi:10.1145/800059.801126.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from beltrami_cli.surface.lookup import look_up

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from beltrami_cli.surface.records import TexturedSurface, Wrap

    Sheet = NDArray[np.float32]
    """An image in linear light with opacity, shape (H, W, 4); colours are not multiplied by it."""

_UNPAINTED = 0.32  # linear light of a middle grey


class Paint(Protocol):
    """The colours of a surface."""

    def __call__(
        self, faces: NDArray[np.int64], weights: NDArray[np.float64], footprints: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return linear red, green, blue and opacity, (K, 4), at points of faces with barycentric weights, (K, 3)."""
        ...


class VertexPaint:
    """Linear light at vertices, (V, 3), interpolated between them."""

    def __init__(self, faces: NDArray[np.int32], colours: NDArray[np.float64]) -> None:
        self._faces, self._colours = faces, colours

    def __call__(
        self, faces: NDArray[np.int64], weights: NDArray[np.float64], footprints: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """See `Paint`."""
        corners = self._colours[self._faces[faces]]
        mixed = np.einsum("kc,kcx->kx", weights, corners)
        return np.column_stack([mixed, np.ones(len(mixed))])


class TexturePaint:
    """Textures, looked up bilinearly; in smaller copies of themselves where a point stands for several texels."""

    def __init__(self, surface: TexturedSurface, sheets: Sequence[Sheet], areas: NDArray[np.float64]) -> None:
        self._surface = surface
        self._pyramids = [Pyramid.of(sheet) for sheet in sheets]
        first, second = (surface.uv[:, k] - surface.uv[:, 0] for k in (1, 2))
        covered = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / 2
        sizes = np.array([0, *(sheet.shape[0] * sheet.shape[1] for sheet in sheets)], float)
        texels = covered * sizes[surface.texture_of + 1]
        with np.errstate(over="ignore"):
            self._density = np.divide(texels, areas, out=np.zeros_like(areas), where=areas > 0)

    def __call__(
        self, faces: NDArray[np.int64], weights: NDArray[np.float64], footprints: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """See `Paint`."""
        colours = np.full((len(faces), 4), _UNPAINTED)
        colours[:, 3] = 1
        of = self._surface.texture_of[faces]
        for number, texture in enumerate(self._surface.textures):
            mine = np.flatnonzero(of == number)
            if not len(mine):
                continue
            uv = np.einsum("kc,kcx->kx", weights[mine], self._surface.uv[faces[mine]])
            texels = footprints[mine] * self._density[faces[mine]]
            found = self._pyramids[number].look_up(uv, texture.wrap, texels)
            if not texture.alpha_hides:
                found[:, 3] = 1
            colours[mine] = found
        return colours


@dataclass(frozen=True)
class Pyramid:
    """An image, and its copies of half the size down to a single texel."""

    levels: list[Sheet]  # the largest first
    is_opaque: bool

    @classmethod
    def of(cls, sheet: Sheet) -> Pyramid:
        """Make all copies of an image."""
        levels = [sheet]
        while max(levels[-1].shape[:2]) > 1:
            levels.append(_halved(levels[-1]))
        return cls(levels, bool((sheet[..., 3] == 1).all()))

    def look_up(
        self, uv: NDArray[np.float64], wrap: tuple[Wrap, Wrap], texels: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Interpolate at places, (K, 2), v down, that stand for areas of `texels`, (K,), of the first level; (K, 4)."""
        level = np.clip(np.log2(np.maximum(texels, 1)) / 2, 0, len(self.levels) - 1)
        lower = np.floor(level).astype(int)
        part = level - lower
        colours = np.zeros((len(uv), 4))
        for step, weight in ((0, 1 - part), (1, part)):
            chosen = lower + step
            for number in np.unique(chosen[weight > 0]).tolist():
                mine = np.flatnonzero((chosen == number) & (weight > 0))
                found = look_up(self.levels[number], uv[mine], wrap, None if self.is_opaque else 3)
                colours[mine] += weight[mine, None] * found
        return colours


def _halved(sheet: Sheet) -> Sheet:
    """Average two by two texels, by their opacity; the last of an odd number is counted twice."""
    padded = np.pad(sheet, [(0, sheet.shape[0] % 2), (0, sheet.shape[1] % 2), (0, 0)], mode="edge")
    four = np.stack([padded[row::2, column::2] for row in (0, 1) for column in (0, 1)])
    opacity = four[..., 3:].mean(axis=0)
    weighted = (four[..., :3] * four[..., 3:]).mean(axis=0)
    colours = np.divide(weighted, opacity, out=four[..., :3].mean(axis=0), where=opacity > 0)
    return np.concatenate([colours, opacity], axis=2)
