"""Conversion between the pixels of images and samples in the working space."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Indices, Int64s
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.parameters import Space
from beltrami_cli.formats.image.alpha import is_associated, supplies_colour, without_alpha
from beltrami_cli.formats.image.decoded_image import DecodedImage, require_colours
from beltrami_cli.formats.image.sample_types import full_scale_one
from beltrami_cli.layers.channels import COLOURS, ChosenChannels, choose_channels, further_channels
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.layers.units import unit_of_images
from beltrami_cli.surface.colour_values import from_space, to_space, unit_in_space
from beltrami_cli.surface.records import Slot
from beltrami_cli.surface.slots import COLOUR_SLOTS

# Channels of a data slot; other channels of the same image belong to another slot.
_SLOT_CHANNELS = {"occlusion": {"red", "grey"}, "metallicRoughness": {"green", "blue", "grey"}}
_CHOOSE_LAYER = "choose one by its name, as in --channels LAYER"
_EXPORT_LAYER = "export one layer as a file of its own"


@dataclass(frozen=True, kw_only=True)
class PixelColours:
    """The sampled channels of several images, with the same N names, and their conversion."""

    channels: ChosenChannels  # N channels are sampled
    slot: Slot
    space: Space  # of the samples: the working space, or data as stored
    width: int  # colour channels of the images; grey among coloured ones is repeated
    further: dict[str, int]  # sampled channels other than colours and opacity, by name
    has_alpha: bool  # whether opacity is sampled
    skips_transparent: bool  # whether transparent pixels supply no colour
    unit: float = 1.0  # stored number that becomes 1 in the working space

    @classmethod
    def of(
        cls, images: Sequence[DecodedImage], slot: Slot, settings: SmoothSettings, *,
        is_image: bool = False, colours_only: bool = False,
    ) -> PixelColours:  # fmt: skip
        """Choose the channels.

        `is_image`: the image is not a texture. Its further channels are sampled too, as stored, unless `colours_only`
        leaves out the channels that no setting names.
        """
        for image in images:
            require_colours(image, _CHOOSE_LAYER if is_image else _EXPORT_LAYER)
        space: Space = settings.space if slot in COLOUR_SLOTS else "data"
        width = max(len(image.colour) for image in images)
        names = COLOURS[:3] if width == 3 else COLOURS[3:]
        if space == "oklab" and width != 3:
            cause = f"{images[0].name} is grey" if is_image else "all textures are grey"
            raise UsageError(f"the space oklab needs red, green and blue, but {cause}")
        further = further_channels(images[0], names) if is_image else {}
        colours_only = colours_only and settings.channels is None
        used = _SLOT_CHANNELS.get(slot, {*names} if colours_only else {*names, *further})
        smoothes_alpha = settings.textures.alpha == "smooth"
        has_alpha = smoothes_alpha and any(image.alpha is not None for image in images)
        chosen = choose_channels(
            (*names, *further), settings, f"{images[0].name} has" if is_image else "the textures have",
            used=used, opacity=has_alpha, abbreviable=COLOURS,
        )  # fmt: skip
        if not (is_image or any(i < width for i in chosen.changing)):
            cause = f"no chosen channel belongs to the slot {slot}, which uses {' and '.join(sorted(used))}"
            raise UsageError(cause)
        return cls(
            channels=chosen, slot=slot, space=space, width=width, has_alpha=has_alpha,
            further={name: further[name] for name in chosen.names if name in further},
            skips_transparent=slot in COLOUR_SLOTS and not smoothes_alpha,
        )  # fmt: skip

    @property
    def names(self) -> tuple[str, ...]:
        return self.channels.names

    @property
    def sampled(self) -> list[int]:
        """The colour channels that are sampled."""
        return [i for i in self.channels.sampled if i < self.width]

    @property
    def changing(self) -> list[int]:
        return [i for i in self.channels.changing if i < self.width]

    @property
    def is_stored(self) -> bool:
        """Whether samples are all colour channels as stored, and nothing else."""
        is_stored = self.space in ("srgb", "data") and not self._is_normal
        return is_stored and len(self.sampled) == self.width == len(self.names)

    @property
    def _is_normal(self) -> bool:
        """Whether colours are normals, of length 1."""
        return self.slot == "normal"

    def working(self, image: DecodedImage, pixels: Int64s) -> Float32s:
        """Convert some pixels (row * width + column) of an image to the working space, shape (T, N)."""
        return self._working(image, np.take(_table(image), pixels, axis=0))

    def normalised(self, images: Sequence[DecodedImage]) -> PixelColours:
        """Return the conversion with a unit of the colours, or of further channels if no colour is sampled."""
        plain, first = dataclasses.replace(self, space="data", unit=1.0), len(self.sampled) or None
        unit = unit_of_images(
            images, lambda *where: plain.working(*where)[~self.hidden(*where), :first],
            are_data=self.space == "data",
        )  # fmt: skip
        return dataclasses.replace(self, unit=unit)

    def written_channels(self, image: DecodedImage, stored: Array) -> Float32s:
        """Convert the written channels of some pixels, shape (K, C), to the working space."""
        return self._working(image, stored)[:, self.channels.written]

    def _working(self, image: DecodedImage, stored: Array) -> Float32s:
        pixels = self._straight(image, full_scale_one(stored))
        colours = to_space(self._widened(image, pixels), image.encoding, self.space, self.unit)
        columns = [colours if len(self.sampled) == self.width else colours[:, self.sampled]]
        if self.further:
            columns.append(pixels[:, list(self.further.values())])
        if self.has_alpha:
            alpha = 1 if image.alpha is None else pixels[:, image.alpha, None]
            columns.append(np.broadcast_to(np.float32(alpha), (len(pixels), 1)))
        columns[1:] = (column / self._unit_of_further(image) for column in columns[1:])
        return columns[0] if len(columns) == 1 else np.concatenate(columns, axis=1)

    def _unit_of_further(self, image: DecodedImage) -> np.float32:
        # The ratios of differences between channels of all kinds are preserved.
        return np.float32(unit_in_space(self.unit, image.encoding, self.space))

    def finite(self, image: DecodedImage) -> Bools:
        """Return the pixels with finite numbers in all sampled channels, as a mask of shape (H, W)."""
        if image.pixels.dtype.kind != "f":
            return np.ones(image.pixels.shape[:2], bool)
        sampled = [image.colour[i] for i in self.sampled] + [*self.further.values()]
        sampled += [image.alpha] if self.has_alpha and image.alpha is not None else []
        return np.asarray(np.isfinite(image.pixels[..., sampled]).all(axis=2))

    def hidden(self, image: DecodedImage, pixels: Int64s | slice) -> Bools:
        """Return which pixels (row * width + column) of an image supply no colour."""
        table = _table(image)
        if image.alpha is None or not self.skips_transparent:
            return np.zeros(table[pixels, 0].shape, bool)
        return ~supplies_colour(image, table[pixels, image.alpha])

    def columns(self, image: DecodedImage) -> list[int]:
        is_grey, first = len(image.colour) == 1, len(self.sampled)
        colours = {image.colour[0 if is_grey else i]: None for i in self.changing}
        further = list(self.further.values())
        others = [further[i - first] for i in self.channels.written if 0 <= i - first < len(further)]
        opacity = [image.alpha] if self.has_alpha and image.alpha is not None else []
        return [*colours, *others, *opacity]

    def stored(self, image: DecodedImage, table: Array, pixels: Indices, samples: Float32s) -> Float32s:
        """Convert samples, shape (K, N), to the values of `columns`, of full scale 1.

        Conversion to the working space and back is not exact, so an unchanged sample keeps its number.
        """
        columns, count = self.columns(image), len(self.changing)
        new = (
            samples
            if self.channels.written == list(range(samples.shape[1]))
            else samples[:, self.channels.written]
        )
        is_plain = self.space in ("data", image.encoding) and len(image.colour) == self.width
        is_plain = is_plain and not self._is_normal and not self._is_divided(image)
        if is_plain and self.unit == 1:  # the numbers are stored unconverted
            return new[:, : len(columns)]
        rows = np.take(table, pixels, axis=0)
        moved = self.written_channels(image, rows) != new
        before = full_scale_one(rows)
        colours = self._colours(image, before, new[:, :count]) if count else new[:, :0]
        if colours.shape[1] < count or self._is_normal or self.space == "oklab":  # Oklab mixes the channels
            moved[:, :count] = moved[:, :count].any(axis=1, keepdims=True)
        first = count - colours.shape[1]
        others = new[:, count:] * self._unit_of_further(image)
        after = np.concatenate([colours, others], axis=1)[:, : len(columns)]
        return np.where(moved[:, first : first + len(columns)], after, before[:, columns])

    def _colours(self, image: DecodedImage, values: Float32s, new: Float32s) -> Float32s:
        """Convert new colours of pixels with old `values` of full scale 1, shape (K, C), to stored values."""
        whole = self._widened(image, self._straight(image, values))
        working = to_space(whole, image.encoding, self.space, self.unit).copy()
        working[:, self.changing] = new
        stored = from_space(working, image.encoding, self.space, self.unit)
        if self._is_normal:  # stored as (n + 1) / 2
            normals = 2 * stored - 1
            length = np.linalg.norm(normals, axis=1, keepdims=True)
            unit = (normals / np.maximum(length, 1e-12) + 1) / 2
            stored = np.where(length > 0, unit, stored).astype(np.float32)
        if image.stored in ("uint8", "uint16"):
            stored = np.clip(stored, 0, 1)
        if self._is_divided(image):
            stored *= values[:, image.alpha, None]
        return stored[:, self.changing] if len(image.colour) == 3 else stored.mean(axis=1, keepdims=True)

    def opacity(self, image: DecodedImage) -> Float32s | None:
        """Return the opacity that multiplies an image's colours but not its samples, shape (H, W), or None."""
        return full_scale_one(image.pixels[..., image.alpha]) if self._is_divided(image) else None

    def _is_divided(self, image: DecodedImage) -> bool:
        # If alpha is averaged too, the samples are multiplied by it already.
        return self.skips_transparent and self.space != "data" and is_associated(image)

    def _straight(self, image: DecodedImage, pixels: Float32s) -> Float32s:
        return without_alpha(image, pixels) if self._is_divided(image) else pixels

    def _widened(self, image: DecodedImage, pixels: Float32s) -> Float32s:
        every = tuple(range(pixels.shape[1]))
        colours = pixels if image.colour == every else pixels[:, list(image.colour)]
        return np.repeat(colours, self.width, axis=1) if colours.shape[1] < self.width else colours


def _table(image: DecodedImage) -> Array:
    return image.pixels.reshape(-1, image.pixels.shape[2])
