"""Pixels of an image as samples of a manifold: their colours in the working space, and back."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np

from beltrami_cli.arrays import Array, Float64s
from beltrami_cli.flow.beltrami_flow import FlowResult, Plan
from beltrami_cli.flow.grid_manifold import GridManifold
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.flow.records import NewColours
from beltrami_cli.formats.access import Access
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image import Picture, check_writable, is_exact, label_of
from beltrami_cli.formats.image.metadata import CODED_TOGETHER, read_jpeg_tables
from beltrami_cli.formats.image.writing import upright
from beltrami_cli.layers.guides import noise_of_pixels, read_guide_images
from beltrami_cli.layers.image_surface import plan_on_image, read_surface, refuse_options_of_meshes
from beltrami_cli.layers.layer import (
    Change,
    Layer,
    Part,
    Repainted,
    rewritten,
)
from beltrami_cli.layers.memory_check import PIXEL_BYTES, require_memory
from beltrami_cli.layers.picture_colours import PictureColours, with_chosen_layer
from beltrami_cli.layers.reports import ImageReport
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.layers.texel_colours import Repainting
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.baking import Cells
from beltrami_cli.surface.records import ImageFile


class ImageLayer(Layer):
    """Pixels of an image that are no holes; `colours_only` leaves out channels that are no colours, unless named."""

    part: ClassVar[Part] = "image"
    label = "image"

    def __init__(
        self,
        document: Document,
        settings: SmoothSettings,
        access: Access,
        suffix: str | None = None,
        *,
        colours_only: bool = False,
    ) -> None:
        refuse_options_of_meshes(settings, document.name)
        if not large_arrays.is_on_disk():  # for which `checked_memory` has seen to it
            require_memory([(document.name, document.data)], access, PIXEL_BYTES)
        self.settings, self.suffix = settings, suffix
        self.picture, self._chosen = with_chosen_layer(document.picture(), settings)
        self._colours_only = colours_only or self.picture.is_layered
        self._tables = read_jpeg_tables(document.data)
        self.colours = self._colours_of(self.picture)
        self.names = self.colours.names
        surface = read_surface(self.picture, settings.image, access)
        usable = self.colours.finite(self.picture)
        self.valid = usable & ~self.colours.hidden(self.picture, slice(None)).reshape(usable.shape)
        if surface.valid is not None:
            self.valid &= surface.valid
        self.surface = dataclasses.replace(surface, valid=self.valid)
        self._unfit = usable.size - int(np.count_nonzero(usable))
        self._guides = read_guide_images(self.picture, self.valid, settings, access)
        self._noise = noise_of_pixels(settings.kernel, [self.picture], self.valid.reshape(-1), access)
        self._is_noted = settings.channels is None and not colours_only

    def _colours_of(self, picture: Picture) -> PictureColours:
        options = {"is_image": True, "colours_only": self._colours_only}
        return PictureColours([picture], "baseColor", self._chosen, **options)

    def plan(self, tick: Callable[[], None] | None = None) -> Plan[GridManifold]:
        noise = None if self._noise is None else self._noise.reshape(-1, self._noise.shape[2])
        working, metric = partial(self.colours.working, self.picture), self.colours.metric_channels
        coded = None
        if self._tables is not None and self.colours.shows_all:
            coded = self.picture.pixels, self._tables
        known = self.settings.kernel, self._guides, metric, tick, noise
        return plan_on_image(self.surface, working, *known, coded=coded, light_in=self.colours.light_space)

    def window(self, place: tuple[slice, slice], kernel: KernelParameters) -> ImageLayer:
        """Return the samples of a part of the image, with other parameters."""
        part = copy.copy(self)
        part.settings = dataclasses.replace(self.settings, kernel=kernel)
        pixels = np.ascontiguousarray(self.picture.pixels[place])
        part.picture = dataclasses.replace(self.picture, pixels=pixels)
        if any(axis.start % CODED_TOGETHER for axis in place):
            part._tables = None
        part.colours = self._colours_of(part.picture)
        part.valid, part.surface = self.valid[place], self.surface.window(place)
        part._noise = None if self._noise is None else self._noise[place]
        images = [guide.values.reshape(*self.valid.shape, -1)[place] for guide in self._guides]
        part._guides = tuple(
            dataclasses.replace(guide, values=image.reshape(-1, image.shape[2]))
            for guide, image in zip(self._guides, images, strict=True)
        )
        return part

    def require_writable(self) -> None:
        check_writable(self.picture, self.suffix)

    def facts(self) -> dict[str, object]:
        picture, valid = self.picture, self.valid
        return {
            "width": valid.shape[1],
            "height": valid.shape[0],
            "format": picture.format,
            "stored": picture.stored,
            "channels": list(picture.channels),
            **({"part": picture.parts[picture.part or 0]} if len(picture.parts) > 1 else {}),
            "colours": [picture.channels[i] for i in picture.colour],
            "encoding": picture.encoding,
            "smoothed": [self.colours.names[i] for i in self.colours.written],
            "surface": self.surface.kind,
            "holes": valid.size - int(np.count_nonzero(valid)),
        }

    def describe(self) -> dict[str, object]:
        plan, facts = self.plan(), self.facts()
        del facts["format"]  # is that of the file
        return {"image": {**facts, "pitch": plan.manifold.geometry.spacing}, **self._planned(plan)}

    def notices(self) -> list[str]:
        return [*self.picture.notices, *self._own_notices()]

    def _own_notices(self) -> list[str]:
        """Return what users should know besides what the picture says of itself."""
        name, found = self.picture.name, [*self.surface.notices]
        if self._unfit:
            unfit = f"{self._unfit} pixels that are no finite numbers"
            found.append(f"{name} has {unfit}; they are holes, and stay.")
        if self.colours.others and self._is_noted:
            found.append(
                f"{name}: the channels {', '.join(self.colours.others)} are smoothed too, and count as differences; "
                "--channels leaves them out."
            )
        if not self.valid.any():
            is_seen = not self.colours.hidden(self.picture, slice(None)).all()
            remedy = "" if is_seen else "; --alpha smooth takes what is transparent, too"
            found.append(f"{name} has no pixel but holes, so nothing was smoothed{remedy}.")
        return found

    def report(self, plan: Plan[GridManifold], result: FlowResult[GridManifold]) -> ImageReport:
        return ImageReport(
            image=self.facts(),
            pitch=plan.manifold.geometry.spacing,
            samples_per_kernel=round(result.samples_per_kernel, 2),
            **self._used(plan, result),
        )

    def painted(self, new: NewColours) -> tuple[Array, Change]:
        """Return the picture's pixels with new colours, and how they changed; other numbers keep their bits."""
        nothing, offsets = np.zeros(0, np.int64), np.array([0, self.valid.size], np.int64)
        threads = self.settings.kernel.thread_count
        painter = Repainting([self.picture], self.colours, offsets, nothing, None, threads)
        return painter.repaint(0, new)

    def repaint(
        self, new: NewColours, *, is_smoothed: bool = True, positions: Float64s | None = None
    ) -> Repainted:
        del is_smoothed, positions
        notices = self._own_notices()
        if self.suffix is None and not self.valid.all() and not is_exact(self.picture):
            label = label_of(self.picture.format)
            notices.append(f"{self.picture.name}: {label} is not exact, so holes change slightly as well.")
        return self.written(new, rewritten, notices)

    def cells(self) -> Cells:
        row, column = np.nonzero(self.valid)
        return Cells([self.valid.shape], np.zeros_like(row), row, column, np.zeros_like(row))

    def written(
        self, new: NewColours, write: Callable[..., tuple[ImageFile, list[str]]], notices: Sequence[str]
    ) -> Repainted:
        pixels, change = self.painted(new)
        pixels, turned = upright(self.picture, pixels, self.suffix)
        textures, suffix = self.settings.textures, self.suffix
        file, said = write(self.picture, pixels, textures, suffix, as_data=self.settings.space == "data")
        image = ImageFile(file.data, suffix or Path(self.picture.name).suffix)
        return Repainted(change, images={("baseColor", ""): image}, notices=(*said, *turned, *notices))
