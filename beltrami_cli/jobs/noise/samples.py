"""The samples of layers that noise is added to, and the way back into the document."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Float32s, Float64s, Int32s
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.manifolds.grid.canvas import on_canvas
from beltrami_cli.flow.manifolds.new_colours import NewColours
from beltrami_cli.formats.image.writing import noise_losses
from beltrami_cli.jobs.noise.kinds import NumberedSamples, as_jpeg
from beltrami_cli.layers.image_layer import ImageLayer
from beltrami_cli.layers.layer import Layer
from beltrami_cli.layers.pixel_layer import PixelLayer
from beltrami_cli.layers.storing import StoredColours
from beltrami_cli.layers.texture_layer import TextureLayer
from beltrami_cli.layers.vertex_layer import VertexLayer, change_of
from beltrami_cli.surface.baking import places_of_texels
from beltrami_cli.surface.colour_values import from_space, to_space
from beltrami_cli.surface.geometry import edges_of
from beltrami_cli.surface.grouping import group_places
from beltrami_cli.surface.records import Cells, ColouredVertices
from beltrami_cli.surface.slots import SLOTS


class LayerSamples(ABC):
    """The samples of a layer."""

    numbered: NumberedSamples

    @property
    def cells(self) -> Cells | None:
        """Places of pixels."""
        return None

    @abstractmethod
    def positions(self) -> tuple[Float64s, Float64s]:
        """Return the positions of the samples, (K, 3), and their distances from neighbours, (K,)."""

    @abstractmethod
    def stored(self, after: Float32s) -> StoredColours:
        """Put new colours of the samples into the form of the document."""

    @abstractmethod
    def coded_as_jpeg(self, quality: int) -> Float32s:
        """Return the colours of the samples after their images went through JPEG; UsageError if it cannot be."""


def samples_of(layer: Layer) -> LayerSamples:
    if isinstance(layer, VertexLayer):
        return _VertexSamples(layer)
    if isinstance(layer, ImageLayer):
        return _ImageSamples(layer)
    assert isinstance(layer, TextureLayer)
    return _TextureSamples(layer)


class _VertexSamples(LayerSamples):
    def __init__(self, layer: VertexLayer) -> None:
        self._layer, vertices, space = layer, layer.vertices, layer.settings.space
        self._rows = vertices.coloured_rows()
        colours = to_space(vertices.colours[self._rows][:, layer.channels.changing], vertices.encoding, space)
        spaces = None if vertices.space_of is None else vertices.space_of[self._rows]
        self._place_of = group_places(vertices.positions[self._rows], spaces)[0]
        self.numbered = NumberedSamples(colours, self._place_of, space=space)

    def positions(self) -> tuple[Float64s, Float64s]:
        vertices = self._layer.vertices
        return vertices.positions[self._rows], _spacing(vertices, self._rows, self._place_of)

    def stored(self, after: Float32s) -> StoredColours:
        vertices, changing = self._layer.vertices, self._layer.channels.changing
        colours, places = vertices.colours.copy(), (self._rows[:, None], changing)
        # Conversion to the working space and back is not exact: unchanged colours keep their bits.
        back = from_space(after, vertices.encoding, self.numbered.space)
        colours[places] = np.where(after != self.numbered.colours, back, colours[places])
        return StoredColours(change_of(vertices, colours), colours)

    def coded_as_jpeg(self, quality: int) -> Float32s:
        remedy = "put the colours into a texture first: `beltrami bake --to texture`"
        raise UsageError(f"{self._layer.label}: JPEG codes images; {remedy}")


def _spacing(vertices: ColouredVertices, rows: NDArray[np.intp], place_of: Int32s) -> Float64s:
    """Return the mean length of the sides at each vertex's place, or of points the distance to the next place."""
    count = int(place_of.max(initial=-1)) + 1
    first = np.zeros(count, np.int64)
    first[place_of] = np.arange(len(rows))
    places = vertices.positions[rows[first]]
    if not len(vertices.faces) and count > 1:
        from scipy.spatial import cKDTree

        apart = np.asarray(cKDTree(places).query(places, k=2)[0], np.float64)
        return np.asarray(apart[place_of, 1])
    number = np.full(len(vertices.positions), -1, np.int32)
    number[rows] = place_of
    sides = edges_of(number[vertices.faces])
    sides = sides[(sides >= 0).all(axis=1) & (sides[:, 0] != sides[:, 1])]
    lengths = np.linalg.norm(places[sides[:, 0]] - places[sides[:, 1]], axis=1)
    total = np.bincount(sides.ravel(), np.repeat(lengths, 2), count)
    ends = np.bincount(sides.ravel(), minlength=count)
    return np.asarray((total / np.maximum(ends, 1))[place_of], np.float64)


class _PixelSamples(LayerSamples):
    remedy: str  # against formats that lose noise

    def __init__(self, layer: PixelLayer) -> None:
        self._pixels = layer

    @cached_property
    def cells(self) -> Cells:
        cells = self._pixels.places()
        assert isinstance(cells, Cells)
        return cells

    @abstractmethod
    def new_colours(self, after: Float32s) -> NewColours: ...

    def stored(self, after: Float32s) -> StoredColours:
        layer = self._pixels
        encoded = layer.encode(self.new_colours(after))
        losses = [loss for each in layer.images for loss in noise_losses(each, layer.suffix, self.remedy)]
        return dataclasses.replace(encoded, notices=(*encoded.notices, *losses))

    def coded_as_jpeg(self, quality: int) -> Float32s:
        layer, cells = self._pixels, self.cells
        if layer.names not in (("red", "green", "blue"), ("grey",)):
            cause = f"{layer.label}: JPEG codes all channels together; leave out --channels and --alpha"
            raise UsageError(cause)
        space = layer.colours.space
        coded = np.empty((len(cells.row), len(layer.names)), np.float32)
        for index, image in enumerate(layer.images):
            working = layer.colours.working(image, np.arange(image.pixels[..., 0].size))
            shown = from_space(working, "srgb", space).reshape(*image.pixels.shape[:2], -1)
            inside, place = cells.of(index)
            coded[inside] = to_space(as_jpeg(shown, quality)[place], "srgb", space)
        return coded


class _ImageSamples(_PixelSamples):
    remedy = "an OUTPUT in .png keeps all"

    def __init__(self, layer: ImageLayer) -> None:
        super().__init__(layer)
        self._valid = np.flatnonzero(layer.valid)
        colours = layer.colours.working(layer.image, self._valid)
        self.numbered = NumberedSamples(colours, np.arange(len(colours)), space=layer.settings.space)

    def positions(self) -> tuple[Float64s, Float64s]:
        places = np.column_stack([self.cells.column, self.cells.row, np.zeros_like(self.cells.row)])
        return places.astype(np.float64), np.ones(len(places))

    def new_colours(self, after: Float32s) -> NewColours:
        return NewColours.of(after, self._valid)


class _TextureSamples(_PixelSamples):
    remedy = "--texture-format png keeps all"

    def __init__(self, layer: TextureLayer) -> None:
        super().__init__(layer)
        self._surface, self._atlas = layer.surface, (atlas := layer.atlas)
        # Texels are numbered by their place in the textures, and not on the canvas.
        number = np.empty(len(atlas.owned_texels), np.int64)
        number[np.argsort(atlas.owned_texels)] = np.arange(len(number))
        is_grey = np.array([len(image.colour) == 1 for image in layer.images], bool)
        self.numbered = NumberedSamples(
            colours=layer.all_texel_colours(),
            number_of=number,
            stream=1 + SLOTS.index(layer.slot),
            is_grey=is_grey[atlas.texture_of(atlas.owned_texels)],
            space=layer.colours.space,
        )

    def positions(self) -> tuple[Float64s, Float64s]:
        return places_of_texels(self._surface, self.cells)

    def new_colours(self, after: Float32s) -> NewColours:
        atlas = self._atlas
        planes = on_canvas(atlas, after)
        beyond = np.ascontiguousarray(planes.reshape(len(planes), -1)[:, atlas.gutter.cells].T)
        return NewColours.of(after, atlas.owned_texels, atlas.gutter.texels, beyond)
