"""Pixels of an image as samples of a manifold: of its plane, of a height map over it, or of a map of positions."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from beltrami_cli.errors import UsageError
from beltrami_cli.flow.manifold import NewColours
from beltrami_cli.formats.image import (
    check_writable,
    is_exact,
    is_unchanged,
    label_of,
    losses,
)
from beltrami_cli.formats.image.conversion import noise_losses
from beltrami_cli.samples.guides import read_guide_images
from beltrami_cli.samples.image_surface import grid_flow, read_surface
from beltrami_cli.samples.memory_check import require_memory
from beltrami_cli.samples.pixel_colours import ImageColours
from beltrami_cli.samples.reports import ImageReport
from beltrami_cli.samples.samples import Grains, Part, Repainted, Samples, encoded, options_of_meshes
from beltrami_cli.samples.settings import DEFAULTS, describe_kernel
from beltrami_cli.surface.records import ImageFile

if TYPE_CHECKING:
    from collections.abc import Sequence

    from beltrami_cli.arrays import Array, Float32s, Int64s
    from beltrami_cli.flow.beltrami_flow import BeltramiFlow, FlowResult
    from beltrami_cli.flow.grid_manifold import GridManifold
    from beltrami_cli.formats.access import Access
    from beltrami_cli.formats.document import Document
    from beltrami_cli.formats.image.document import ImageDocument
    from beltrami_cli.samples.probes.probe import Probe
    from beltrami_cli.samples.samples import Change
    from beltrami_cli.samples.settings import SmoothSettings

    Pixels = Int64s


class PixelSamples(Samples):
    """Pixels of an image that are no holes: by its mask or surface, for numbers that are not finite, or unseen.

    `suffix` names another format to write. `colours_only` leaves out channels that are no colours, unless they are
    named.
    """

    part: ClassVar[Part] = "image"
    label = "image"

    def __init__(
        self,
        document: ImageDocument,
        settings: SmoothSettings,
        access: Access,
        suffix: str | None = None,
        *,
        colours_only: bool = False,
    ) -> None:
        refuse_options_of_meshes(settings, document.name)
        require_memory([(document.name, document.data)], access)
        self.settings, self.picture, self._suffix = settings, document.picture(), suffix
        chosen = settings
        if colours_only and settings.channels is None:
            names = ("red", "green", "blue") if len(self.picture.colour) == 3 else ("grey",)
            chosen = dataclasses.replace(settings, channels=names)
        self.colours = ImageColours(self.picture, chosen)
        self.names = self.colours.names
        surface = read_surface(self.picture, settings.image, access)
        usable = self.colours.usable()
        self.valid = usable & self.colours.visible()
        if surface.valid is not None:
            self.valid &= surface.valid
        self.surface = dataclasses.replace(surface, valid=self.valid)
        self._unfit = usable.size - int(np.count_nonzero(usable))
        self._guides = read_guide_images(self.picture, self.valid, settings, access)
        self._is_noted = settings.channels is None and not colours_only

    def flow(self) -> BeltramiFlow[GridManifold]:
        colours, guides = self.colours, [guide.at for guide in self._guides]
        kernel = self.settings.kernel
        return grid_flow(self.surface, colours.samples, kernel, guides, colours.metric_channels)

    def require_writable(self) -> None:
        check_writable(self.picture, self._suffix)

    def facts(self) -> dict[str, object]:
        picture, valid = self.picture, self.valid
        return {
            "width": valid.shape[1],
            "height": valid.shape[0],
            "format": picture.format,
            "stored": picture.stored,
            "channels": list(picture.channels),
            "encoding": picture.encoding,
            "smoothed": list(self.colours.changing),
            "surface": self.surface.kind,
            "holes": valid.size - int(np.count_nonzero(valid)),
        }

    def describe(self) -> dict[str, object]:
        flow, facts = self.flow(), self.facts()
        del facts["format"]  # is that of the file
        return {
            "image": {**facts, "pitch": flow.manifold.spacing},
            "noise": self.named(flow.manifold.noise),
            "smooth": describe_kernel(self.settings, flow),
        }

    def probe(self, document: Document, *, whole: bool) -> Probe:
        from beltrami_cli.samples.probes.cells import PixelProbe
        from beltrami_cli.samples.probes.probe import WorkingColours

        unit = "pixel" if self.surface.positions is None else ""
        return PixelProbe(self.flow(), WorkingColours(self.names, self.settings.space), self.picture, unit)

    def notices(self) -> list[str]:
        name = self.picture.name
        found = [*self.picture.notices, *self.surface.notices]
        if self._unfit:
            found.append(
                f"{name} has {self._unfit} pixels that are no finite numbers; they are holes, and stay."
            )
        if self.colours.others and self._is_noted:
            found.append(
                f"{name}: the channels {', '.join(self.colours.others)} are smoothed too, and count as differences; "
                "--channels leaves them out."
            )
        if not self.valid.any():
            found.append(f"{name} has no pixel but holes, so nothing was smoothed.")
        return found

    def report(self, flow: BeltramiFlow[GridManifold], result: FlowResult) -> ImageReport:
        return ImageReport(
            image=self.facts(),
            pitch=result.spacing,
            samples_per_kernel=round(result.samples_per_kernel, 2),
            change={},
            **self._used(flow, result),
        )

    def repaint(self, new: NewColours) -> Repainted:
        pixels, change = self.colours.repainted(new, self.settings.kernel.thread_count)
        picture, suffix = self.picture, self._suffix
        notices = self.notices()
        if suffix is None and is_unchanged(picture, pixels):
            notices = [notice for notice in notices if notice not in picture.notices]
            data = picture.source
        else:
            file = self._encoded(pixels)
            data, notices = file.data, [*notices, *file.notices]
        if suffix is not None:
            notices += losses(picture, suffix)
        elif not self.valid.all() and not is_exact(picture):
            label = label_of(picture.format)
            notices.append(f"{picture.name}: {label} is not exact, so holes change slightly as well.")
        return self._repainted(data, change, notices)

    def grains(self) -> Grains:
        pixels = np.flatnonzero(self.valid)
        return Grains(self.colours.samples(pixels), np.arange(len(pixels)))

    def shift(self, grains: Grains, after: Float32s) -> Repainted:
        new = NewColours.of(after, np.flatnonzero(self.valid))
        pixels, change = self.colours.repainted(new, threads=1)
        picture, suffix = self.picture, self._suffix
        notices = [*picture.notices]
        if suffix is not None:
            notices += losses(picture, suffix)
        file = self._encoded(pixels)
        return self._repainted(
            file.data,
            change,
            [*notices, *file.notices, *noise_losses(picture, suffix, "an OUTPUT in .png keeps all")],
        )

    def _encoded(self, pixels: Array) -> ImageFile:
        is_data = self.settings.space == "data"
        return encoded(self.picture, pixels, self.settings.textures, self._suffix, as_data=is_data)

    def _repainted(self, data: bytes, change: Change, notices: Sequence[str]) -> Repainted:
        suffix = self._suffix or Path(self.picture.name).suffix
        return Repainted(change, images={("baseColor", ""): ImageFile(data, suffix)}, notices=tuple(notices))


def refuse_options_of_meshes(settings: SmoothSettings, name: str) -> None:
    """Raise UsageError for options that only meshes and their textures have."""
    textures, usual = settings.textures, DEFAULTS.textures
    given = {
        "--on": settings.on != DEFAULTS.on,
        "--slots": textures.slots != usual.slots,
        "--material": textures.materials != usual.materials,
        "--texture": textures.names != usual.names,
        "--gutter": textures.gutter != usual.gutter,
        "--texture-format": textures.image_suffix != usual.image_suffix,
        **options_of_meshes(settings),
    }
    wrong = [option for option, is_given in given.items() if is_given]
    if not wrong:
        return
    remedy = (
        "end the name of OUTPUT in the extension instead" if "--texture-format" in wrong else "leave it out"
    )
    raise UsageError(f"{', '.join(wrong)}: for meshes only, but {name} is an image; {remedy}")
