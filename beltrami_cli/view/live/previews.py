"""Previews: a part of a document in view, small enough to be smoothed at once."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Float64s, Int64s
from beltrami_cli.flow.beltrami_flow import smooth_in_place
from beltrami_cli.flow.manifolds.new_colours import NewColours
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image.jpeg_tables import CODED_TOGETHER
from beltrami_cli.formats.image.reading import read_texture
from beltrami_cli.jobs.smoothing import smooth_layer
from beltrami_cli.layers.grid_layer import GridLayer
from beltrami_cli.layers.image_layer import ImageLayer
from beltrami_cli.layers.image_surface import ImageSurface
from beltrami_cli.layers.layer import Layer
from beltrami_cli.layers.mesh_layer import MeshLayer
from beltrami_cli.layers.selection import Selection
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.layers.texture_groups import choose_textures
from beltrami_cli.layers.texture_layer import TextureLayer
from beltrami_cli.layers.vertex_layer import VertexLayer
from beltrami_cli.surface.geometry import triangle_areas
from beltrami_cli.surface.records import ColouredVertices, Slot, TexturedSurface
from beltrami_cli.view.light import displayed_colours, displayed_pixels

Steps = Callable[[int, int], None]  # called with the steps done and all; it may raise to stop

_PIECE = 320  # most texels of a piece of a triangle, so that many fit into a preview
_MAX_PIECES = 100_000  # of a texture, even if pieces are then larger
_MAX_SPLITS = 24  # each halves the longest sides
_NO_FACES = np.zeros((0, 3), np.int32)
_APART = 1e3  # distance of textures that are laid flat, so that the nearest points are all in one
_FOCUS_RADIUS = 0.05  # of the model's size: distance from the line of sight of triangles in focus


@dataclass(frozen=True)
class Focus:
    """The centre of a view: a ray through the model, or a point of a texture or image."""

    origin: Float64s  # (3,); of a flat texture: u, v and its index
    direction: Float64s | None = None  # (3,), of length 1; None: a flat texture


@dataclass(frozen=True)
class Update:
    """New colours of some samples: of vertices, which may have moved, or of texels of one texture."""

    texture: int  # index of the texture; -1: vertices
    rows: NDArray[np.signedinteger[Any]]  # vertices, or rows of texels
    columns: NDArray[np.signedinteger[Any]]
    colours: NDArray[np.integer[Any]]  # display values: (K, 3) of 16 bits, or (K, 4) of 8 bits
    positions: Float64s | None = None  # of vertices, (K, 3), if they moved


def obstacle_to(settings: SmoothSettings, selection: Selection, slot: Slot | None) -> str:
    """Return the reason why a part has no preview; empty if it has one."""
    if not (selection.image or (selection.vertices if slot is None else slot in selection.slots)):
        return "the colours in view are not smoothed"
    if not settings.kernel.iterations:
        return "no iteration is wanted, so nothing changes"
    if settings.level_seams:
        return "exposure steps are levelled over the whole model"
    return "guides are read for the whole model" if settings.embedding.guides else ""


def previewer_of(document: Document, slot: Slot | None) -> Previewer:
    """Return the previewer of the pixels of an image, of the textures of a slot, or (None) of vertex colours.

    Its `smooth` smooths about `budget` samples around a focus.
    """
    if document.kind == "image":
        return _ImagePreviewer(document)
    return _VertexPreviewer(document) if slot is None else _TexturePreviewer(document, slot)


class _ImagePreviewer:
    def __init__(self, document: Document) -> None:
        self._document = document
        self._layer: ImageLayer | None = None  # of the last settings

    def smooth(
        self, settings: SmoothSettings, focus: Focus, budget: int, progress: Steps | None
    ) -> list[Update]:
        kernel = settings.kernel
        if self._layer is None or dataclasses.replace(self._layer.settings, kernel=kernel) != settings:
            self._layer = ImageLayer.read(self._document, settings).normalised()
        shape = self._layer.valid.shape
        window = _window(shape, focus.origin[1::-1] * shape, budget)
        top, left = (slice(axis.start // CODED_TOGETHER * CODED_TOGETHER, axis.stop) for axis in window)
        layer = _cut(self._layer, (top, left), kernel)
        pixels, _ = layer.new_pixels(0, _smoothed(layer, progress))
        shown = displayed_pixels(dataclasses.replace(layer.image, pixels=pixels))
        row, column = (axis.ravel() for axis in np.indices(shown.shape[:2]))
        return [Update(0, row + top.start, column + left.start, shown.reshape(-1, 4))]


class _VertexPreviewer:
    def __init__(self, document: Document) -> None:
        self._document = document

    @cached_property
    def _coloured(self) -> ColouredVertices:
        return self._document.coloured_vertices()

    @cached_property
    def _by_distance(self) -> _ByDistance:
        vertices = self._coloured
        has_faces = len(vertices.faces) > 0
        return _ByDistance(
            vertices.positions[vertices.faces].mean(axis=1) if has_faces else vertices.positions
        )

    def smooth(
        self, settings: SmoothSettings, focus: Focus, budget: int, progress: Steps | None
    ) -> list[Update]:
        coloured, grid, order = self._coloured, self._document.grid(), self._by_distance.order(focus)
        is_mesh = len(coloured.faces) > 0
        layer: VertexLayer
        if grid is not None:
            vertex = coloured.faces[order[0], 0] if is_mesh else order[0]
            middle = np.array(np.unravel_index(int(np.argmax(grid == vertex)), grid.shape), np.float64)
            part = np.ascontiguousarray(grid[_window(grid.shape, middle, budget)])
            rows = part_rows = part[part >= 0]
            layer = GridLayer(vertices=coloured, grid=part, settings=settings)
        else:
            order = order[: budget * (2 if is_mesh else 1)]
            rows = np.unique(coloured.faces[order]).astype(np.int64) if is_mesh else np.sort(order)
            part_rows = np.arange(len(rows))
            faces = np.searchsorted(rows, coloured.faces[order] if is_mesh else coloured.faces)
            vertices = coloured.only(rows, faces.astype(np.int32))
            layer = MeshLayer(vertices=vertices, settings=settings)
        made = smooth_layer(layer, progress).stored
        assert made.colours is not None
        kept = dataclasses.replace(
            layer.vertices,
            colours=made.colours[part_rows],
            positions=layer.vertices.positions[part_rows],
            faces=_NO_FACES,
        )
        return [Update(-1, rows, rows, displayed_colours(kept), made.positions)]


class _TexturePreviewer:
    def __init__(self, document: Document, slot: Slot) -> None:
        self._document, self._slot = document, slot

    @cached_property
    def _pieces(self) -> tuple[TexturedSurface, Float64s]:
        """The pieces of textured triangles, and the number of texels of each."""
        surface = self._document.textured(self._slot)
        sizes = [read_texture(texture).pixels.shape[1::-1] for texture in surface.textures]
        return _cut_in_pieces(surface, np.array(sizes, np.float64))

    @cached_property
    def _by_distance(self) -> _ByDistance:
        surface, _ = self._pieces
        flat = np.column_stack([surface.uv.mean(axis=1), _APART * surface.texture_of])
        return _ByDistance(surface.positions[surface.faces].mean(axis=1), flat)

    def smooth(
        self, settings: SmoothSettings, focus: Focus, budget: int, progress: Steps | None
    ) -> list[Update]:
        (surface, covered), order = self._pieces, self._by_distance.order(focus)
        order = order[: max(1, int(np.searchsorted(np.cumsum(covered[order]), budget)))]
        rows, corners = np.unique(surface.faces[order], return_inverse=True)
        part = dataclasses.replace(
            surface, positions=surface.positions[rows], faces=corners.reshape(-1, 3).astype(np.int32),
            uv=surface.uv[order], texture_of=surface.texture_of[order],
            space_of=None if surface.space_of is None else surface.space_of[rows],
        )  # fmt: skip
        chosen = choose_textures(part, settings.textures)
        layer = TextureLayer.read(chosen, self._slot, settings, guided=self._document).normalised()
        new = _smoothed(layer, progress)
        offsets, updates = layer.atlas.texture_offsets, []
        keys = [each.key for each in surface.textures]
        for index, picture in enumerate(layer.images):
            inside = (new.places >= offsets[index]) & (new.places < offsets[index + 1])
            texels = new.places[inside] - offsets[index]
            if len(texels):
                pixels = layer.new_pixels(index, new)[0].reshape(-1, picture.pixels.shape[2])[texels]
                shown = displayed_pixels(dataclasses.replace(picture, pixels=pixels[None]))[0]
                rows, columns = np.divmod(texels, picture.pixels.shape[1])
                updates.append(Update(keys.index(layer.surface.textures[index].key), rows, columns, shown))
        return updates


Previewer = _ImagePreviewer | _VertexPreviewer | _TexturePreviewer


class _ByDistance:
    """Triangles or points in order of distance from a focus, which is kept until the camera moves."""

    def __init__(self, centres: Float64s, flat: Float64s | None = None) -> None:
        """`flat`: the centres on textures, as (u, v, index of the texture * _APART)."""
        self._centres, self._flat = centres, flat
        self._last: tuple[bytes, Int64s] | None = None

    def order(self, focus: Focus) -> Int64s:
        key = focus.origin.tobytes() + (b"" if focus.direction is None else focus.direction.tobytes())
        if self._last is None or self._last[0] != key:
            centres = self._centres
            if focus.direction is None and self._flat is not None:
                centres, focus = self._flat, Focus(focus.origin * (1, 1, _APART))
            self._last = key, _nearest(centres, focus)
        return self._last[1]


def _smoothed(layer: Layer, progress: Steps | None) -> NewColours:
    new: NewColours = smooth_in_place(layer.plan(), progress).manifold.new_colours()
    return new


def _cut(layer: ImageLayer, place: tuple[slice, slice], kernel: KernelParameters) -> ImageLayer:
    """Return a part of an image that is aligned to blocks of JPEG, with other parameters."""
    surface, noise = layer.surface, layer.noise
    if noise is not None:
        noise = noise.reshape(*layer.valid.shape, -1)[place].reshape(-1, noise.shape[1])
    return dataclasses.replace(
        layer,
        settings=dataclasses.replace(layer.settings, kernel=kernel),
        images=[dataclasses.replace(layer.image, pixels=np.ascontiguousarray(layer.image.pixels[place]))],
        surface=ImageSurface(
            heights=None if surface.heights is None else surface.heights[place],
            positions=None if surface.positions is None else surface.positions[place],
            valid=layer.valid[place],
        ),
        noise=noise,
    )


def _window(shape: tuple[int, ...], middle: Float64s, budget: int) -> tuple[slice, slice]:
    """Return a square window of a grid around a point, of about so many cells."""
    side = int(np.sqrt(budget))
    row, column = np.clip(middle - side / 2, 0, np.maximum(0, np.array(shape) - side)).astype(int).tolist()
    return slice(row, row + side), slice(column, column + side)


def _nearest(centres: Float64s, focus: Focus) -> Int64s:
    """Return points in order of distance from the first one on the line of sight."""
    middle = focus.origin
    if focus.direction is not None:
        offsets = centres - focus.origin
        along = offsets @ focus.direction
        offset = np.sqrt(np.maximum(np.einsum("ij,ij->i", offsets, offsets) - along**2, 0))
        near = offset < max(_FOCUS_RADIUS * float(along.max() - along.min()), 1.001 * float(offset.min()))
        middle = centres[near][np.argmin(along[near] + offset[near])]
    return np.asarray(np.argsort(np.einsum("ij,ij->i", centres - middle, centres - middle)), np.int64)


def _cut_in_pieces(surface: TexturedSurface, sizes: Float64s) -> tuple[TexturedSurface, Float64s]:
    """Cut textured triangles into pieces of few texels; return also the number of texels of each.

    `sizes`: width and height of each texture, shape (T, 2).
    """
    from trimesh.remesh import subdivide_to_size

    faces = np.flatnonzero(surface.texture_of >= 0)
    corners, apart = surface.faces[faces], np.arange(3 * len(faces), dtype=np.int32).reshape(-1, 3)
    spaces = np.zeros(corners.shape) if surface.space_of is None else surface.space_of[corners]
    # Lengths are measured along the first three columns, in texels; the others are interpolated.
    flat = surface.uv[faces] * sizes[surface.texture_of[faces], None]
    columns = (
        flat,
        np.zeros((*corners.shape, 1)),
        surface.positions[corners],
        surface.uv[faces],
        spaces[..., None],
    )
    rows = np.concatenate(columns, axis=2).reshape(-1, 9)
    most = max(_PIECE, float(triangle_areas(rows[:, :3], apart).sum()) / _MAX_PIECES)
    longest, limit = float(np.sqrt(2 * most)), _MAX_SPLITS
    cut, pieces, index = subdivide_to_size(rows, apart, longest, max_iter=limit, return_index=True)  # type: ignore[no-untyped-call]
    made = dataclasses.replace(
        surface, positions=cut[:, 3:6], faces=pieces.astype(np.int32), uv=cut[pieces, 6:8],
        texture_of=surface.texture_of[faces[index]],
        space_of=None if surface.space_of is None else np.rint(cut[:, 8]).astype(surface.space_of.dtype),
    )  # fmt: skip
    return made, triangle_areas(cut[:, :3], made.faces)
