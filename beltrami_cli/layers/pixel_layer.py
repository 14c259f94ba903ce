"""Common base of the texels of textures and the pixels of an image."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Indices
from beltrami_cli.flow.corrections.jpeg_image import JpegImage
from beltrami_cli.flow.decoding import decodes_again, plan_on_canvas
from beltrami_cli.flow.manifolds.grid.manifold import ColouredCanvas, GridManifold
from beltrami_cli.flow.manifolds.new_colours import NewColours
from beltrami_cli.flow.parameters import Space
from beltrami_cli.flow.plan import Plan
from beltrami_cli.formats.image.conversion import upright
from beltrami_cli.formats.image.decoded_image import DecodedImage
from beltrami_cli.formats.image.jpeg_tables import JpegTables
from beltrami_cli.formats.image.sample_types import full_scale_one
from beltrami_cli.formats.image.writing import check_writable, colours_in_file, is_kept
from beltrami_cli.layers.channels import ChosenChannels
from beltrami_cli.layers.layer import Layer
from beltrami_cli.layers.pixel_colours import PixelColours
from beltrami_cli.layers.storing import Change, dithered, store
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import Atlas
from beltrami_cli.surface.colour_values import unit_in_space
from beltrami_cli.surface.records import ImageFile

_ROWS = 64  # processed at a time


@dataclass(frozen=True, kw_only=True, eq=False)
class PixelLayer(Layer):
    images: Sequence[DecodedImage]
    jpeg_tables: Sequence[JpegTables | None]  # of each image; None: not a JPEG file
    colours: PixelColours
    atlas: Atlas | None = None  # None: not a texture
    suffix: str | None = None  # extension of another output format

    @property
    def channels(self) -> ChosenChannels:
        return self.colours.channels

    @property
    def light(self) -> Space | None:
        """The space of colours that stand for light, as floats do; None: they do not."""
        is_light = self.colours.space != "data" and all(image.encoding == "linear" for image in self.images)
        return self.colours.space if is_light else None

    def _in_own_unit(self) -> Self:
        return dataclasses.replace(self, colours=self.colours.normalised(self.images))

    def unit_in(self, space: str) -> float:
        return unit_in_space(self.colours.unit, self.images[0].encoding, space)

    @property
    @abstractmethod
    def as_data(self) -> bool:
        """Whether the images contain data, whose encoding must not change."""

    @abstractmethod
    def canvas(self) -> ColouredCanvas:
        """Return the canvas of the samples, with parameters in its unit of length."""

    def plan(self, tick: Callable[[], None] | None = None) -> Plan[GridManifold]:
        canvas = dataclasses.replace(self.canvas(), resources=self.resources)
        is_coded = self.colours.is_stored and decodes_again(canvas.parameters)
        return plan_on_canvas(canvas, self._coded_images(canvas.atlas) if is_coded else (), tick)

    def _coded_images(self, atlas: Atlas) -> list[JpegImage]:
        """Return the images with the tables of their files; empty unless all are JPEG, and all grey or all coloured."""
        pairs = zip(self.images, self.jpeg_tables, strict=True)
        coded = [
            (image.pixels, tables) for image, tables in pairs if tables and image.pixels.dtype == np.uint8
        ]
        if len(coded) < len(self.images) or len({pixels.shape[2] for pixels, _ in coded}) != 1:
            return []
        used = [large_arrays.zeros(pixels.shape[:2], bool) for pixels, _ in coded]
        for block in large_arrays.blocks(len(atlas.owned_texels)):
            for index, _, texels in atlas.by_texture(atlas.owned_texels[block]):
                used[index].reshape(-1)[texels] = True
        return [
            JpegImage(pixels, mask, tables.steps, tables.span)
            for (pixels, tables), mask in zip(coded, used, strict=True)
        ]

    def require_writable(self) -> None:
        for image in self.images:
            check_writable(image, self.suffix)

    def new_pixels(self, index: int, new: NewColours, *, is_dithered: bool = False) -> tuple[Array, Change]:
        """Return an image's pixels with new colours, and the change; unchanged numbers keep their bits.

        `is_dithered`: add dither against banding in 8 bits.
        """
        pixels = large_arrays.copy_of(self.images[index].pixels)
        return pixels, self._fill(pixels, index, new.places, new.take, is_dithered=is_dithered)

    def change_in(self, file: ImageFile, index: int, new: NewColours, change: Change) -> Change:
        """Return the change of an image's samples in the written file, if the format lost some of it."""
        image, as_data = self.images[index], self.as_data
        if file.content == image.source:
            return Change(change.count)
        if is_kept(image, file):
            return change
        before, after = colours_in_file(image, file, as_data=as_data)
        before, _ = upright(image, before, self.suffix if self.atlas is None else None)
        where = np.zeros((*image.pixels.shape[:2], 1), bool)
        for block in large_arrays.blocks(len(new.places)):
            where.reshape(-1)[self._of_image(new.places[block], index)[1]] = True
        where = upright(image, where, self.suffix if self.atlas is None else None)[0][..., 0]
        channels = [i for i in self.colours.changing if i < after.shape[2]] or [*range(after.shape[2])]
        return Change.joined(
            Change.between(
                *(full_scale_one(each[rows][where[rows]][:, channels]) for each in (before, after))
            )
            for rows in large_arrays.blocks(len(after), _ROWS)
        )

    def _of_image(self, texels: Indices, index: int) -> tuple[Bools | slice, Indices]:
        """Return the texels of one image, relative to its first, and their rows."""
        if len(self.images) == 1 or self.atlas is None:
            return slice(None), texels
        begin, end = self.atlas.texture_offsets[index : index + 2].tolist()
        inside = (texels >= begin) & (texels < end)
        return inside, texels[inside] - begin

    def _fill(
        self, pixels: Array, index: int, texels: Indices, take: Callable[[slice, Bools | slice], Float32s], *,
        is_dithered: bool,
    ) -> Change:  # fmt: skip
        """Write samples into an image's pixels in place, and return the change."""
        image, colours, threads = self.images[index], self.colours, self.settings.kernel.thread_count
        table, changes = pixels.reshape(-1, pixels.shape[2]), []
        for block in large_arrays.blocks(len(texels), large_arrays.CACHED):
            inside, chosen = self._of_image(texels[block], index)
            if not len(chosen):
                continue
            values = colours.stored(image, table, chosen, take(block, inside))
            if is_dithered and image.stored == "uint8":
                values = dithered(values, chosen, image.pixels.shape[1])
            changes.append(store(image, table, chosen, values, colours.columns(image), threads))
        return Change.joined(changes)
