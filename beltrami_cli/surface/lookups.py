"""Bilinear lookups in textures, and the noise around them.

References
----------
.. [1] J. Immerkaer, "Fast noise variance estimation", CVIU 64 (1996).
"""

from __future__ import annotations

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s, Int64s
from beltrami_cli.surface.records import Wrap


def look_up(
    image: Float32s, uv: Array, wrap: tuple[Wrap, Wrap], alpha: int | None = None,
    precision: type[np.float32] | type[np.float64] = np.float64,
) -> Array:  # fmt: skip
    """Interpolate bilinearly between texels; exact where all four are equal."""
    # Coordinates: u to the right, v down, (0, 0) the upper left corner of the image and (1, 1) the lower right. No
    # colour is taken where the channel `alpha` is transparent.
    height, width = image.shape[:2]
    left, right, across = _taps(uv[:, 0], width, wrap[0])
    upper, lower, down = _taps(uv[:, 1], height, wrap[1])
    places = [(row, column) for row in (upper, lower) for column in (left, right)]
    four: list[Array] = [_texels(image, *place).astype(precision, copy=False) for place in places]
    right_part, lower_part = (part.astype(precision, copy=False)[:, None] for part in (across, down))
    plain = _mixed(four, right_part, lower_part)
    if alpha is None:
        return plain
    opacity = plain[:, alpha : alpha + 1]
    weighted = _mixed([texel * texel[:, alpha : alpha + 1] for texel in four], right_part, lower_part)
    agree = np.ptp(np.stack([texel[:, alpha] for texel in four]), axis=0) == 0
    seen = plain.copy()
    np.divide(weighted, opacity, out=seen, where=(opacity > 0) & ~agree[:, None])
    seen[:, alpha] = plain[:, alpha]
    return seen


def _texels(image: Array, row: Int64s, column: Int64s) -> Array:
    if image.flags.c_contiguous:  # the usual and faster case
        return np.asarray(image.reshape(-1, image.shape[2]).take(row * image.shape[1] + column, axis=0))
    return np.asarray(image[row, column])


def noise_around(image: Float32s, uv: Float64s, wrap: tuple[Wrap, Wrap]) -> Float64s:
    """Return samples of the texture's noise, by a mask that maps any plane to zero [1]."""
    # The samples have the standard deviation of independent noise.
    height, width = image.shape[:2]
    mask = np.outer([1, -2, 1], [1, -2, 1]) / 6
    column, row = (np.floor(uv * [width, height]).astype(np.int64)).T
    columns = [_wrapped(column + step, width, wrap[0]) for step in (-1, 0, 1)]
    rows = [_wrapped(row + step, height, wrap[1]) for step in (-1, 0, 1)]
    total = np.zeros((len(uv), image.shape[2]))
    for i, j in np.ndindex(3, 3):
        total += mask[i, j] * image[rows[i], columns[j]]
    return total


def _mixed(four: list[Array], across: Array, down: Array) -> Array:
    upper = four[0] + across * (four[1] - four[0])
    lower = four[2] + across * (four[3] - four[2])
    return np.asarray(upper + down * (lower - upper))


def _taps(coordinate: Array, count: int, wrap: Wrap) -> tuple[Int64s, Int64s, Array]:
    """Return the texels on both sides along one axis, and the fraction between them."""
    # Subtract whole periods first, since coordinates may be huge.
    period = 2.0 if wrap == "mirror" else 1.0
    if wrap == "clamp":
        folded = np.clip(coordinate, -1, 2)
    else:
        folded = coordinate if _all_within(coordinate, period) else np.mod(coordinate, period)
    at = folded * count - 0.5
    first = np.floor(at).astype(np.int64)
    return _wrapped(first, count, wrap), _wrapped(first + 1, count, wrap), at - first


def _all_within(values: Array, end: float) -> bool:
    """Whether all values are in [0, end), so that wrapping is unnecessary."""
    return bool(values.size) and bool(values.min() >= 0) and bool(values.max() < end)


def _wrapped(index: Int64s, count: int, wrap: Wrap) -> Int64s:
    if _all_within(index, count):
        return index
    if wrap == "clamp":
        return np.asarray(np.clip(index, 0, count - 1))
    if wrap == "repeat":
        return index % count
    folded = index % (2 * count)
    return np.minimum(folded, 2 * count - 1 - folded)
