"""Write new colours of texels into the pictures of a slot, and refill the gutters around charts."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.formats.image.picture import full_scale_one
from beltrami_cli.samples.samples import Change, store
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.lookup import fill_gutter, within

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from beltrami_cli.flow.manifold import NewColours
    from beltrami_cli.formats.image import Picture
    from beltrami_cli.samples.texel_colours import TexelColours
    from beltrami_cli.surface.atlas import Indices

_BLOCK = 1 << 16  # texels painted at a time, which bounds the memory for them in floats


@dataclass(frozen=True)
class Repainting:
    """Writes texels of an atlas to its textures; `gutter`: texels around charts that are refilled, None: none."""

    pictures: Sequence[Picture]
    colours: TexelColours
    texture_offsets: NDArray[np.int64]
    gutter: int | None
    threads: int

    def repaint(self, index: int, new: NewColours) -> tuple[NDArray[Any], Change]:
        """Return a picture's pixels with new colours, and the change of its covered texels."""
        picture = self.pictures[index]
        pixels = large_arrays.copy_of(picture.pixels)
        change = self._paint(pixels, index, new.places, new.take)
        if self.gutter is not None:
            covered, known, rows = self._near_charts(index, pixels.shape[:2], new)
            chosen, values = new.beyond_places[rows], new.beyond[rows]
            self._paint(pixels, index, chosen, lambda block, inside: values[block][inside])
            opacity, columns = self.colours.opacity(picture), self.colours.columns(index)
            fill_gutter(pixels, covered, None, self.gutter, known, self.threads, columns, opacity)
        return pixels, change

    def shift(self, index: int, added: NewColours, limits: tuple[float, float]) -> NDArray[Any]:
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

    def _of_texture(self, texels: Indices, index: int) -> tuple[NDArray[np.bool_] | slice, Indices]:
        """Select the texels of one texture, and number them from its first."""
        if len(self.texture_offsets) == 2:  # there is no other
            return slice(None), texels
        begin, end = self.texture_offsets[index : index + 2].tolist()
        inside = (texels >= begin) & (texels < end)
        return inside, texels[inside] - begin

    def _near_charts(
        self, index: int, shape: tuple[int, ...], new: NewColours
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.int64]]:
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
        self,
        pixels: NDArray[Any],
        index: int,
        texels: Indices,
        take: Callable[[slice, NDArray[np.bool_] | slice], NDArray[np.float32]],
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
                colours.write(whole, index, slice(None), after)
                values = whole[:, channels]
            else:
                values = colours.written(index, after)
            change = store(picture, table, here, values, channels, self.threads)
            changes.append(dataclasses.replace(change, count=count))
        return Change.joined(changes)
