"""Pixels of an image as samples of a manifold: colours in the working space and back."""

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
from beltrami_cli.flow.manifolds.grid_manifold import ColouredCanvas, GridManifold
from beltrami_cli.flow.manifolds.guides import Guide
from beltrami_cli.flow.manifolds.new_colours import NewColours
from beltrami_cli.flow.plan import Plan
from beltrami_cli.formats.access import Access
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image import DecodedImage, is_exact, label_of
from beltrami_cli.formats.image.conversion import upright
from beltrami_cli.formats.image.jpeg_tables import read_jpeg_tables
from beltrami_cli.layers.guides import noise_of_pixels, read_guide_images
from beltrami_cli.layers.image_surface import (
    ImageSurface,
    canvas_of_image,
    read_surface,
)
from beltrami_cli.layers.layer import ImageReport, Part, StoredColours, rewritten
from beltrami_cli.layers.picture_layer import PictureColours, PictureLayer, with_chosen_layer
from beltrami_cli.layers.settings import SmoothSettings, binding_parameters
from beltrami_cli.surface.baking import Cells


@dataclass(frozen=True, kw_only=True, eq=False)
class ImageLayer(PictureLayer):
    """The pixels of an image, except holes."""

    part: ClassVar[Part] = "image"
    label = "image"

    surface: ImageSurface
    valid: Bools  # (H, W): pixels that are samples
    guides: Sequence[Guide] = ()  # one row per pixel
    remarks: tuple[str, ...] = ()  # about its surface, holes and channels

    @classmethod
    def read(
        cls, document: Document, settings: SmoothSettings, access: Access, *,
        suffix: str | None = None, colours_only: bool = False,
    ) -> ImageLayer:  # fmt: skip
        """Read an image and the files that settings name.

        `colours_only` leaves out channels that are not colours, unless settings name them.
        """
        require_effect(["images"], document.name, binding_parameters(settings))
        picture, chosen = with_chosen_layer(document.image(), settings)
        only = colours_only or picture.names_colours
        colours = PictureColours.of([picture], "baseColor", chosen, is_image=True, colours_only=only)
        surface = read_surface(picture, settings.image, access)
        usable = colours.finite(picture)
        visible = ~colours.hidden(picture, slice(None)).reshape(usable.shape)
        valid = usable & visible
        if surface.valid is not None:
            valid &= surface.valid
        remarks = [*surface.notices]
        if unfit := usable.size - int(np.count_nonzero(usable)):
            remarks.append(
                f"{picture.name} has {unfit} pixels that are not finite; they are holes, and stay."
            )
        if colours.others and settings.channels is None and not colours_only:
            remarks.append(
                f"{picture.name}: the channels {', '.join(colours.others)} are smoothed too, and count as differences; "
                "--channels leaves them out."
            )
        if not valid.any():
            remedy = "" if visible.any() else "; --alpha smooth takes transparent pixels, too"
            remarks.append(f"{picture.name} has no pixel but holes, so nothing was changed{remedy}.")
        return cls(
            names=colours.names, pictures=[picture], settings=settings, colours=colours,
            surface=dataclasses.replace(surface, valid=valid), valid=valid,
            guides=read_guide_images(picture, valid, settings, access),
            noise=noise_of_pixels(settings.kernel, [picture], valid.reshape(-1), access),
            tables=[read_jpeg_tables(document.data)], suffix=suffix, remarks=tuple(remarks),
        )  # fmt: skip

    @property
    def picture(self) -> DecodedImage:
        return self.pictures[0]

    @property
    def as_data(self) -> bool:
        return self.settings.space == "data"

    def canvas(self) -> ColouredCanvas:
        return canvas_of_image(
            self.surface, partial(self.colours.working, self.picture), self.kernel,
            guides=self.guides, metric_channels=self.colours.metric_channels, deviations=self.deviations,
            light=self.colours.light_space,
        )  # fmt: skip

    @property
    def notices(self) -> Sequence[str]:  # type: ignore[override]  # read-only, as in all layers
        return [*self.picture.notices, *self.remarks]

    def _facts(self) -> dict[str, object]:
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
        if self.suffix is None and not self.valid.all() and not is_exact(self.picture):
            label = label_of(self.picture.format)
            notices.append(f"{self.picture.name}: {label} is not exact, so holes change slightly as well.")
        pixels, change = self.new_pixels(0, new)
        pixels, turned = upright(self.picture, pixels, self.suffix)
        wanted = self.settings.textures
        file, said = rewritten(self.picture, pixels, wanted, self.suffix, as_data=self.as_data)
        image = dataclasses.replace(file, suffix=self.suffix or Path(self.picture.name).suffix)
        change = self.change_in(image, 0, new, change)
        return StoredColours(change, images={("baseColor", ""): image}, notices=(*said, *turned, *notices))

    def places(self) -> Cells:
        row, column = np.nonzero(self.valid)
        return Cells([self.valid.shape], np.zeros_like(row), row, column, np.zeros_like(row))
