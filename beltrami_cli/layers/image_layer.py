"""The pixels of an image, except holes, as samples of a manifold."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np

from beltrami_cli.arrays import Bools
from beltrami_cli.fields import require_effect
from beltrami_cli.flow.beltrami_flow import FlowResult
from beltrami_cli.flow.manifolds.grid.manifold import ColouredCanvas, GridManifold
from beltrami_cli.flow.manifolds.new_colours import NewColours
from beltrami_cli.flow.plan import Plan
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image.conversion import upright
from beltrami_cli.formats.image.decoded_image import DecodedImage
from beltrami_cli.formats.image.file_formats import label_of
from beltrami_cli.formats.image.jpeg_tables import read_jpeg_tables
from beltrami_cli.formats.image.writing import is_exact
from beltrami_cli.layers.channels import with_chosen_layer
from beltrami_cli.layers.guides import read_guide_images
from beltrami_cli.layers.image_surface import ImageSurface, canvas_of_image, read_surface
from beltrami_cli.layers.layer import Part
from beltrami_cli.layers.pixel_colours import PixelColours
from beltrami_cli.layers.pixel_layer import PixelLayer
from beltrami_cli.layers.reports import ImageReport
from beltrami_cli.layers.sample_files import noise_of_pixels
from beltrami_cli.layers.settings import SmoothSettings, binding_parameters
from beltrami_cli.layers.storing import StoredColours, rewritten
from beltrami_cli.surface.records import Cells


@dataclass(frozen=True, kw_only=True, eq=False)
class ImageLayer(PixelLayer):
    part: ClassVar[Part] = "image"
    label = "image"

    surface: ImageSurface  # `valid` where a pixel is a sample
    remarks: tuple[str, ...] = ()  # about its surface, holes and channels

    @classmethod
    def read(
        cls, document: Document, settings: SmoothSettings, *,
        suffix: str | None = None, colours_only: bool = False,
    ) -> ImageLayer:  # fmt: skip
        """Read an image and the files that settings name.

        `colours_only` leaves out channels that are not colours, unless settings name them.
        """
        require_effect(binding_parameters(settings), ["images"], document.name)
        image, chosen = with_chosen_layer(document.image(), settings)
        only = colours_only or image.names_colours
        colours = PixelColours.of([image], "baseColor", chosen, is_image=True, colours_only=only)
        access = document.access
        surface = read_surface(image, settings.image, access)
        usable = colours.finite(image)
        visible = ~colours.hidden(image, slice(None)).reshape(usable.shape)
        valid = usable & visible
        if surface.valid is not None:
            valid &= surface.valid
        remarks = [*surface.notices]
        if unfit := usable.size - int(np.count_nonzero(usable)):
            remarks.append(f"{image.name} has {unfit} pixels that are not finite; they are holes, and stay.")
        if colours.further and settings.channels is None and not colours_only:
            remarks.append(
                f"{image.name}: the channels {', '.join(colours.further)} are smoothed too, and count as differences; "
                "--channels leaves them out."
            )
        if not valid.any():
            remedy = "" if visible.any() else "; --alpha smooth takes transparent pixels, too"
            remarks.append(f"{image.name} has no pixel but holes, so nothing was changed{remedy}.")
        return cls(
            images=[image], settings=settings, colours=colours,
            surface=dataclasses.replace(surface, valid=valid),
            guides=read_guide_images(image, valid, settings, access),
            noise=noise_of_pixels(settings.kernel, [image], valid.reshape(-1), access),
            jpeg_tables=[read_jpeg_tables(document.data)], suffix=suffix, remarks=tuple(remarks),
        )  # fmt: skip

    @property
    def image(self) -> DecodedImage:
        return self.images[0]

    @property
    def valid(self) -> Bools:
        """Where a pixel is a sample, shape (H, W)."""
        assert self.surface.valid is not None
        return self.surface.valid

    @property
    def as_data(self) -> bool:
        return self.settings.space == "data"

    def canvas(self) -> ColouredCanvas:
        return canvas_of_image(
            self.surface, partial(self.colours.working, self.image), self.kernel,
            guides=self.guides, metric_channels=self.colours.channels.metric, deviations=self.deviations,
            light=self.light,
        )  # fmt: skip

    @property
    def notices(self) -> Sequence[str]:
        return [*self.image.notices, *self.remarks]

    def _facts(self) -> dict[str, object]:
        image, valid = self.image, self.valid
        return {
            "width": valid.shape[1],
            "height": valid.shape[0],
            "format": image.format,
            "stored": image.stored,
            "channels": list(image.channels),
            **({"part": image.parts[image.part or 0]} if len(image.parts) > 1 else {}),
            "colours": [image.channels[i] for i in image.colour],
            "encoding": image.encoding,
            "smoothed": [self.colours.names[i] for i in self.colours.channels.written],
            "surface": self.surface.kind,
            "holes": valid.size - int(np.count_nonzero(valid)),
        }

    def describe(self) -> dict[str, object]:
        plan, facts = self.plan(), self._facts()
        del facts["format"]  # the format is that of the file
        return {"image": {**facts, "pitch": plan.manifold.geometry.spacing}, **self._described_plan(plan)}

    def report(self, plan: Plan[GridManifold], result: FlowResult[GridManifold]) -> ImageReport:
        return ImageReport(
            image=self._facts(),
            pitch=plan.manifold.geometry.spacing,
            samples_per_kernel=round(result.samples_per_kernel, 2),
            **self._common_report(plan, result),
        )

    def encode(self, new: NewColours, *, is_smoothed: bool = True) -> StoredColours:
        del is_smoothed
        notices = [*self.remarks]
        if self.suffix is None and not self.valid.all() and not is_exact(self.image):
            label = label_of(self.image.format)
            notices.append(f"{self.image.name}: {label} is not exact, so holes change slightly as well.")
        pixels, change = self.new_pixels(0, new)
        pixels, turned = upright(self.image, pixels, self.suffix)
        wanted = self.settings.textures
        file, file_notices = rewritten(self.image, pixels, wanted, self.suffix, as_data=self.as_data)
        image = dataclasses.replace(file, suffix=self.suffix or Path(self.image.name).suffix)
        change = self.change_in(image, 0, new, change)
        return StoredColours(
            change, images={("baseColor", ""): image}, notices=(*file_notices, *turned, *notices)
        )

    def places(self) -> Cells:
        row, column = np.nonzero(self.valid)
        return Cells([self.valid.shape], np.zeros_like(row), row, column, np.zeros_like(row))
