"""Pictures as samples of a manifold: colours in the working space and back."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Indices, Int64s
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.chunks import IN_ONE_PIECE, Resources
from beltrami_cli.flow.corrections.coded_picture import CodedPicture
from beltrami_cli.flow.decoding import decodes_again, plan_on_canvas
from beltrami_cli.flow.manifolds.grid_manifold import ColouredCanvas, GridManifold
from beltrami_cli.flow.manifolds.new_colours import NewColours
from beltrami_cli.flow.parameters import Space
from beltrami_cli.flow.plan import Plan
from beltrami_cli.formats.image import DecodedImage, check_writable
from beltrami_cli.formats.image.channels import coloured_layers, colours_and_alpha, layers_of
from beltrami_cli.formats.image.conversion import upright
from beltrami_cli.formats.image.decoded_image import (
    full_scale_one,
    is_associated,
    require_colours,
    supplies_colour,
    with_colours_of,
    without_alpha,
)
from beltrami_cli.formats.image.jpeg_tables import JpegTables
from beltrami_cli.formats.image.writing import colours_in_file, is_kept
from beltrami_cli.layers.layer import Change, Layer, choose_channels, dithered, store
from beltrami_cli.layers.settings import COLOUR_SLOTS, SmoothSettings
from beltrami_cli.layers.units import unit_of_pictures
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import Atlas, texels_by_texture
from beltrami_cli.surface.colour_values import from_space, to_space, unit_in_space
from beltrami_cli.surface.records import ImageFile, Slot

COLOURS = ("red", "green", "blue", "grey")
# Channels of a data slot; other channels of the same image belong to another slot.
_SLOT_CHANNELS = {"occlusion": {"red", "grey"}, "metallicRoughness": {"green", "blue", "grey"}}

_CHOOSE_LAYER = "choose one by its name, as in --channels LAYER"
_EXPORT_LAYER = "export one layer as a file of its own"

_ROWS = 64  # processed at a time


@dataclass(frozen=True, kw_only=True, eq=False)
class PictureLayer(Layer):
    """Common base of the texels of textures and the pixels of an image."""

    names: tuple[str, ...]
    settings: SmoothSettings
    pictures: Sequence[DecodedImage]
    tables: Sequence[JpegTables | None]  # of each picture; None: not a JPEG file
    colours: PictureColours
    atlas: Atlas | None = None  # None: not a texture
    noise: Float32s | None = None  # standard deviations, one row per sample or, in images, pixel
    suffix: str | None = None  # extension of another output format

    def normalised(self) -> Self:
        return dataclasses.replace(self, colours=self.colours.normalised(self.pictures))

    def unit_in(self, space: str) -> float:
        return unit_in_space(self.colours.unit, self.pictures[0].encoding, space)

    @property
    @abstractmethod
    def as_data(self) -> bool:
        """Whether the pictures contain data, whose encoding must not change."""

    @abstractmethod
    def canvas(self) -> ColouredCanvas:
        """Return the canvas of the samples, with parameters in its unit of length."""

    def plan(
        self, tick: Callable[[], None] | None = None, resources: Resources = IN_ONE_PIECE
    ) -> Plan[GridManifold]:
        canvas, pictures = dataclasses.replace(self.canvas(), resources=resources), list[CodedPicture]()
        if self.colours.shows_all and decodes_again(canvas.parameters):
            pixels = [picture.pixels for picture in self.pictures]
            pictures = coded_pictures(canvas.atlas, list(zip(pixels, self.tables, strict=True)))
        return plan_on_canvas(canvas, pictures, tick)

    def require_writable(self) -> None:
        for picture in self.pictures:
            check_writable(picture, self.suffix)

    def new_pixels(self, index: int, new: NewColours, *, is_dithered: bool = False) -> tuple[Array, Change]:
        """Return a picture's pixels with new colours, and the change; unchanged numbers keep their bits.

        `is_dithered`: add dither against banding in 8 bits.
        """
        pixels = large_arrays.copy_of(self.pictures[index].pixels)
        return pixels, self._fill(pixels, index, new.places, new.take, is_dithered=is_dithered)

    def change_in(self, file: ImageFile, index: int, new: NewColours, change: Change) -> Change:
        """Return the change of a picture's samples in the written file, if the format lost some of it."""
        picture, as_data = self.pictures[index], self.as_data
        if file.content == picture.source:
            return Change(change.count)
        if is_kept(picture, file):
            return change
        before, after = colours_in_file(picture, file, as_data=as_data)
        before, _ = upright(picture, before, self.suffix if self.atlas is None else None)
        where = np.zeros((*picture.pixels.shape[:2], 1), bool)
        for block in large_arrays.blocks(len(new.places)):
            where.reshape(-1)[self._of_picture(new.places[block], index)[1]] = True
        where = upright(picture, where, self.suffix if self.atlas is None else None)[0][..., 0]
        channels = [i for i in self.colours.changing if i < after.shape[2]] or [*range(after.shape[2])]
        return Change.joined(
            Change.between(
                *(full_scale_one(each[rows][where[rows]][:, channels]) for each in (before, after))
            )
            for rows in large_arrays.blocks(len(after), _ROWS)
        )

    def _of_picture(self, texels: Indices, index: int) -> tuple[Bools | slice, Indices]:
        """Return the texels of one picture, relative to its first, and their rows."""
        if len(self.pictures) == 1 or self.atlas is None:
            return slice(None), texels
        begin, end = self.atlas.texture_offsets[index : index + 2].tolist()
        inside = (texels >= begin) & (texels < end)
        return inside, texels[inside] - begin

    def _fill(
        self, pixels: Array, index: int, texels: Indices, take: Callable[[slice, Bools | slice], Float32s], *,
        is_dithered: bool,
    ) -> Change:  # fmt: skip
        """Write samples into a picture's pixels in place, and return the change."""
        picture, colours, threads = self.pictures[index], self.colours, self.settings.kernel.thread_count
        table, changes = pixels.reshape(-1, pixels.shape[2]), []
        for block in large_arrays.blocks(len(texels), large_arrays.CACHED):
            inside, here = self._of_picture(texels[block], index)
            if not len(here):
                continue
            values = colours.stored(picture, table, here, take(block, inside))
            if is_dithered and picture.stored == "uint8":
                values = dithered(values, here, picture.pixels.shape[1])
            changes.append(store(picture, table, here, values, colours.columns(picture), threads))
        return Change.joined(changes)


@dataclass(frozen=True, kw_only=True)
class PictureColours:
    """The sampled channels of several pictures, with the same N names, and their conversion."""

    names: tuple[str, ...]  # of the N channels: changing ones, and ones that only enter the metric
    written: list[int]  # those of the N channels that change
    metric_channels: list[int] | None  # those of the N channels in the metric; None: all
    space: Space  # of the samples: the working space, or data as stored
    shows_all: bool  # whether samples have all colour channels as stored
    light_space: Space | None  # `space` if colours stand for light, as floats do; else None
    width: int  # colour channels of the pictures; grey among coloured ones is repeated
    kept: list[int]  # those that are sampled
    changing: list[int]  # those that change
    others: dict[str, int]  # sampled channels other than colours and opacity, by name
    has_alpha: bool  # whether opacity is sampled
    hides: bool  # whether transparent pixels supply no colour
    is_normal: bool  # whether colours are normals, of length 1
    unit: float = 1.0  # stored number that becomes 1 in the working space

    @classmethod
    def of(
        cls, pictures: Sequence[DecodedImage], slot: Slot, settings: SmoothSettings, *,
        is_image: bool = False, colours_only: bool = False,
    ) -> PictureColours:  # fmt: skip
        """Choose the channels.

        `is_image`: the picture is not a texture. Its further channels are sampled too, as stored, unless `colours_only`
        leaves out the channels that no setting names.
        """
        for picture in pictures:
            require_colours(picture, _CHOOSE_LAYER if is_image else _EXPORT_LAYER)
        space: Space = settings.space if slot in COLOUR_SLOTS else "data"
        width = max(len(picture.colour) for picture in pictures)
        names = COLOURS[:3] if width == 3 else COLOURS[3:]
        if space == "oklab" and width != 3:
            cause = f"{pictures[0].name} is grey" if is_image else "all textures are grey"
            raise UsageError(f"the space oklab needs red, green and blue, but {cause}")
        further = _further_channels(pictures[0], names) if is_image else {}
        colours_only = colours_only and settings.channels is None
        used = _SLOT_CHANNELS.get(slot, {*names} if colours_only else {*names, *further})
        smoothes_alpha = settings.textures.alpha == "smooth"
        has_alpha = smoothes_alpha and any(picture.alpha is not None for picture in pictures)
        chosen = choose_channels(
            (*names, *further), settings, f"{pictures[0].name} has" if is_image else "the textures have",
            used=used, opacity=has_alpha, abbreviable=COLOURS,
        )  # fmt: skip
        changing = [i for i in chosen.changing if i < width]
        if not (changing or is_image):
            cause = f"no chosen channel belongs to the slot {slot}, which uses {' and '.join(sorted(used))}"
            raise UsageError(cause)
        sampled = tuple((*names, *further, "alpha")[i] for i in chosen.sampled)
        kept = [i for i in chosen.sampled if i < width]
        further_channels = {name: further[name] for name in sampled if name in further}
        is_plain = space in ("srgb", "data") and not (has_alpha or further_channels or slot == "normal")
        is_light = space != "data" and all(picture.encoding == "linear" for picture in pictures)
        return cls(
            names=sampled, written=chosen.written, metric_channels=chosen.metric, space=space,
            shows_all=is_plain and len(kept) == width, light_space=space if is_light else None, width=width,
            kept=kept, changing=changing, others=further_channels, has_alpha=has_alpha,
            hides=slot in COLOUR_SLOTS and not smoothes_alpha, is_normal=slot == "normal",
        )  # fmt: skip

    def working(self, picture: DecodedImage, pixels: Int64s) -> Float32s:
        """Convert some pixels (row * width + column) of a picture to the working space, shape (T, N)."""
        return self._working(picture, np.take(_table(picture), pixels, axis=0))

    def normalised(self, pictures: Sequence[DecodedImage]) -> PictureColours:
        """Return the conversion with a unit of the colours, or of further channels if no colour is sampled."""
        plain, first = dataclasses.replace(self, space="data", unit=1.0), len(self.kept) or None
        unit = unit_of_pictures(
            pictures, lambda *where: plain.working(*where)[~self.hidden(*where), :first],
            are_data=self.space == "data",
        )  # fmt: skip
        return dataclasses.replace(self, unit=unit)

    def shown(self, picture: DecodedImage, stored: Array) -> Float32s:
        """Convert the written channels of some pixels, shape (K, C), to the working space."""
        return self._working(picture, stored)[:, self.written]

    def _working(self, picture: DecodedImage, stored: Array) -> Float32s:
        pixels = self._straight(picture, full_scale_one(stored))
        colours = to_space(self._widened(picture, pixels), picture.encoding, self.space, self.unit)
        columns = [colours if len(self.kept) == self.width else colours[:, self.kept]]
        if self.others:
            columns.append(pixels[:, list(self.others.values())])
        if self.has_alpha:
            alpha = 1 if picture.alpha is None else pixels[:, picture.alpha, None]
            columns.append(np.broadcast_to(np.float32(alpha), (len(pixels), 1)))
        columns[1:] = (column / self._unit_of_others(picture) for column in columns[1:])
        return columns[0] if len(columns) == 1 else np.concatenate(columns, axis=1)

    def _unit_of_others(self, picture: DecodedImage) -> np.float32:
        # The ratios of differences between channels of all kinds are preserved.
        return np.float32(unit_in_space(self.unit, picture.encoding, self.space))

    def finite(self, picture: DecodedImage) -> Bools:
        """Return the pixels with finite numbers in all sampled channels, as a mask of shape (H, W)."""
        if picture.pixels.dtype.kind != "f":
            return np.ones(picture.pixels.shape[:2], bool)
        sampled = [picture.colour[i] for i in self.kept] + [*self.others.values()]
        sampled += [picture.alpha] if self.has_alpha and picture.alpha is not None else []
        return np.asarray(np.isfinite(picture.pixels[..., sampled]).all(axis=2))

    def hidden(self, picture: DecodedImage, pixels: Int64s | slice) -> Bools:
        """Return which pixels (row * width + column) of a picture supply no colour."""
        table = _table(picture)
        if picture.alpha is None or not self.hides:
            return np.zeros(table[pixels, 0].shape, bool)
        return ~supplies_colour(picture, table[pixels, picture.alpha])

    def columns(self, picture: DecodedImage) -> list[int]:
        """Return the channels of a picture that change."""
        is_grey, first = len(picture.colour) == 1, len(self.kept)
        colours = {picture.colour[0 if is_grey else i]: None for i in self.changing}
        further = list(self.others.values())
        others = [further[i - first] for i in self.written if 0 <= i - first < len(further)]
        opacity = [picture.alpha] if self.has_alpha and picture.alpha is not None else []
        return [*colours, *others, *opacity]

    def stored(self, picture: DecodedImage, table: Array, pixels: Indices, samples: Float32s) -> Float32s:
        """Convert samples, shape (K, N), to the values of `columns`, of full scale 1.

        Conversion to the working space and back is not exact, so an unchanged sample keeps its number.
        """
        columns, count = self.columns(picture), len(self.changing)
        new = samples if self.written == list(range(samples.shape[1])) else samples[:, self.written]
        is_plain = self.space in ("data", picture.encoding) and len(picture.colour) == self.width
        is_plain = is_plain and not self.is_normal and not self._is_divided(picture)
        if is_plain and self.unit == 1:  # the numbers are stored unconverted
            return new[:, : len(columns)]
        rows = np.take(table, pixels, axis=0)
        moved = self.shown(picture, rows) != new
        before = full_scale_one(rows)
        colours = self._colours(picture, before, new[:, :count]) if count else new[:, :0]
        if colours.shape[1] < count or self.is_normal or self.space == "oklab":  # Oklab mixes the channels
            moved[:, :count] = moved[:, :count].any(axis=1, keepdims=True)
        first = count - colours.shape[1]
        others = new[:, count:] * self._unit_of_others(picture)
        after = np.concatenate([colours, others], axis=1)[:, : len(columns)]
        return np.where(moved[:, first : first + len(columns)], after, before[:, columns])

    def _colours(self, picture: DecodedImage, values: Float32s, new: Float32s) -> Float32s:
        """Convert new colours of pixels with old `values` of full scale 1, shape (K, C), to stored values."""
        whole = self._widened(picture, self._straight(picture, values))
        working = to_space(whole, picture.encoding, self.space, self.unit).copy()
        working[:, self.changing] = new
        stored = from_space(working, picture.encoding, self.space, self.unit)
        if self.is_normal:  # stored as (n + 1) / 2
            normals = 2 * stored - 1
            length = np.linalg.norm(normals, axis=1, keepdims=True)
            unit = (normals / np.maximum(length, 1e-12) + 1) / 2
            stored = np.where(length > 0, unit, stored).astype(np.float32)
        if picture.stored in ("uint8", "uint16"):
            stored = np.clip(stored, 0, 1)
        if self._is_divided(picture):
            stored *= values[:, picture.alpha, None]
        return stored[:, self.changing] if len(picture.colour) == 3 else stored.mean(axis=1, keepdims=True)

    def opacity(self, picture: DecodedImage) -> Float32s | None:
        """Return the opacity that multiplies a picture's colours but not its samples, shape (H, W), or None."""
        return full_scale_one(picture.pixels[..., picture.alpha]) if self._is_divided(picture) else None

    def _is_divided(self, picture: DecodedImage) -> bool:
        # If alpha is averaged too, the samples are multiplied by it already.
        return self.hides and self.space != "data" and is_associated(picture)

    def _straight(self, picture: DecodedImage, pixels: Float32s) -> Float32s:
        return without_alpha(picture, pixels) if self._is_divided(picture) else pixels

    def _widened(self, picture: DecodedImage, pixels: Float32s) -> Float32s:
        every = tuple(range(pixels.shape[1]))
        colours = pixels if picture.colour == every else pixels[:, list(picture.colour)]
        return np.repeat(colours, self.width, axis=1) if colours.shape[1] < self.width else colours


def _table(picture: DecodedImage) -> Array:
    return picture.pixels.reshape(-1, picture.pixels.shape[2])


def _further_channels(picture: DecodedImage, names: Sequence[str]) -> dict[str, int]:
    """Return the channels of a picture that are neither colours nor opacity, by name."""
    known = dict.fromkeys(names, -1)
    for channel, name in enumerate(picture.channels):
        if channel not in (*picture.colour, picture.alpha):
            # EXR distinguishes R from r.
            known[name.lower() if name.lower() not in known else f"{name}:{channel}"] = channel
    return {name: channel for name, channel in known.items() if channel >= 0}


def with_chosen_layer(picture: DecodedImage, settings: SmoothSettings) -> tuple[DecodedImage, SmoothSettings]:
    """Return a picture with the colours of the layer that `settings.channels` chooses, if any.

    In the returned settings, the channels of that layer have the names of colours.
    """
    if settings.channels is None or not picture.is_layered:
        return picture, settings
    members = layers_of(picture.channels)
    layers = {layer.lower(): layer for layer in members if layer}
    words = [word.lower() for word in settings.channels]
    layer = _chosen_layer(picture, layers, words)
    if layer is not None:
        picture = with_colours_of(picture, layer)
    names = COLOURS[:3] if len(picture.colour) == 3 else COLOURS[3:]
    colours = {picture.channels[i].lower(): name for i, name in zip(picture.colour, names, strict=True)}
    chosen = list[str]()
    for word in words:
        if word not in layers:
            chosen.append(colours.get(word, word))
        elif layers[word] == picture.layer:
            chosen += names
        else:
            chosen += (picture.channels[i].lower() for i in members[layers[word]])
    return picture, dataclasses.replace(settings, channels=tuple(chosen))


def _chosen_layer(picture: DecodedImage, layers: dict[str, str], words: Sequence[str]) -> str | None:
    """Return the first layer that a word names, or whose colour it names; None if words only name colours."""
    if any(name.startswith(word) for word in words for name in COLOURS):
        return None
    colours = {
        picture.channels[i].lower(): layer
        for layer in coloured_layers(picture.channels)
        for i in colours_and_alpha(picture.channels, layer)[0]
    }
    return next(
        (layer for word in words if (layer := layers.get(word) or colours.get(word)) is not None), None
    )


def coded_pictures(atlas: Atlas, coded: Sequence[tuple[Array, JpegTables | None]]) -> list[CodedPicture]:
    """Return pictures with the tables of their files; empty unless all are JPEG, and all grey or all coloured."""
    known = [(pixels, tables) for pixels, tables in coded if tables is not None and pixels.dtype == np.uint8]
    if len(known) < len(coded) or len({pixels.shape[2] for pixels, _ in known}) != 1:
        return []
    used = [large_arrays.zeros(pixels.shape[:2], bool) for pixels, _ in known]
    for block in large_arrays.blocks(len(atlas.owned_texels)):
        for index, _, texels in texels_by_texture(atlas.texture_offsets, atlas.owned_texels[block]):
            used[index].reshape(-1)[texels] = True
    return [
        CodedPicture(pixels, mask, tables.steps, tables.span)
        for (pixels, tables), mask in zip(known, used, strict=True)
    ]
