"""The unit of colours in which noise is judged: of light, of data, and of integers with a partial range."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Int64s
from beltrami_cli.formats.full_scale import BYTE, INTEGER_SCALES, holds_bytes
from beltrami_cli.formats.image.decoded_image import DecodedImage
from beltrami_cli.surface.records import ColouredVertices

# Number of samples for the quantiles of a unit: the 0.99 quantile is between those of 0.9892 and 0.9908 in 95 of 100
# cases.
_MAX_SAMPLES = 60_000

# Quantile of magnitudes that counts as usual: larger ones may be fireflies.
_USUAL_QUANTILE = 0.99

# Minimum share of the numbers at one level, and its maximum ratio to usual values, for the level to be a white point,
# at which noise was clipped.
_SHARED_WHITE, _NEAR_WHITE = 1e-3, 2.0

# Headroom for noise above usual values if there is no white point. For two synthetic images in light, with noise in
# proportion to it, errors with 0.9 and 1.05 are up to twice those with 1.2; with 1.5 they are the same.
_HEADROOM = 1.2

# Usual values are at most `_MAX_CONTRAST` times the mean of values raised to `_PERCEIVED`, so that lamps and skies are
# ignored. With 3 % of lamps that are a thousand times as bright, noise of 14 % elsewhere becomes 1.8 %; without the
# limit it stays. If values vary by less than their size divided by `_MAX_CONTRAST`, such as temperatures in kelvin, the
# unit is their range. It is at least `_MIN_RANGE` of their size, so that rounding to single precision (6e-8) is far
# below what counts as noise (2e-3 of the unit).
_MAX_CONTRAST, _PERCEIVED, _MIN_RANGE = 8.0, 1 / 2.4, 1e-3


def unit_of_vertices(vertices: ColouredVertices, channels: Sequence[int], *, are_data: bool) -> float:
    """Return the unit of chosen channels of vertices."""
    full, rows = vertices.full_scale, vertices.colours
    is_whole = vertices.stored.startswith(("uint", "int")) or full in INTEGER_SCALES
    joined = np.full(len(rows), not len(vertices.faces))
    joined[vertices.faces] = True  # isolated vertices are not changed
    places = np.flatnonzero(joined)
    values = rows[places[:: 1 + len(places) // _MAX_SAMPLES]][:, channels]
    return value_unit(
        values, 1 / full if is_whole else 0.0, is_display=vertices.encoding == "srgb" and not are_data
    )


def unit_of_images(
    images: Sequence[DecodedImage], values_of: Callable[[DecodedImage, Int64s], Float32s], *, are_data: bool
) -> float:
    """Return the common unit of images; `values_of` returns their stored colours at pixels."""
    if len({image.encoding for image in images}) != 1:
        return 1.0  # integers and floats have no common unit
    kinds = [image.pixels.dtype for image in images]
    step = max(0.0 if kind.kind == "f" else 1 / np.iinfo(kind).max for kind in kinds)
    if any(kind == np.uint8 for kind in kinds):
        return 1.0
    sizes = [image.pixels[..., 0].size for image in images]
    values = [
        values_of(image, np.arange(0, size, 1 + sum(sizes) // _MAX_SAMPLES)).ravel()
        for image, size in zip(images, sizes, strict=True)
    ]
    is_display = images[0].encoding == "srgb" and not are_data
    return value_unit(np.concatenate(values), step, is_display=is_display)


def value_unit(values: Array, step: float, *, is_display: bool) -> float:
    """Return the divisor of colours that makes full scale 1 for judging noise.

    It is proportional to the values, so that nothing depends on their unit. `step`: difference of successive integers,
    0 for floats; a unit has at least 255 steps. Values of 8 bits keep their full scale of 1.
    """
    least, finite = BYTE * step, values[np.isfinite(values)]
    if least >= 1 or not finite.any() or (is_display and holds_bytes(finite)):
        return 1.0
    seen = finite[finite != 0]
    size = np.abs(seen)
    top, (low, high) = size.max(), np.quantile(seen, (1 - _USUAL_QUANTILE, _USUAL_QUANTILE))
    is_white = np.count_nonzero(size == top) >= max(2, _SHARED_WHITE * size.size)
    size = np.minimum(size, np.quantile(size, _USUAL_QUANTILE))
    usual = size.max()
    if is_white and top <= _NEAR_WHITE * usual:
        unit = top
    elif high - low < usual / _MAX_CONTRAST:
        unit = _HEADROOM * max(high - low, _MIN_RANGE * usual)
    else:
        mean = np.power(size / usual, _PERCEIVED, dtype=np.float64).mean() ** (1 / _PERCEIVED)
        unit = _HEADROOM * usual * min(1.0, _MAX_CONTRAST * mean)
    return float(max(unit, least))
