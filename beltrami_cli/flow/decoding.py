"""Plans for canvases, with a second decoding of images in which JPEG compressed white noise.

Such images are decoded around a pilot, the result of the kernel alone, before the parameters are chosen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s
from beltrami_cli.flow.beltrami_flow import smooth_in_place
from beltrami_cli.flow.corrections.jpeg_image import JpegImage, decode_in_place
from beltrami_cli.flow.corrections.jpeg_noise import is_changed, noise_after, sigma_before
from beltrami_cli.flow.estimation import estimate_on_canvas, with_known_noise
from beltrami_cli.flow.manifolds.grid.manifold import (
    CanvasColours,
    ColouredCanvas,
    GridManifold,
    grid_manifold,
)
from beltrami_cli.flow.noise.model import NoiseModel
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.flow.plan import Plan, choose_parameters, should_stay
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import Atlas

Tick = Callable[[], None]

# Number of decodings before patches, which take remaining ringing for detail because it repeats. The mean of two pilots
# gains 0.5 to 0.7 dB on hand-painted textures, and keeps detail that the second pilot alone loses.
_PILOTS = 2


def plan_on_canvas(
    canvas: ColouredCanvas, images: Sequence[JpegImage] = (), tick: Tick | None = None
) -> Plan[GridManifold]:
    """Estimate the noise, decode JPEG images again if all have compressed white noise, and choose parameters."""
    colours = estimate_on_canvas(canvas)
    sigma = _sigma_for_decoding(images, colours, canvas.parameters)
    if sigma is not None:
        reading = colours.noise.reading
        colours, stored_noise = _decode_in_place(canvas, colours, images, sigma, tick)
        plan = choose_parameters(grid_manifold(canvas, colours), tick).with_noise(stored_noise, reading)
        if plan.parameters.iterations and not should_stay(plan.choice, canvas.parameters):
            return plan
        colours = estimate_on_canvas(canvas)  # without iterations, stored colours stay unchanged
    return choose_parameters(grid_manifold(canvas, colours), tick, light_in=canvas.light, can_stay=True)


def decodes_again(parameters: KernelParameters) -> bool:
    """Whether JPEG images may be decoded again."""
    return parameters.stabilises_noise and not parameters.fast


def _sigma_for_decoding(
    images: Sequence[JpegImage], colours: CanvasColours, parameters: KernelParameters
) -> float | None:
    """Estimate sigma of the white noise before compression; None if images are not decoded again."""
    # Decoding from the coefficients of the files would bring back outliers.
    if not images or colours.outliers is not None:
        return None
    given = parameters.given_noise
    sigma = sigma_before(images, colours.noise) if given is None else given.sigma
    return sigma if sigma and is_changed(images, sigma) else None


def _decode_in_place(
    canvas: ColouredCanvas, colours: CanvasColours, images: Sequence[JpegImage], sigma: float, tick: Tick | None
) -> tuple[CanvasColours, Float64s]:  # fmt: skip
    """Decode images again around a pilot, which overwrites their colours; return also sigma of the stored noise."""
    before = None
    for _ in range(_PILOTS if canvas.parameters.takes_patches else 1):
        rows = _pilot_in_place(grid_manifold(canvas, colours), tick)
        if before is not None:
            for block in large_arrays.blocks(len(rows)):
                rows[block] = (rows[block] + before[block]) / 2
        before = large_arrays.copy_of(rows)
        noise, stored = _decode_rows_in_place(canvas.atlas, images, rows, sigma)
        colours = with_known_noise(canvas, rows, noise)
    return colours, stored


def _pilot_in_place(manifold: GridManifold, tick: Tick | None) -> Float32s:
    """Smooth the owned cells by the kernel alone, in the memory of their colours."""
    plan = choose_parameters(manifold.with_parameters(patches="off"), tick)
    result = smooth_in_place(plan, None if tick is None else lambda *_: tick())
    return result.manifold.new_colours().table()


def _decode_rows_in_place(
    atlas: Atlas, images: Sequence[JpegImage], rows: Float32s, sigma: float
) -> tuple[NoiseModel, Float64s]:
    """Replace a pilot at the owned cells by decoded colours; return sigma of their noise and of the stored noise."""
    rasters = []
    for image in images:
        raster = large_arrays.empty(image.pixels.shape, np.float32)
        for band in image.bands:
            raster[band] = image.pixels[band] / np.float32(255)
        rasters.append(raster)
    blocks = list(large_arrays.blocks(len(atlas.owned_texels)))
    for block in blocks:
        for index, inside, texels in atlas.by_texture(atlas.owned_texels[block]):
            rasters[index].reshape(-1, rows.shape[1])[texels] = rows[block][inside]
    noise, stored = noise_after(images, rasters, sigma)
    for image, raster in zip(images, rasters, strict=True):
        decode_in_place(image, raster, sigma)
    for block in blocks:
        for index, inside, texels in atlas.by_texture(atlas.owned_texels[block]):
            rows[block][inside] = rasters[index].reshape(-1, rows.shape[1])[texels]
    return noise, stored
