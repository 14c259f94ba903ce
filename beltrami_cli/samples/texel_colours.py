"""From pictures to the colours of samples in the working space, and back with the gutters around charts refilled."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from functools import partial

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Int64s
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.canvas import painted_by
from beltrami_cli.flow.embedding import from_space, to_space
from beltrami_cli.flow.parameters import Space
from beltrami_cli.flow.records import NewColours
from beltrami_cli.formats.image import Picture
from beltrami_cli.formats.image.picture import full_scale_one, is_associated, supplies_colour, without_alpha
from beltrami_cli.samples.gutters import Refilled, keep_others
from beltrami_cli.samples.samples import Change, choose_channels, store
from beltrami_cli.samples.settings import COLOUR_SLOTS, SmoothSettings, TextureSettings
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import Atlas, Indices, fill_gutter, texels_by_texture, within
from beltrami_cli.surface.records import Slot, Texture, TexturedSurface


def choose_textures(surface: TexturedSurface, wanted: TextureSettings) -> TexturedSurface:
    """Keep the textures that match the globs, possibly none."""

    def fits(texture: Texture) -> bool:
        by_name = not wanted.names or any(fnmatch(texture.name, glob) for glob in wanted.names)
        by_material = not wanted.materials or any(
            fnmatch(material, glob) for material in texture.materials for glob in wanted.materials
        )
        return by_name and by_material

    return only_textures(surface, [i for i, texture in enumerate(surface.textures) if fits(texture)])


def only_textures(surface: TexturedSurface, kept: list[int]) -> TexturedSurface:
    """Keep the textures of these indices; triangles of the others have none."""
    new_index = np.full(len(surface.textures) + 1, -1, np.int32)
    new_index[kept] = np.arange(len(kept), dtype=np.int32)
    textures = tuple(surface.textures[index] for index in kept)
    return dataclasses.replace(surface, textures=textures, texture_of=new_index[surface.texture_of])


# The channels that a data slot uses; others of the same image belong to another slot.
_SLOT_CHANNELS = {"occlusion": {"red", "grey"}, "metallicRoughness": {"green", "blue", "grey"}}


class TexelColours:
    """Colours of the texels of several pictures as samples with the same N channels, and back."""

    names: tuple[str, ...]
    """The channels of the samples: those that change, and those that enter the metric."""

    metric_channels: list[int] | None
    """The channels in the metric; None: all."""

    space: Space
    """The space of the samples: the working space, or data as stored."""

    def __init__(self, pictures: Sequence[Picture], slot: Slot, settings: SmoothSettings) -> None:
        self._pictures = pictures
        self.space = settings.space if slot in COLOUR_SLOTS else "data"
        self._is_normal = slot == "normal"
        self._width = max(len(picture.colour) for picture in pictures)
        # Grey pictures beside coloured ones have red = green = blue.
        names = ("red", "green", "blue") if self._width == 3 else ("grey",)
        if self.space == "oklab" and self._width != 3:
            raise UsageError("the space oklab needs red, green and blue, but all textures are grey")
        used = _SLOT_CHANNELS.get(slot, set(names))
        self._hides = slot in COLOUR_SLOTS and settings.textures.alpha != "smooth"
        self._alpha = settings.textures.alpha == "smooth" and any(p.alpha is not None for p in pictures)
        chosen = choose_channels(names, settings, "the textures have", used=used, opacity=self._alpha)
        self._changing = [i for i in chosen.changing if i < len(names)]
        if not self._changing:
            cause = f"no chosen channel belongs to the slot {slot}, which uses {' and '.join(sorted(used))}"
            raise UsageError(cause)
        self._kept = [i for i in chosen.sampled if i < len(names)]
        self._written, self.metric_channels = chosen.written, chosen.metric
        self.names = tuple((*names, "alpha")[i] for i in chosen.sampled)

    @property
    def shows_all(self) -> bool:
        """Whether samples have the colours of pictures as they are stored, with all of their channels."""
        alike = self.space in ("srgb", "data") and not self._alpha and not self._is_normal
        return alike and len(self._kept) == self._width

    def samples(self, atlas: Atlas) -> Float32s:
        """Return the colours of the owned cells in the working space, shape (T, N)."""
        table = large_arrays.empty((len(atlas.owned_texels), len(self.names)), np.float32)
        for block in large_arrays.blocks(len(table)):
            table[block] = self._of_block(atlas, block)
        return table

    def on_canvas(self, atlas: Atlas, threads: int) -> Float32s:
        """Return the colours of the owned cells, and of what continues them, on the canvas, shape (N, R, C)."""
        return painted_by(atlas, len(self.names), lambda block: self._of_block(atlas, block), threads)

    def _of_block(self, atlas: Atlas, block: slice) -> Float32s:
        texels = atlas.owned_texels[block]
        table = np.empty((len(texels), len(self.names)), np.float32)
        for index, inside, own in texels_by_texture(atlas.texture_offsets, texels):
            table[inside] = self.working(self._pictures[index], own)
        return table

    def working(self, picture: Picture, texels: Int64s) -> Float32s:
        """Return the colours of some texels (row * width + column) of a picture in the working space."""
        table = picture.pixels.reshape(-1, picture.pixels.shape[2])
        return self._working(picture, np.take(table, texels, axis=0))

    def shown(self, picture: Picture, stored: Array) -> Float32s:
        """Return the channels that are written of some pixels of a picture, shape (K, C), in the working space."""
        return self._working(picture, stored)[:, self._written]

    def _working(self, picture: Picture, stored: Array) -> Float32s:
        """Return the colours of some pixels of a picture, shape (K, C), in the working space."""
        pixels = self._straight(picture, full_scale_one(stored))
        working = to_space(self._widened(picture, pixels), picture.encoding, self.space)
        if len(self._kept) < self._width:
            working = working[:, self._kept]
        if not self._alpha:
            return working
        opacity = pixels[:, picture.alpha] if picture.alpha is not None else np.ones(len(pixels), np.float32)
        return np.column_stack([working, opacity])

    def transparent(self, atlas: Atlas, textures: Sequence[Texture]) -> Bools:
        """Return which owned cells supply no colour because their texel is transparent."""
        hidden = np.zeros(len(atlas.owned_texels), bool)
        if not any(self._can_hide(index, texture) for index, texture in enumerate(textures)):
            return hidden
        for block in large_arrays.blocks(len(hidden)):
            for index, inside, texels in texels_by_texture(atlas.texture_offsets, atlas.owned_texels[block]):
                hidden[block][inside] = self.hidden(index, textures[index], texels)
        return hidden

    def hidden(self, index: int, texture: Texture, texels: Int64s) -> Bools:
        """Return which of some texels (row * width + column) of a picture supply no colour."""
        picture = self._pictures[index]
        if not self._can_hide(index, texture):
            return np.zeros(len(texels), bool)
        table = picture.pixels.reshape(-1, picture.pixels.shape[2])
        return ~supplies_colour(picture, table[texels, picture.alpha])

    def _can_hide(self, index: int, texture: Texture) -> bool:
        return self._hides and self._pictures[index].alpha is not None and texture.alpha_hides

    def columns(self, index: int) -> list[int]:
        """Return which channels of a picture change."""
        picture = self._pictures[index]
        is_grey = len(picture.colour) == 1
        colour = list(picture.colour) if is_grey else [picture.colour[i] for i in self._changing]
        return colour + ([picture.alpha] if self._alpha and picture.alpha is not None else [])

    def are_converted(self, index: int) -> bool:
        """Return whether samples of a picture differ from the numbers that it stores."""
        picture = self._pictures[index]
        is_plain = self.space in ("data", picture.encoding) and len(picture.colour) == self._width
        return not is_plain or self._is_normal or self._is_divided(picture)

    def written(self, index: int, samples: Float32s) -> Float32s:
        """Return the channels of unconverted samples that are stored, in the order of `columns`."""
        chosen = self._written[: len(self.columns(index))]
        return samples if chosen == list(range(samples.shape[1])) else samples[:, chosen]

    def changed(self, picture: Picture, stored: Array, samples: Float32s) -> Bools:
        """Return for which pixels of a picture, shape (K, C), samples differ in a channel that is written."""
        working = self._working(picture, stored)
        different = np.zeros(len(stored), bool)
        for channel in self._written:
            different |= working[:, channel] != samples[:, channel]
        return different

    def write(self, values: Float32s, index: int, samples: Float32s) -> None:
        """Write samples, shape (K, N), to pixels of a picture, shape (K, C), of full scale 1, in place."""
        picture = self._pictures[index]
        whole = self._widened(picture, self._straight(picture, values))
        working = to_space(whole, picture.encoding, self.space).copy()
        working[:, self._changing] = samples[:, self._written[: len(self._changing)]]
        stored = from_space(working, picture.encoding, self.space)
        if self._is_normal:  # stored as (n + 1) / 2
            normals = 2 * stored - 1
            length = np.linalg.norm(normals, axis=1, keepdims=True)
            unit = (normals / np.maximum(length, 1e-12) + 1) / 2
            stored = np.where(length > 0, unit, stored).astype(np.float32)
        if picture.stored in ("uint8", "uint16"):
            stored = np.clip(stored, 0, 1)
        if self._is_divided(picture):
            stored *= values[:, picture.alpha, None]
        if len(picture.colour) == 1:
            values[:, picture.colour[0]] = stored.mean(axis=1)
        else:
            for i in self._changing:
                values[:, picture.colour[i]] = stored[:, i]
        if self._alpha and picture.alpha is not None:
            values[:, picture.alpha] = samples[:, -1]

    def opacity(self, picture: Picture) -> Float32s | None:
        """Return the opacity by which a picture's colours, but not samples, are multiplied, shape (H, W), or None."""
        if not self._is_divided(picture):
            return None
        return full_scale_one(picture.pixels[..., picture.alpha])

    def _is_divided(self, picture: Picture) -> bool:
        # Colours that are averaged together with alpha are weighted by it already.
        return self._hides and self.space != "data" and is_associated(picture)

    def _straight(self, picture: Picture, pixels: Float32s) -> Float32s:
        return without_alpha(picture, pixels) if self._is_divided(picture) else pixels

    def _widened(self, picture: Picture, pixels: Float32s) -> Float32s:
        every = tuple(range(pixels.shape[1]))
        colours = pixels if picture.colour == every else pixels[:, list(picture.colour)]
        return np.repeat(colours, self._width, axis=1) if colours.shape[1] < self._width else colours


_BLOCK = 1 << 16  # texels painted at a time, which bounds the memory for them in floats


@dataclass(frozen=True)
class Repainting:
    """Writes texels of an atlas to its textures; `gutter`: texels around charts that are refilled, None: none."""

    pictures: Sequence[Picture]
    colours: TexelColours
    texture_offsets: Int64s
    looked_up: tuple[Indices, Indices]  # uncovered texels that faces look up: beside charts, and lone ones
    gutter: int | None
    threads: int
    is_dithered: bool = False  # so that smooth changes of colours are no bands in 8 bits

    def repaint(self, index: int, new: NewColours) -> tuple[Array, Change]:
        """Return a picture's pixels with new colours, and the change of its covered texels."""
        picture = self.pictures[index]
        pixels = large_arrays.copy_of(picture.pixels)
        change = self._paint(pixels, index, new.places, new.take)
        if self.gutter is not None:
            covered, known, rows = self._near_charts(index, pixels.shape[:2], new)
            chosen, values = new.beyond_places[rows], new.beyond[rows]
            self._paint(pixels, index, chosen, lambda block, inside: values[block][inside])
            refilled = Refilled(picture.pixels, pixels, covered, known, partial(self.colours.shown, picture))
            border, lone = (self._of_texture(texels, index)[1] for texels in self.looked_up)
            keep_others(refilled, border, lone)
            opacity, columns = self.colours.opacity(picture), self.colours.columns(index)
            fill_gutter(pixels, covered, None, self.gutter, known, self.threads, columns, opacity)
        return pixels, change

    def shift(self, index: int, added: NewColours, limits: tuple[float, float]) -> Array:
        """Return a picture's pixels with an offset added to its colours and gutter, within limits."""
        picture = self.pictures[index]
        pixels, shape = picture.pixels.copy(), picture.pixels.shape[:2]
        inside, texels = self._of_texture(added.places, index)
        change = np.zeros((*shape, added.beyond.shape[1]), np.float32)
        table = change.reshape(-1, change.shape[2])
        table[texels] = added.take(slice(None), inside)
        if self.gutter is not None:
            covered, known, rows = self._near_charts(index, shape, added)
            table[self._of_texture(added.beyond_places[rows], index)[1]] = added.beyond[rows]
            fill_gutter(change, covered, None, self.gutter, known)
        moved = np.flatnonzero(table.any(axis=1))
        after = (self.colours.working(picture, moved) + table[moved]).clip(*limits)
        there = moved + self.texture_offsets[index]
        self._paint(pixels, index, there, lambda block, inside: after[block][inside])
        return pixels

    def _of_texture(self, texels: Indices, index: int) -> tuple[Bools | slice, Indices]:
        """Select the texels of one texture, and number them from its first."""
        if len(self.texture_offsets) == 2:  # there is no other
            return slice(None), texels
        begin, end = self.texture_offsets[index : index + 2].tolist()
        inside = (texels >= begin) & (texels < end)
        return inside, texels[inside] - begin

    def _near_charts(
        self, index: int, shape: tuple[int, ...], new: NewColours
    ) -> tuple[Bools, Bools, Int64s]:
        """Return the covered texels of a texture, shape (H, W), the gutter texels near them, and their rows."""
        assert self.gutter is not None
        covered, near = np.zeros(shape, bool), np.zeros(shape, bool)
        for block in large_arrays.blocks(len(new.places)):
            covered.reshape(-1)[self._of_texture(new.places[block], index)[1]] = True
        inside, texels = self._of_texture(new.beyond_places, index)
        chosen = within(covered, self.gutter).reshape(-1)[texels]
        near.reshape(-1)[texels[chosen]] = True
        return covered, near, np.arange(len(new.beyond_places))[inside][chosen]

    def _paint(
        self, pixels: Array, index: int, texels: Indices, take: Callable[[slice, Bools | slice], Float32s]
    ) -> Change:
        """Write samples into pixels like a picture's own, in place, and return how these change."""
        picture, colours = self.pictures[index], self.colours
        table, changes = pixels.reshape(-1, pixels.shape[2]), []
        channels = colours.columns(index)
        for block in large_arrays.blocks(len(texels), _BLOCK):
            inside, here = self._of_texture(texels[block], index)
            if not len(here):
                continue
            after = take(block, inside)
            count = len(here) * len(channels)  # Texels that did not change count, too.
            if colours.are_converted(index):
                stored = np.take(table, here, axis=0)
                moved = colours.changed(picture, stored, after)
                if not moved.all():
                    here, after, stored = here[moved], after[moved], stored[moved]
                whole = full_scale_one(stored)
                colours.write(whole, index, after)
                values = whole[:, channels]
            else:
                values = colours.written(index, after)
            if self.is_dithered and picture.stored == "uint8":
                values = dithered(values, here, picture.pixels.shape[1])
            change = store(picture, table, here, values, channels, self.threads)
            changes.append(dataclasses.replace(change, count=count))
        return Change.joined(changes)


def dithered(values: Float32s, texels: Indices, width: int) -> Float32s:
    """Add a pattern of half a step of 8 bits to some texels, so that rounding spreads what it takes away.

    What is a multiple of a step stays. The pattern is interleaved gradient noise: J. Jimenez, "Next generation post
    processing in Call of Duty: Advanced Warfare", SIGGRAPH 2014.
    """
    row, column = np.divmod(texels.astype(np.int32), np.int32(width))
    pattern = (52.9829189 * ((0.06711056 * column + 0.00583715 * row) % 1)) % 1
    steps = values * np.float32(255)
    is_whole = np.abs(steps - np.rint(steps)) < 2e-3
    spread = (steps + (0.98 * (pattern - 0.5)).astype(np.float32)[:, None]) / np.float32(255)
    return np.where(is_whole, values, spread)
