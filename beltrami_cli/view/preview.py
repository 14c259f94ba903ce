"""Previews of the live view: the part of a layer that is in view, small enough to be smoothed at once."""

from __future__ import annotations

import base64
import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Float64s, Int64s, Uint8s
from beltrami_cli.flow.beltrami_flow import smooth_in_place
from beltrami_cli.flow.manifolds.new_colours import NewColours
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.access import DEFAULT_ACCESS, Access
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image import read_texture
from beltrami_cli.formats.image.jpeg import CODED_TOGETHER
from beltrami_cli.jobs.smoothing import smooth_layer
from beltrami_cli.layers.image_layer import ImageLayer
from beltrami_cli.layers.image_surface import ImageSurface
from beltrami_cli.layers.layer import Layer
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.layers.texture_layer import TextureLayer, choose_textures
from beltrami_cli.layers.vertex_layer import GridLayer, MeshLayer, VertexLayer, only_rows
from beltrami_cli.surface.geometry import triangle_areas
from beltrami_cli.surface.records import ColouredVertices, Slot, TexturedSurface
from beltrami_cli.view.models import (
    Box,
    ModelWriter,
    displayed_colours,
    displayed_pixels,
    image_of,
    packed_array,
    textures_of,
)

Progress = Callable[[int, int], None]

_PIECE = 320  # most texels of a piece of a triangle, so that many fit into a preview
_MAX_PIECES = 100_000  # of a texture, even if pieces are then larger
_MAX_SPLITS = 24  # each halves the longest sides
_NO_FACES = np.zeros((0, 3), np.int32)
_COMPRESSION_LEVEL = 1  # of zlib
_FOCUS_RADIUS = 0.05  # of the model's size: distance from the line of sight of triangles in focus


class NoPreviewError(Exception):
    """The reason why there is no preview."""


@dataclass(frozen=True)
class Focus:
    """The centre of a view: a ray through the model, or a point of a texture or image."""

    origin: Float64s  # (3,); of a flat texture: u, v and its index
    direction: Float64s | None = None  # (3,), of length 1; None: a flat texture


@dataclass(frozen=True)
class Patch:
    """New colours of some samples: of vertices, which may have moved, or of texels of one texture."""

    texture: int  # index of the texture; -1: vertices
    rows: NDArray[np.signedinteger[Any]]  # vertices, or rows of texels
    columns: NDArray[np.signedinteger[Any]]
    colours: NDArray[np.integer[Any]]  # display values: (K, 3) of 16 bits, or (K, 4) of 8 bits
    places: Float64s | None = None  # positions of vertices, (K, 3), if they moved


class LayerView:
    """A coloured part of a document on pages: the textures of a `slot`, or (None) vertices or pixels."""

    def __init__(
        self, document: Document, slot: Slot | None, access: Access = DEFAULT_ACCESS, number: int = 0
    ) -> None:
        self.slot, self._document, self._access, self._number = slot, document, access, number
        self._is_image = document.kind == "image"
        self._row_of: Int64s | None = None
        self._box: Box | None = None
        self._can_move = False  # whether vertices have moved, on any page
        # Pixels sent last, by texture, if they differ from the document.
        self._shown: dict[int, Uint8s] = {}
        self._pixels: ImageLayer | None = None
        self._order: tuple[bytes, Int64s] | None = None  # of triangles or points, by the last focus

    @cached_property
    def _vertices(self) -> ColouredVertices:
        return self._document.coloured_vertices()

    @cached_property
    def _pieces(self) -> tuple[TexturedSurface, Float64s]:
        """The pieces of textured triangles, and the number of texels of each."""
        surface = self._document.textured(self._textures)
        sizes = [read_texture(texture).pixels.shape[1::-1] for texture in surface.textures]
        return _cut_in_pieces(surface, np.array(sizes, np.float64))

    @cached_property
    def _centres(self) -> Float64s:
        model = self._vertices if self.slot is None else self._pieces[0]
        return model.positions[model.faces].mean(axis=1) if len(model.faces) else model.positions

    @property
    def _textures(self) -> Slot:
        assert self.slot is not None
        return self.slot

    def add_to(self, writer: ModelWriter) -> None:
        """Add the part to a model for the viewer, with equal colours before and after."""
        writer.add((self._document, self._document), self.slot)
        if not self._is_image:
            self._box, self._row_of = writer.boxes[-1], writer.row_of

    def preview(
        self, settings: SmoothSettings, focus: Focus, budget: int, progress: Progress | None
    ) -> tuple[list[dict[str, Any]], int]:
        """Smooth about `budget` samples around the focus, in the box of the model; return patches and samples."""
        if focus.direction is not None and self._box is not None:
            focus = Focus(self._box.low + self._box.size * focus.origin, focus.direction)
        patches = self.smooth(settings, focus, budget, progress)
        return [self._patched(patch) for patch in patches], sum(len(patch.rows) for patch in patches)

    def smooth(
        self, settings: SmoothSettings, focus: Focus, budget: int, progress: Progress | None
    ) -> list[Patch]:
        """Smooth about `budget` samples around the focus."""
        if settings.level_seams:
            raise NoPreviewError("exposure steps are levelled over the whole model")
        if settings.embedding.guides:
            raise NoPreviewError("guides are read for the whole model")
        of_part = self._of_vertices if self.slot is None else self._of_textures
        if self._is_image:
            of_part = self._of_image
        return of_part(settings, focus, budget, progress)

    def _of_image(
        self, settings: SmoothSettings, focus: Focus, budget: int, progress: Progress | None
    ) -> list[Patch]:
        kernel = settings.kernel
        if self._pixels is None or dataclasses.replace(self._pixels.settings, kernel=kernel) != settings:
            self._pixels = ImageLayer.read(self._document, settings, self._access).normalised()
        rows, columns = self._pixels.valid.shape
        around = _window((rows, columns), focus.origin[1::-1] * (rows, columns), budget)
        top, left = (slice(axis.start // CODED_TOGETHER * CODED_TOGETHER, axis.stop) for axis in around)
        layer = _cut(self._pixels, (top, left), kernel)
        pixels, _ = layer.new_pixels(0, _smooth(layer, progress))
        shown = displayed_pixels(dataclasses.replace(layer.picture, pixels=pixels))
        row, column = (axis.ravel() for axis in np.indices(shown.shape[:2]))
        return [Patch(0, row + top.start, column + left.start, shown.reshape(-1, 4))]

    def _of_vertices(
        self, settings: SmoothSettings, focus: Focus, budget: int, progress: Progress | None
    ) -> list[Patch]:
        coloured, grid, order = self._vertices, self._document.grid(), self._around(focus)
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
            vertices = only_rows(coloured, rows, faces.astype(np.int32))
            layer = MeshLayer(vertices=vertices, settings=settings)
        made = smooth_layer(layer, progress).stored
        assert made.colours is not None
        kept = dataclasses.replace(
            layer.vertices,
            colours=made.colours[part_rows],
            positions=layer.vertices.positions[part_rows],
            faces=_NO_FACES,
        )
        return [Patch(-1, rows, rows, displayed_colours(kept), made.positions)]

    def _of_textures(
        self, settings: SmoothSettings, focus: Focus, budget: int, progress: Progress | None
    ) -> list[Patch]:
        (surface, covered), order = self._pieces, self._around(focus)
        order = order[: max(1, int(np.searchsorted(np.cumsum(covered[order]), budget)))]
        rows, corners = np.unique(surface.faces[order], return_inverse=True)
        part = dataclasses.replace(
            surface, positions=surface.positions[rows], faces=corners.reshape(-1, 3).astype(np.int32),
            uv=surface.uv[order], texture_of=surface.texture_of[order],
            space_of=None if surface.space_of is None else surface.space_of[rows],
        )  # fmt: skip
        chosen, around = choose_textures(part, settings.textures), (self._document, self._access)
        layer = TextureLayer.read(chosen, self._textures, settings, guided=around).normalised()
        new = _smooth(layer, progress)
        offsets, patches = layer.atlas.texture_offsets, []
        keys = [each.key for each in surface.textures]
        for index, picture in enumerate(layer.pictures):
            inside = (new.places >= offsets[index]) & (new.places < offsets[index + 1])
            texels = new.places[inside] - offsets[index]
            if len(texels):
                pixels = layer.new_pixels(index, new)[0].reshape(-1, picture.pixels.shape[2])[texels]
                shown = displayed_pixels(dataclasses.replace(picture, pixels=pixels[None]))[0]
                rows, columns = np.divmod(texels, picture.pixels.shape[1])
                number = keys.index(layer.surface.textures[index].key)
                patches.append(Patch(number, rows, columns, shown))
        return patches

    def _around(self, focus: Focus) -> Int64s:
        """Return triangles or points in order of distance, cached until the camera moves."""
        key = focus.origin.tobytes() + (b"" if focus.direction is None else focus.direction.tobytes())
        if self._order is None or self._order[0] != key:
            centres = self._centres
            if focus.direction is None and self.slot is not None:
                surface, focus = self._pieces[0], Focus(focus.origin * (1, 1, 1e3))
                centres = np.column_stack([surface.uv.mean(axis=1), 1e3 * surface.texture_of])
            self._order = key, _nearest(centres, focus)
        return self._order[1]

    def _patched(self, patch: Patch) -> dict[str, Any]:
        """Return a patch for the viewer, and record the new pixels of a texture."""
        if patch.texture < 0:
            assert self._row_of is not None
            assert self._box is not None
            rows = self._row_of[patch.rows]
            drawn = rows >= 0  # points without a position are not drawn
            kept = {"rows": rows.astype(np.uint32), "colours": patch.colours}
            if patch.places is not None:
                kept["places"] = self._box.shares(patch.places).astype(np.float32)
            packed = {name: packed_array(own[drawn], _COMPRESSION_LEVEL) for name, own in kept.items()}
            return {"layer": self._number, **packed}
        if patch.texture not in self._shown:
            self._shown[patch.texture] = self._displayed(self._document, patch.texture)
        pixels = self._shown[patch.texture]
        pixels[patch.rows, patch.columns] = patch.colours
        top, left = int(patch.rows.min()), int(patch.columns.min())
        part = pixels[top : int(patch.rows.max()) + 1, left : int(patch.columns.max()) + 1]
        return {
            "layer": self._number, "texture": patch.texture, "x": left, "y": top,
            "width": part.shape[1], "height": part.shape[0], "pixels": packed_array(part, _COMPRESSION_LEVEL),
        }  # fmt: skip

    def _displayed(self, document: Document, index: int) -> Uint8s:
        if self._is_image:
            return displayed_pixels(document.image())
        return displayed_pixels(read_texture(textures_of(document, self.slot)[index]))

    def whole(self, result: Document) -> list[dict[str, Any]]:
        """Return the patches that show the part of a result."""
        self._shown.clear()
        if self.slot is None and not self._is_image:
            vertices = result.coloured_vertices()
            rows = np.arange(len(vertices.positions))
            self._can_move |= not np.array_equal(vertices.positions, self._vertices.positions, equal_nan=True)
            places = vertices.positions if self._can_move else None
            return [self._patched(Patch(-1, rows, rows, displayed_colours(vertices), places))]
        old, new = textures_of(self._document, self.slot), textures_of(result, self.slot)
        found = []
        for index, (before, after) in enumerate(zip(old, new, strict=True)):
            if after.data != before.data:
                self._shown[index] = self._displayed(result, index)
            mime, data = image_of(after, self.slot or "baseColor", result.image if self._is_image else None)
            source = f"data:{mime};base64,{base64.b64encode(data).decode()}"
            found.append({"layer": self._number, "texture": index, "source": source})
        return found


def _smooth(layer: Layer, progress: Progress | None) -> NewColours:
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
        pictures=[
            dataclasses.replace(layer.picture, pixels=np.ascontiguousarray(layer.picture.pixels[place]))
        ],
        valid=layer.valid[place],
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
