"""The part of a document that somebody looks at, small enough to be smoothed at once by the kernel."""

from __future__ import annotations

import copy
import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.formats.access import EVERYTHING_INSIDE
from beltrami_cli.formats.image.document import ImageDocument
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.samples.pixel_samples import PixelSamples
from beltrami_cli.samples.texel_samples import TexelSamples
from beltrami_cli.samples.vertex_samples import VertexSamples
from beltrami_cli.view.models import displayed_colours, displayed_pixels

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from beltrami_cli.arrays import Float64s, Int64s
    from beltrami_cli.formats.document import Document
    from beltrami_cli.samples.settings import SmoothSettings
    from beltrami_cli.surface.records import PaintedVertices, Slot, TexturedSurface

    Progress = Callable[[int, int], None]

_PIECE = 320  # texels of a triangle at most, so that enough of them fit
_MOST_PIECES = 100_000  # in a whole texture, even if they are larger then
_MOST_SPLITS = 8
_BESIDE = 0.05  # of the model's size: triangles so near to the line of sight are looked at


@dataclass(frozen=True)
class Focus:
    """Where somebody looks: along a ray through the model, or at a place of a texture or image."""

    origin: Float64s  # (3,), or of a flat texture u, v and its number
    direction: Float64s | None = None  # (3,), of length 1; None: the texture is seen flat


@dataclass(frozen=True)
class Patch:
    """New colours of some samples: of vertices, or of texels of one texture."""

    texture: int  # number of the texture; -1: vertices
    rows: NDArray[np.signedinteger[Any]]  # vertices, or rows of texels
    columns: NDArray[np.signedinteger[Any]]
    colours: NDArray[np.integer[Any]]  # display values: (K, 3) of 16 bits, or (K, 4) of 8 bits


class Previewer:
    """Smooths parts of one layer of a document; `slot`: of its textures, None: its vertices or its pixels."""

    def __init__(self, document: Document, slot: Slot | None) -> None:
        self._document, self._slot = document, slot
        self._painted: PaintedVertices | None = None
        self._surface: TexturedSurface | None = None
        self._order: tuple[bytes, Int64s] | None = None  # where somebody looked last, and what is near
        if isinstance(document, ImageDocument):
            return
        if slot is None:
            self._painted = document.painted()
            corners, faces = self._painted.positions, self._painted.faces
            self._centres = corners[faces].mean(axis=1) if len(faces) else corners
        else:
            surface = document.textured(slot)
            surface = _used(surface, np.flatnonzero(surface.texture_of >= 0))
            pictures = [read_image(texture.data, texture.name) for texture in surface.textures]
            self._texels = np.array([picture.pixels[..., 0].size for picture in pictures], np.float64)
            most = max(_PIECE, float(self._texels.sum()) / _MOST_PIECES)
            self._surface = surface = _split(surface, self._texels, most)
            self._held = _areas(surface, self._texels)
            self._centres = surface.positions[surface.faces].mean(axis=1)
            self._flat = np.column_stack([surface.uv.mean(axis=1), 1e3 * surface.texture_of])

    def can(self, settings: SmoothSettings) -> bool:
        """Whether parts are smoothed as the whole would be."""
        embedding = settings.embedding
        plain = not (
            embedding.guides or embedding.smooth_geometry or settings.image.given or settings.level_seams
        )
        return plain and (isinstance(self._document, ImageDocument) or self._document.grid() is None)

    def smooth(
        self, settings: SmoothSettings, focus: Focus, budget: int, progress: Progress | None
    ) -> list[Patch]:
        """Smooth about as many samples as `budget` says, around where somebody looks."""
        if isinstance(self._document, ImageDocument):
            return self._pixels(self._document, settings, focus, budget, progress)
        if self._painted is not None:
            return self._vertices(self._painted, settings, focus, budget, progress)
        return self._textures(settings, focus, budget, progress)

    def _pixels(
        self,
        document: ImageDocument,
        settings: SmoothSettings,
        focus: Focus,
        budget: int,
        progress: Progress | None,
    ) -> list[Patch]:
        picture = document.picture()
        height, width = picture.pixels.shape[:2]
        side = int(np.sqrt(budget))
        middle = focus.origin[:2] * (width, height)
        left, top = (
            int(np.clip(m - side / 2, 0, max(0, n - side)))
            for m, n in zip(middle, (width, height), strict=True)
        )
        window = np.s_[top : top + side, left : left + side]
        part = copy.copy(document)
        cropped = dataclasses.replace(picture, pixels=np.ascontiguousarray(picture.pixels[window]))
        part.__dict__["_picture"] = cropped
        samples = PixelSamples(part, settings, EVERYTHING_INSIDE)
        flow = samples.flow()
        flow.run(progress)
        pixels, _ = samples.colours.repainted(flow.manifold.new_colours(), settings.kernel.thread_count)
        shown = displayed_pixels(dataclasses.replace(cropped, pixels=pixels))
        rows, columns = (axis.ravel() for axis in np.indices(shown.shape[:2]))
        return [Patch(0, rows + top, columns + left, shown.reshape(-1, 4))]

    def _vertices(
        self,
        painted: PaintedVertices,
        settings: SmoothSettings,
        focus: Focus,
        budget: int,
        progress: Progress | None,
    ) -> list[Patch]:
        order = self._around(focus)[: budget * (2 if len(painted.faces) else 1)]
        rows = np.unique(painted.faces[order]) if len(painted.faces) else np.sort(order)
        part = dataclasses.replace(
            painted,
            positions=painted.positions[rows],
            faces=np.searchsorted(rows, painted.faces[order] if len(painted.faces) else painted.faces).astype(
                np.int32
            ),
            colours=painted.colours[rows],
            space_of=None if painted.space_of is None else painted.space_of[rows],
        )
        samples = VertexSamples(part, settings)
        flow = samples.flow()
        flow.run(progress)
        new = samples.repaint(flow.manifold.new_colours()).colours
        shown = displayed_colours(dataclasses.replace(part, colours=part.colours if new is None else new))
        return [Patch(-1, rows, rows, shown)]

    def _textures(
        self, settings: SmoothSettings, focus: Focus, budget: int, progress: Progress | None
    ) -> list[Patch]:
        surface = self._surface
        assert surface is not None
        assert self._slot is not None
        order = self._around(focus)
        held = np.cumsum(self._held[order])
        part = _used(surface, order[: max(1, int(np.searchsorted(held, budget)))])
        samples = TexelSamples(part, self._slot, settings)
        flow = samples.flow()
        flow.run(progress)
        new = flow.manifold.new_colours()
        offsets, patches = samples.atlas.texture_offsets, []
        for index, picture in enumerate(samples.pictures):
            texels = (
                new.places[(new.places >= offsets[index]) & (new.places < offsets[index + 1])]
                - offsets[index]
            )
            if len(texels):
                pixels = samples.painted(index, new).reshape(-1, picture.pixels.shape[2])[texels]
                shown = displayed_pixels(dataclasses.replace(picture, pixels=pixels[None]))[0]
                rows, columns = np.divmod(texels, picture.pixels.shape[1])
                number = [each.key for each in surface.textures].index(samples.surface.textures[index].key)
                patches.append(Patch(number, rows, columns, shown))
        return patches

    def _around(self, focus: Focus) -> Int64s:
        """Return triangles or points in the order in which they are nearest; it is kept until the camera moves."""
        key = focus.origin.tobytes() + (b"" if focus.direction is None else focus.direction.tobytes())
        if self._order is None or self._order[0] != key:
            if focus.direction is None and self._surface is not None:
                order = _nearest(self._flat, Focus(focus.origin * (1, 1, 1e3)))
            else:
                order = _nearest(self._centres, focus)
            self._order = key, order
        return self._order[1]


def _nearest(centres: Float64s, focus: Focus) -> Int64s:
    """Return places in the order of their distance from the first one on the line of sight."""
    middle = focus.origin
    if focus.direction is not None:
        offsets = centres - focus.origin
        along = offsets @ focus.direction
        beside = np.sqrt(np.maximum(np.einsum("ij,ij->i", offsets, offsets) - along**2, 0))
        near = beside < max(_BESIDE * float(along.max() - along.min()), 1.001 * float(beside.min()))
        middle = centres[near][np.argmin(along[near] + beside[near])]
    squared = np.einsum("ij,ij->i", centres - middle, centres - middle)
    return np.asarray(np.argsort(squared), np.int64)


def _areas(surface: TexturedSurface, texels: Float64s) -> Float64s:
    """Return how many texels each triangle covers."""
    one, two = (surface.uv[:, k] - surface.uv[:, 0] for k in (1, 2))
    return np.asarray(np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]) / 2 * texels[surface.texture_of])


def _used(surface: TexturedSurface, chosen: Int64s) -> TexturedSurface:
    """Return some triangles of a surface, with their vertices."""
    rows, corners = np.unique(surface.faces[chosen], return_inverse=True)
    return dataclasses.replace(
        surface,
        positions=surface.positions[rows],
        faces=corners.reshape(-1, 3).astype(np.int32),
        uv=surface.uv[chosen],
        texture_of=surface.texture_of[chosen],
        space_of=None if surface.space_of is None else surface.space_of[rows],
    )


def _split(surface: TexturedSurface, texels: Float64s, most: float) -> TexturedSurface:
    """Return a surface whose large triangles are cut at the middles of their sides, so that each has few texels."""
    for _ in range(_MOST_SPLITS):
        large = _areas(surface, texels) > most
        if not large.any():
            break
        corners, uv = surface.positions[surface.faces[large]], surface.uv[large]
        spaces = None if surface.space_of is None else surface.space_of[surface.faces[large]]
        first, small = len(surface.positions), np.flatnonzero(~large)
        count = 4 * len(uv)
        new = np.arange(first, first + 3 * count, dtype=np.int32).reshape(-1, 3)
        surface = dataclasses.replace(
            surface,
            positions=np.concatenate([surface.positions, _quarters(corners).reshape(-1, 3)]),
            faces=np.concatenate([surface.faces[small], new]),
            uv=np.concatenate([surface.uv[small], _quarters(uv)]),
            texture_of=np.concatenate([surface.texture_of[small], np.repeat(surface.texture_of[large], 4)]),
            space_of=None
            if spaces is None
            else np.concatenate([surface.space_of, np.repeat(spaces, 4, axis=0).ravel()]),
        )
    return surface


def _quarters(corners: Float64s) -> Float64s:
    """Return the four triangles between the corners and the middles of the sides of each, (4 K, 3, X)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.stack([np.stack(part, axis=1) for part in parts], axis=1).reshape(-1, 3, corners.shape[2])
