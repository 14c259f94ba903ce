"""Pixels of an image as samples of a manifold: their colours in the working space, and back."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int64s
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.beltrami_flow import BeltramiFlow, FlowResult
from beltrami_cli.flow.embedding import from_space, to_space
from beltrami_cli.flow.grid_manifold import GridManifold
from beltrami_cli.flow.parameters import KernelParameters, Space
from beltrami_cli.flow.records import NewColours
from beltrami_cli.formats.access import Access
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image import (
    ImageDocument,
    Picture,
    check_writable,
    is_exact,
    label_of,
)
from beltrami_cli.formats.image.metadata import CODED_TOGETHER, read_jpeg_tables
from beltrami_cli.formats.image.picture import full_scale_one, is_associated, supplies_colour
from beltrami_cli.formats.image.writing import noise_losses, upright
from beltrami_cli.samples.guides import noise_of_pixels, read_guide_images
from beltrami_cli.samples.image_surface import grid_flow, read_surface, refuse_options_of_meshes
from beltrami_cli.samples.memory_check import require_memory
from beltrami_cli.samples.reports import ImageReport
from beltrami_cli.samples.samples import (
    Change,
    Grains,
    Part,
    Repainted,
    Samples,
    as_jpeg,
    choose_channels,
    encoded,
    rewritten,
    store,
)
from beltrami_cli.samples.settings import SmoothSettings
from beltrami_cli.surface.baking import Cells
from beltrami_cli.surface.records import ImageFile

if TYPE_CHECKING:
    from beltrami_cli.samples.probes.probe import Probe

_COLOURS = ("red", "green", "blue", "grey")
_BLOCK = 1 << 20  # pixels rounded at a time, which bounds the memory for them


class ImageColours:
    """The channels of a picture that are sampled: those that change, and those that only enter the metric."""

    # Red, green and blue, or grey, are in the working space; further channels of the file are used as stored (full
    # scale 1); opacity is the last channel, if it is smoothed.

    names: tuple[str, ...]
    """Of all N channels."""

    channels: list[int]
    """Their numbers in the picture."""

    written: list[int]
    """Which of the N change."""

    metric_channels: list[int] | None
    """Which of the N enter the metric; None: all."""

    others: tuple[str, ...]
    """The names of those that are neither colours nor alpha."""

    def __init__(self, picture: Picture, settings: SmoothSettings) -> None:
        self._picture = picture
        self._space: Space = settings.space
        coloured = len(picture.colour) == 3
        if self._space == "oklab" and not coloured:
            raise UsageError(f"the space oklab needs red, green and blue, but {picture.name} is grey")
        named = dict(zip(_COLOURS[:3] if coloured else _COLOURS[3:], picture.colour, strict=True))
        for channel, name in enumerate(picture.channels):
            if channel not in (*picture.colour, picture.alpha):
                # EXR distinguishes R from r.
                named[name.lower() if name.lower() not in named else f"{name}:{channel}"] = channel
        smoothed = settings.textures.alpha == "smooth"
        opacity = {"alpha": picture.alpha} if smoothed and picture.alpha is not None else {}
        chosen = choose_channels(
            tuple(named), settings, f"{picture.name} has", opacity=bool(opacity), abbreviable=_COLOURS
        )
        every = [*(named | opacity).items()]
        self.names = tuple(every[i][0] for i in chosen.sampled)
        self.channels = [every[i][1] for i in chosen.sampled]
        self.written, self.metric_channels = chosen.written, chosen.metric
        self._coloured = [channel in picture.colour for channel in self.channels]
        # Colours that are averaged together with alpha are weighted by it already.
        self._is_divided = is_associated(picture) and not opacity and self._space != "data"
        known = (*picture.colour, picture.alpha)
        self.others = tuple(name for name, i in zip(self.names, self.channels, strict=True) if i not in known)

    @property
    def shows_all(self) -> bool:
        """Whether samples have the colours of the picture as it is stored, with all of its channels."""
        return self._space in ("srgb", "data") and self.channels == list(range(len(self._picture.channels)))

    def usable(self) -> Bools:
        """Return which pixels have finite numbers in all sampled channels, shape (H, W)."""
        pixels = self._picture.pixels
        if pixels.dtype.kind != "f":
            return np.ones(pixels.shape[:2], bool)
        return np.asarray(np.isfinite(pixels[..., self.channels]).all(axis=2))

    def visible(self) -> Bools:
        """Return which pixels supply colours, shape (H, W): not those of opacity 0, unless that is smoothed."""
        picture = self._picture
        if picture.alpha is None or picture.alpha in self.channels:
            return np.ones(picture.pixels.shape[:2], bool)
        return supplies_colour(picture, picture.pixels[..., picture.alpha])

    def samples(self, pixels: Int64s) -> Float32s:
        """Return the colours of some pixels (row * width + column) in the working space, shape (T, N)."""
        table = self._table(self._picture.pixels)
        return self._working(full_scale_one(table[pixels[:, None], self.channels]), self._opacity(pixels))

    def repainted(self, new: NewColours, threads: int) -> tuple[Array, Change]:
        """Return the picture's pixels with new colours, and how they changed; other numbers keep their bits."""
        result = self._picture.pixels.copy()
        table, changes = self._table(result), []
        channels = [self.channels[column] for column in self.written]
        for first in range(0, len(new.places), _BLOCK):
            part = slice(first, first + _BLOCK)
            block = new.places[part]
            before = full_scale_one(table[block[:, None], self.channels])
            after = self._stored(before, new.take(part, slice(None)), self._opacity(block))
            changes.append(store(self._picture, table, block, after[:, self.written], channels, threads))
        return result, Change.joined(changes)

    def _table(self, pixels: Array) -> Array:
        return pixels.reshape(-1, pixels.shape[2])

    def _opacity(self, pixels: Int64s) -> Float32s:
        """Return the opacity by which the colours of some pixels are multiplied, shape (T, 1)."""
        if not self._is_divided:
            return np.ones((1, 1), np.float32)
        return full_scale_one(self._table(self._picture.pixels)[pixels, self._picture.alpha, None])

    def _working(self, stored: Float32s, opacity: Float32s) -> Float32s:
        """Convert numbers of full scale 1 to the working space, in place."""
        if any(self._coloured):
            if self._is_divided:
                stored[:, self._coloured] /= opacity
            converted = to_space(stored[:, self._coloured], self._picture.encoding, self._space)
            stored[:, self._coloured] = converted
        return stored

    def _stored(self, before: Float32s, samples: Float32s, opacity: Float32s) -> Float32s:
        """Convert samples back from the working space; unchanged ones keep their numbers."""
        moved = self._working(before.copy(), opacity) != samples
        back = samples.copy()
        if any(self._coloured):
            colours = samples[:, self._coloured]
            back[:, self._coloured] = from_space(colours, self._picture.encoding, self._space)
            if self._is_divided:
                back[:, self._coloured] *= opacity
            if self._space == "oklab":  # which mixes the channels
                moved[:, self._coloured] = moved[:, self._coloured].any(axis=1, keepdims=True)
        return np.where(moved, back, before)


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
        self._chosen = settings
        if colours_only and settings.channels is None:
            names = ("red", "green", "blue") if len(self.picture.colour) == 3 else ("grey",)
            self._chosen = dataclasses.replace(settings, channels=names)
        self._tables = read_jpeg_tables(document.data)
        self.colours = ImageColours(self.picture, self._chosen)
        self.names = self.colours.names
        surface = read_surface(self.picture, settings.image, access)
        usable = self.colours.usable()
        self.valid = usable & self.colours.visible()
        if surface.valid is not None:
            self.valid &= surface.valid
        self.surface = dataclasses.replace(surface, valid=self.valid)
        self._unfit = usable.size - int(np.count_nonzero(usable))
        self._guides = read_guide_images(self.picture, self.valid, settings, access)
        pixels = np.flatnonzero(self.valid)
        self._noise = noise_of_pixels(settings.kernel, [self.picture], pixels, access)
        self._is_data = settings.space == "data"
        self._is_noted = settings.channels is None and not colours_only

    def flow(self, tick: Callable[[], None] | None = None) -> BeltramiFlow[GridManifold]:
        colours, kernel = self.colours, self.settings.kernel
        noise = None if self._noise is None else self._noise.reshape(-1, self._noise.shape[2])
        metric = colours.metric_channels
        coded = None
        if self._tables is not None and colours.shows_all:
            coded = self.picture.pixels, self._tables
        return grid_flow(
            self.surface, colours.samples, kernel, self._guides, metric, tick, noise, coded=coded
        )

    def window(self, place: tuple[slice, slice], kernel: KernelParameters) -> PixelSamples:
        """Return the samples of a part of the image, with other parameters."""
        part = copy.copy(self)
        part.settings = dataclasses.replace(self.settings, kernel=kernel)
        pixels = np.ascontiguousarray(self.picture.pixels[place])
        part.picture = dataclasses.replace(self.picture, pixels=pixels)
        if any(axis.start % CODED_TOGETHER for axis in place):
            part._tables = None
        part.colours = ImageColours(part.picture, self._chosen)
        part.valid, part.surface = self.valid[place], self.surface.window(place)
        part._noise = None if self._noise is None else self._noise[place]
        images = [guide.values.reshape(*self.valid.shape, -1)[place] for guide in self._guides]
        part._guides = tuple(
            dataclasses.replace(guide, values=image.reshape(-1, image.shape[2]))
            for guide, image in zip(self._guides, images, strict=True)
        )
        return part

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
            "smoothed": [self.colours.names[i] for i in self.colours.written],
            "surface": self.surface.kind,
            "holes": valid.size - int(np.count_nonzero(valid)),
        }

    def describe(self) -> dict[str, object]:
        flow, facts = self.flow(), self.facts()
        del facts["format"]  # is that of the file
        return {"image": {**facts, "pitch": flow.manifold.spacing}, **self._planned(flow)}

    def probe(self, document: Document, *, whole: bool) -> Probe:
        from beltrami_cli.samples.probes.cells import PixelProbe
        from beltrami_cli.samples.probes.probe import WorkingColours

        unit = "pixel" if self.surface.positions is None else ""
        return PixelProbe(self.flow(), WorkingColours(self.names, self.settings.space), self.picture, unit)

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
            remedy = "" if self.colours.visible().any() else "; --alpha smooth takes what is transparent, too"
            found.append(f"{name} has no pixel but holes, so nothing was smoothed{remedy}.")
        return found

    def report(self, flow: BeltramiFlow[GridManifold], result: FlowResult) -> ImageReport:
        return ImageReport(
            image=self.facts(),
            pitch=result.spacing,
            samples_per_kernel=round(result.samples_per_kernel, 2),
            **self._used(flow, result),
        )

    def repaint(self, new: NewColours) -> Repainted:
        pixels, change = self.colours.repainted(new, self.settings.kernel.thread_count)
        pixels, turned = upright(self.picture, pixels, self._suffix)
        file, notices = rewritten(
            self.picture, pixels, self.settings.textures, self._suffix, as_data=self._is_data
        )
        notices += [*turned, *self._own_notices()]
        if self._suffix is None and not self.valid.all() and not is_exact(self.picture):
            label = label_of(self.picture.format)
            notices.append(f"{self.picture.name}: {label} is not exact, so holes change slightly as well.")
        return self._repainted(file, change, notices)

    def grains(self) -> Grains:
        pixels = np.flatnonzero(self.valid)
        return Grains(self.colours.samples(pixels), np.arange(len(pixels)), space=self.settings.space)

    def cells(self) -> Cells:
        row, column = np.nonzero(self.valid)
        return Cells([self.valid.shape], np.zeros_like(row), row, column, np.zeros_like(row))

    def places(self) -> tuple[Float64s, Float64s]:
        row, column = np.nonzero(self.valid)
        return np.column_stack([column, row, np.zeros_like(row)]).astype(np.float64), np.ones(len(row))

    def coded_as_jpeg(self, quality: int) -> Float32s:
        if self.names not in (("red", "green", "blue"), ("grey",)):
            raise UsageError("JPEG codes red, green and blue together, or grey; leave out --channels")
        space, every = self.settings.space, np.arange(self.valid.size)
        shown = from_space(self.colours.samples(every), "srgb", space).reshape(*self.valid.shape, -1)
        return to_space(as_jpeg(shown, quality)[self.valid], "srgb", space)

    def shift(self, grains: Grains, after: Float32s) -> Repainted:
        new = NewColours.of(after, np.flatnonzero(self.valid))
        pixels, change = self.colours.repainted(new, threads=1)
        pixels, turned = upright(self.picture, pixels, self._suffix)
        file, notices = encoded(
            self.picture, pixels, self.settings.textures, self._suffix, as_data=self._is_data
        )
        notices += [*turned, *noise_losses(self.picture, self._suffix, "an OUTPUT in .png keeps all")]
        return self._repainted(file, change, notices)

    def _repainted(self, file: ImageFile, change: Change, notices: Sequence[str]) -> Repainted:
        suffix = self._suffix or Path(self.picture.name).suffix
        image = ImageFile(file.data, suffix)
        return Repainted(change, images={("baseColor", ""): image}, notices=tuple(notices))
