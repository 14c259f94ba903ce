"""Smoothed texels put back into pictures, and their gutters refilled."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from beltrami_cli.formats.image.picture import full_scale_one
from beltrami_cli.samples.change import Change
from beltrami_cli.samples.stored_pixels import store
from beltrami_cli.samples.textures.places import within
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.lookup import fill_gutter

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from beltrami_cli.formats.image import Picture
    from beltrami_cli.samples.textures.colours import TexelColours
    from beltrami_cli.surface.atlas import Indices

    ColoursOf: TypeAlias = Callable[[slice, NDArray[np.bool_] | slice], NDArray[np.float32]]

_BLOCK = 1 << 16  # texels painted at a time, which bounds the memory for them in floats


def rows_of(table: NDArray[np.float32]) -> ColoursOf:
    """Return what gives the rows of a table, as `SmoothedTexels` wants it."""
    return lambda block, inside: table[block][inside]


@dataclass(frozen=True)
class SmoothedTexels:
    """What the flow made of the texels of all pictures.

    Attributes
    ----------
    texture_offsets : ndarray of int64, shape (number of textures + 1,)
        Texels of texture i are numbered from its offset, row by row.
    texels : ndarray of int64, shape (T,)
        The covered texels.
    colours : callable
        Gives the colours of some of them, shape (K, N), in the working space: which of a slice of all.
    gutter_texels : ndarray of int64, shape (G,)
        Texels just beyond charts.
    gutter_colours : ndarray of float32, shape (G, N)
        Colours of the surface as it continues there.
    """

    texture_offsets: NDArray[np.int64]
    texels: NDArray[np.int64]
    colours: ColoursOf
    gutter_texels: NDArray[np.int64]
    gutter_colours: NDArray[np.float32]

    def of_texture(self, texels: Indices, index: int) -> tuple[NDArray[np.bool_] | slice, Indices]:
        """Choose the texels of one texture, and number them from its first."""
        if len(self.texture_offsets) == 2:  # there is no other
            return slice(None), texels
        begin, end = self.texture_offsets[index : index + 2].tolist()
        inside = (texels >= begin) & (texels < end)
        return inside, texels[inside] - begin

    def near_charts(
        self, index: int, shape: tuple[int, ...], gutter: int
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.int64]]:
        """Find what is covered of a texture of a shape, and which texels of its gutter are near that.

        Returns
        -------
        covered, near : ndarray of bool, shape (H, W)
            Texels that are covered, and those of the gutter at most `gutter` rows and columns from one.
        rows : ndarray of int64, shape (K,)
            The same texels of the gutter, as rows of `gutter_texels`.
        """
        covered, near = np.zeros(shape, bool), np.zeros(shape, bool)
        for block in large_arrays.blocks(len(self.texels)):
            covered.reshape(-1)[self.of_texture(self.texels[block], index)[1]] = True
        inside, texels = self.of_texture(self.gutter_texels, index)
        chosen = within(covered, gutter).reshape(-1)[texels]
        near.reshape(-1)[texels[chosen]] = True
        return covered, near, np.arange(len(self.gutter_texels))[inside][chosen]


def repaint(
    picture: Picture,
    index: int,
    colours: TexelColours,
    smoothed: SmoothedTexels,
    gutter: int | None,
    threads: int,
) -> tuple[NDArray[Any], Change]:
    """Return a picture's new pixels, and how its covered texels changed.

    Parameters
    ----------
    picture : Picture
        The source.
    index : int
        Which of the atlas's textures it is.
    colours : TexelColours
        The way from working colours to pixels.
    smoothed : SmoothedTexels
        New colours of covered texels and of the gutter.
    gutter : int or None
        Texels beyond the charts that are refilled; None: none.
    threads : int
        The result does not depend on it.

    Returns
    -------
    pixels : ndarray, shape (H, W, C)
        In the picture's type. Texels that did not change keep their exact values.
    change : Change
        Of the covered texels, in the channels that change.
    """
    pixels = large_arrays.copy_of(picture.pixels)
    change = paint(pixels, picture, index, colours, smoothed, smoothed.texels, smoothed.colours, threads)
    if gutter is not None:
        covered, known, rows = smoothed.near_charts(index, pixels.shape[:2], gutter)
        chosen, values = smoothed.gutter_texels[rows], smoothed.gutter_colours[rows]
        paint(pixels, picture, index, colours, smoothed, chosen, rows_of(values), threads)
        opacity = colours.opacity(picture)
        fill_gutter(pixels, covered, None, gutter, known, threads, colours.columns(index), opacity)
    return pixels, change


def paint(
    pixels: NDArray[Any],
    picture: Picture,
    index: int,
    colours: TexelColours,
    smoothed: SmoothedTexels,
    texels: NDArray[np.int64],
    samples: ColoursOf,
    threads: int,
) -> Change:
    """Put the samples that are of a picture into pixels like its own, in place, and return how these change."""
    table, changes = pixels.reshape(-1, pixels.shape[2]), []
    channels = colours.columns(index)
    for block in large_arrays.blocks(len(texels), _BLOCK):
        inside, here = smoothed.of_texture(texels[block], index)
        if not len(here):
            continue
        after = samples(block, inside)
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
        change = store(picture, table, here, values, channels, threads)
        changes.append(dataclasses.replace(change, count=count))
    return Change.joined(changes)
