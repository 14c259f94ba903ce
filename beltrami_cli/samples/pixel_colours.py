"""From one picture to the colours of samples in the working space, and back."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import UsageError
from beltrami_cli.flow.colour_space import from_space, to_space
from beltrami_cli.formats.image.picture import full_scale_one, is_associated, supplies_colour
from beltrami_cli.samples.samples import Change, channel_numbers, store

if TYPE_CHECKING:
    from beltrami_cli.arrays import Array, Bools, Float32s, Int64s
    from beltrami_cli.flow.manifold import NewColours
    from beltrami_cli.flow.parameters import Space
    from beltrami_cli.formats.image import Picture
    from beltrami_cli.samples.settings import SmoothSettings

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

    changing: tuple[str, ...]
    """The names of those that change."""

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
        opacity = {}
        if settings.textures.alpha == "smooth" and picture.alpha is not None:
            opacity = {"alpha": picture.alpha}
        wanted, named_all = settings.embedding.metric_channels, named | opacity
        changing = _choose(named, settings.channels, picture.name) | opacity
        in_metric = changing if wanted is None else _choose(named_all, wanted, picture.name)
        chosen = {name: i for name, i in named_all.items() if name in changing or name in in_metric}
        self.names, self.channels, self.changing = tuple(chosen), list(chosen.values()), tuple(changing)
        self.metric_channels = None
        if in_metric.keys() != chosen.keys():
            self.metric_channels = [self.names.index(name) for name in in_metric]
        self._coloured = [channel in picture.colour for channel in self.channels]
        # Colours that are averaged together with alpha are weighted by it already.
        self._is_divided = is_associated(picture) and not opacity and self._space != "data"
        self.others = tuple(
            name for name, channel in chosen.items() if channel not in (*picture.colour, picture.alpha)
        )

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
        written = [self.names.index(name) for name in self.changing]
        channels = [self.channels[column] for column in written]
        for first in range(0, len(new.places), _BLOCK):
            part = slice(first, first + _BLOCK)
            block = new.places[part]
            before = full_scale_one(table[block[:, None], self.channels])
            after = self._stored(before, new.take(part, slice(None)), self._opacity(block))
            changes.append(store(self._picture, table, block, after[:, written], channels, threads))
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
            back[:, self._coloured] = from_space(
                samples[:, self._coloured], self._picture.encoding, self._space
            )
            if self._is_divided:
                back[:, self._coloured] *= opacity
            if self._space == "oklab":  # which mixes the channels
                moved[:, self._coloured] = moved[:, self._coloured].any(axis=1, keepdims=True)
        return np.where(moved, back, before)


def _choose(named: dict[str, int], wanted: tuple[str, ...] | None, name: str) -> dict[str, int]:
    """Choose channels by their names, or by the first letters of colours."""
    names = tuple(named)
    numbers = channel_numbers(names, wanted, f"{name} has", _COLOURS)
    return {names[i]: named[names[i]] for i in numbers}
