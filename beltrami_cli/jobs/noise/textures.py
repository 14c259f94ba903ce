"""Noise on the textures of a slot: on covered texels, and around charts what lies there across the seam."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.flow.canvas import painted
from beltrami_cli.formats.image import check_writable, losses, write_image
from beltrami_cli.jobs.noise.image import lossy_notice
from beltrami_cli.jobs.noise.kinds import add_noise, bounds
from beltrami_cli.samples.textures.colours import COLOUR_SLOTS
from beltrami_cli.samples.textures.prepare import prepare_slot
from beltrami_cli.samples.textures.repainting import SmoothedTexels, paint, rows_of
from beltrami_cli.surface.lookup import fill_gutter

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.jobs.settings import NoiseSettings
    from beltrami_cli.samples.settings import SmoothSettings
    from beltrami_cli.samples.textures.prepare import PreparedSlot
    from beltrami_cli.surface.atlas import Atlas
    from beltrami_cli.surface.records import ImageFile, Slot, TexturedSurface


@dataclass(frozen=True)
class NoisyTextures:
    """Image files with noise under the keys of their textures, what was added to covered texels, and notices."""

    images: dict[tuple[Slot, str], ImageFile]
    change: NDArray[np.float32]
    notices: tuple[str, ...]


def noisy_slot(
    surface: TexturedSurface, slot: Slot, settings: SmoothSettings, noise: NoiseSettings, stream: int
) -> NoisyTextures:
    """Add noise to all chosen textures of a slot.

    Every covered texel is a sample with noise of its own. Just around a chart, texels get the noise that the surface
    has beyond the seam, interpolated from the other chart's texels; further out, that of the nearest covered texel.

    Parameters
    ----------
    surface : TexturedSurface
        As a document gives it.
    slot : Slot
        Which slot it is: colours, or data.
    settings : SmoothSettings
        The working space, the channels, and what concerns textures.
    noise : NoiseSettings
        What noise.
    stream : int
        As for `add_noise`.

    Raises
    ------
    UsageError, InputError
        As `prepare_slot`.
    """
    prepared = prepare_slot(surface, slot, settings)
    for picture in prepared.pictures:
        check_writable(picture, settings.textures.image_suffix)
    before = prepared.colours.samples(prepared.atlas)
    added, limits = _on_surface(prepared, before, noise, stream), bounds(before)
    images: dict[tuple[Slot, str], ImageFile] = {}
    notices: list[str] = []
    suffix = settings.textures.image_suffix
    for index, (texture, picture) in enumerate(
        zip(prepared.surface.textures, prepared.pictures, strict=True)
    ):
        pixels = _repainted(prepared, index, added, settings.textures.gutter, limits)
        images[slot, texture.key] = write_image(
            picture,
            pixels,
            suffix=suffix,
            jpeg_quality=settings.textures.jpeg_quality,
            small=settings.textures.small,
            as_data=slot not in COLOUR_SLOTS,
        )
        notices += picture.notices
        notices += losses(picture, suffix) if suffix is not None else ()
        notices += lossy_notice(picture, suffix, "--texture-format png keeps all")
    if not len(added.texels):
        notices.append("no visible texel is covered by the surface, so its textures stay as they are")
    return NoisyTextures(images, added.colours(slice(None), slice(None)), tuple(notices))


def _on_surface(
    prepared: PreparedSlot, before: NDArray[np.float32], noise: NoiseSettings, stream: int
) -> SmoothedTexels:
    """Return what noise adds to the covered texels, and to those around them."""
    atlas = prepared.atlas
    # By the texel, not the cell: where a chart lies on the canvas is no matter of the surface.
    number = np.empty(len(atlas.owned_texels), np.int64)
    number[np.argsort(atlas.owned_texels)] = np.arange(len(number))
    added = add_noise(before, number, noise, stream, _in_grey(prepared)) - before
    planes = painted(atlas, added, threads=1)
    beyond = np.ascontiguousarray(planes.reshape(len(planes), -1)[:, atlas.gutter_cells].T)
    return SmoothedTexels(
        atlas.texture_offsets, atlas.owned_texels, rows_of(added), atlas.gutter_texels, beyond
    )


def _in_grey(prepared: PreparedSlot) -> NDArray[np.bool_]:
    """Tell which covered texels are of grey pictures, which have one channel only."""
    atlas: Atlas = prepared.atlas
    grey = np.array([len(picture.colour) == 1 for picture in prepared.pictures], bool)
    return np.asarray(
        grey[np.searchsorted(atlas.texture_offsets, atlas.owned_texels, side="right") - 1], bool
    )


def _repainted(
    prepared: PreparedSlot,
    index: int,
    added: SmoothedTexels,
    gutter: int | None,
    limits: tuple[float, float],
) -> NDArray[Any]:
    """Return a picture's pixels with noise."""
    picture, colours = prepared.pictures[index], prepared.colours
    pixels, shape = picture.pixels.copy(), picture.pixels.shape[:2]
    inside, texels = added.of_texture(added.texels, index)
    change = np.zeros((*shape, added.gutter_colours.shape[1]), np.float32)
    table = change.reshape(-1, change.shape[2])
    table[texels] = added.colours(slice(None), inside)
    if gutter is not None:
        covered, known, rows = added.near_charts(index, shape, gutter)
        table[added.of_texture(added.gutter_texels[rows], index)[1]] = added.gutter_colours[rows]
        fill_gutter(change, covered, None, gutter, known)
    moved = np.flatnonzero(table.any(axis=1))
    noisy = (colours.working(picture, moved) + table[moved]).clip(*limits)
    there = moved + added.texture_offsets[index]
    paint(pixels, picture, index, colours, added, there, rows_of(noisy), threads=1)
    return pixels
