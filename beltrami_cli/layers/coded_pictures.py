"""How pictures are smoothed whose noise JPEG coded."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s
from beltrami_cli.flow.beltrami_flow import Plan, choose_parameters, smooth
from beltrami_cli.flow.canvas import painted
from beltrami_cli.flow.grid_manifold import GridManifold
from beltrami_cli.flow.noise.by_scale import FoundNoise
from beltrami_cli.flow.noise.coded_picture import CodedPicture, decode
from beltrami_cli.flow.parameters import KernelParameters, Space
from beltrami_cli.formats.image.metadata import JpegTables
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import Atlas, texels_by_texture

Make = Callable[[Float32s | None, FoundNoise | None], GridManifold]

# How often pictures are decoded before patches, which take remaining ringing for detail, as it repeats itself.
# The mean of two pilots gains 0.5 to 0.7 dB on paint, and keeps detail that the second alone loses.
_PILOTS = 2


def plan_on_pictures(
    make: Make,
    atlas: Atlas,
    coded: Sequence[tuple[Array, JpegTables | None]],
    kernel: KernelParameters,
    *,
    tick: Callable[[], None] | None = None,
    light_in: Space | None = None,
) -> Plan[GridManifold]:
    """Plan the smoothing of pictures, decoded again if JPEG coded white noise in all of them.

    `make` makes the manifold, of given colours with their noise if these are given. `coded`: the pixels and tables of
    all pictures as their files have them; none if the samples have other colours.
    """
    pictures = _coded(atlas, coded) if kernel.evens_noise and not kernel.fast else []
    sigma = None
    if pictures:
        from beltrami_cli.flow.noise.before_jpeg import is_changed, noise_before_jpeg

        sigma = noise_before_jpeg(pictures) if kernel.given_noise is None else kernel.given_noise.sigma
        sigma = sigma if sigma and is_changed(pictures, sigma) else None
    if sigma is None:
        return choose_parameters(make(None, None), kernel, tick, light_in=light_in)
    planes, noise, before = None, None, None
    for _ in range(_PILOTS if kernel.takes_patches else 1):
        rows = _smoothed(make(planes, noise), kernel, tick)
        if before is not None:
            for block in large_arrays.blocks(len(rows)):
                rows[block] = (rows[block] + before[block]) / 2
        before = large_arrays.copy_of(rows)  # decoding overwrites them
        noise, stored = _decode(atlas, pictures, rows, sigma)
        planes = painted(atlas, rows, kernel.thread_count)
    del before, rows
    plan = choose_parameters(make(planes, noise), kernel, tick)
    if not plan.parameters.iterations:  # colours without iterations stay as they are
        return choose_parameters(make(None, None), kernel, tick)
    return plan.with_noise(stored)


def _smoothed(manifold: GridManifold, kernel: KernelParameters, tick: Callable[[], None] | None) -> Float32s:
    """Return what the kernel alone makes of the owned cells."""
    plan = choose_parameters(manifold, dataclasses.replace(kernel, patches="off"), tick)
    return smooth(plan, None if tick is None else lambda *_: tick()).manifold.new_colours().table()


def _coded(atlas: Atlas, coded: Sequence[tuple[Array, JpegTables | None]]) -> list[CodedPicture]:
    """Return the pictures, unless one of them is no JPEG file, or some are grey and others are not."""
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


def _decode(
    atlas: Atlas, pictures: Sequence[CodedPicture], rows: Float32s, sigma: float
) -> tuple[FoundNoise, Float64s]:
    """Replace a pilot's colours of the owned cells by decoded ones; return their noise, and sigma of that stored."""
    from beltrami_cli.flow.noise.after_jpeg import noise_after

    rasters = []
    for picture in pictures:
        raster = large_arrays.empty(picture.pixels.shape, np.float32)
        for band in picture.bands:
            raster[band] = picture.pixels[band] / np.float32(255)
        rasters.append(raster)
    blocks = list(large_arrays.blocks(len(atlas.owned_texels)))
    for block in blocks:
        for index, inside, texels in texels_by_texture(atlas.texture_offsets, atlas.owned_texels[block]):
            rasters[index].reshape(-1, rows.shape[1])[texels] = rows[block][inside]
    noise, stored = noise_after(pictures, rasters, sigma)
    for picture, raster in zip(pictures, rasters, strict=True):
        decode(picture, raster, sigma)
    for block in blocks:
        for index, inside, texels in texels_by_texture(atlas.texture_offsets, atlas.owned_texels[block]):
            rows[block][inside] = rasters[index].reshape(-1, rows.shape[1])[texels]
    return noise, stored
