"""Decoding of JPEG images given the noise before compression.

JPEG rounds the DCT coefficients of blocks to multiples of a step. Noise that is small compared with a step vanishes,
except in a few coefficients, which then stand out as whole waves. The estimation and removal of noise do not expect
that. Given sigma of the noise before compression and a pilot x, the expectation of a coefficient that was rounded to k
steps d is

    E[z | (k - 1/2) d < z < (k + 1/2) d],    z normal around x,

the mean of a truncated normal distribution [1]_, as for clipped noise. Near a limit of the colours noise was clipped
before compression, so that x is further from the limit than the mean of the compressed values.

References
----------
.. [1] N. L. Johnson, S. Kotz, N. Balakrishnan, "Continuous Univariate Distributions" I, 2nd ed., 1994, section 13.10.1:
   moments of truncated normal distributions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s
from beltrami_cli.flow.corrections.normal_tables import normal_tables
from beltrami_cli.surface import large_arrays

# Luma and the two chroma channels of red, green and blue (JFIF).
YCC = np.array([[0.299, 0.587, 0.114], [-0.168736, -0.331264, 0.5], [0.5, -0.418688, -0.081312]])
_RGB = np.linalg.inv(YCC)

# Side of a block in pixels.
SIDE = 8

# Pixels processed at a time, in rows that contain whole blocks of chroma.
_BANDS, _PIXELS = (128, 64, 32, 16), 1 << 18

# Additional rows, which determine interpolated chroma: the influence of samples falls by a factor of 0.17 each.
_CHROMA_MARGIN = 8

# Weights of the nearest and the next sample in a pixel's chroma, where samples are two pixels apart.
_NEAREST_SHARE, _NEXT_SHARE = 0.75, 0.25


@dataclass(frozen=True)
class JpegImage:
    """An image decoded from a JPEG file."""

    pixels: Array  # shape (H, W, 1 or 3), uint8
    used: Bools  # pixels that are samples of the surface, shape (H, W)
    steps: Float64s  # quantisation tables of luma and chroma, shape (1 or 2, 8, 8)
    span: tuple[int, int]  # rows and columns of pixels per chroma sample

    @property
    def tables(self) -> list[Float64s]:
        """The quantisation table of each plane."""
        planes = [0, 1, 1][: self.pixels.shape[2]]
        return [self.steps[min(plane, len(self.steps) - 1)] for plane in planes]

    @property
    def bands(self) -> list[slice]:
        """Bands of rows that are processed one at a time."""
        count, columns = self.used.shape
        rows = next((rows for rows in _BANDS if rows * columns <= _PIXELS), _BANDS[-1])
        return list(large_arrays.blocks(count, rows))

    def planes_of(self, pixels: Array) -> list[Float32s]:
        """Convert rows of pixels of full scale 255 to luma and chroma."""
        if pixels.shape[2] == 1:
            return [pixels[..., 0].astype(np.float32) - np.float32(128)]
        # Not with BLAS, whose idle threads keep spinning.
        mixed = np.einsum("ij,rcj->irc", YCC.astype(np.float32), pixels.astype(np.float32))
        mixed[0] -= 128
        chroma: list[Float32s] = [_means_over(plane, self.span) for plane in mixed[1:]]
        return [mixed[0], *chroma]

    def uninterpolated_planes_of(self, pixels: Array) -> list[Float32s]:
        """Return the luma and chroma that rows of pixels were decoded from, before interpolation."""
        luma, *chroma = self.planes_of(pixels)
        return [luma, *(_uninterpolated(plane, self.span) for plane in chroma)]

    def stored_planes(self, rows: slice) -> list[Float32s]:
        """Return the stored luma and chroma of some rows, computed with additional rows around."""
        first = max(0, rows.start - _CHROMA_MARGIN)
        planes = self.uninterpolated_planes_of(self.pixels[first : rows.stop + _CHROMA_MARGIN])
        spans = [1, self.span[0], self.span[0]]
        return [
            plane[(rows.start - first) // span :][: (rows.stop - rows.start) // span]
            for plane, span in zip(planes, spans, strict=False)
        ]

    def pixels_of(self, planes: Sequence[Float32s], shape: tuple[int, ...]) -> Float32s:
        """Convert changes of planes to changes of pixels (R, C, 1 or 3); 0 beyond the planes."""
        whole = np.zeros((len(planes), *shape[:2]), np.float32)
        for plane, target, span in zip(planes, whole, [(1, 1), self.span, self.span], strict=False):
            large = _interpolated(plane, span)
            target[: len(large), : large.shape[1]] = large[: len(target), : target.shape[1]]
        if len(planes) == 1:
            return np.asarray(whole[0][..., None])
        return np.asarray(np.einsum("ij,jrc->rci", _RGB.astype(np.float32), whole))

    def sigma_of_planes(self, sigma: float) -> list[float]:
        """Convert the standard deviation of noise of pixels to that of each plane."""
        if self.pixels.shape[2] == 1:
            return [sigma]
        luma, *chroma = (sigma * np.sqrt(np.square(YCC).sum(axis=1))).tolist()
        return [luma, *(each / np.sqrt(self.span[0] * self.span[1]) for each in chroma)]


def decode_in_place(image: JpegImage, pilot: Float32s, sigma: float) -> None:
    """Replace a pilot, shape (H, W, 1 or 3), by the expected pixels before compression, both of full scale 1."""
    for rows in image.bands:
        stored = image.pixels[rows].astype(np.float32)
        decoded = expected_pixels(image, stored, image.stored_planes(rows), 255 * pilot[rows], sigma)
        pilot[rows] = decoded / np.float32(255)


def expected_pixels(
    image: JpegImage, stored: Float32s, planes: Sequence[Float32s], pilot: Float32s, sigma: float
) -> Float32s:
    """Return the expected pixels before compression, by the planes that stored pixels were decoded from and a pilot.

    Pixels have full scale 255, `sigma` full scale 1.
    """
    of_planes = image.tables, image.sigma_of_planes(255 * sigma)
    darker = normal_tables().clipping_bias(pilot / np.float32(255), sigma) * np.float32(255)
    differences = []
    for plane, near, steps, noise in zip(planes, image.planes_of(pilot - darker), *of_planes, strict=True):
        changes, means = coefficients_of(near), coefficients_of(plane)
        for mean, row in zip(changes, means, strict=True):  # one by one, as this takes many arrays
            mean[:] = _truncated_normal_mean(mean, noise, np.rint(row / steps) * steps, steps / 2) - mean
        differences.append(_from_coefficients(changes))
    # The loss of chroma by subsampling is taken from the pilot alone. Beyond whole blocks nothing is known.
    whole = tuple(
        slice(0, size - size % (SIDE * span)) for size, span in zip(stored.shape, image.span, strict=False)
    )
    pixels = stored + darker
    pixels[whole] = (pilot + image.pixels_of(differences, stored.shape))[whole]
    return pixels


def _truncated_normal_mean(mean: Float32s, sigma: float, middle: Float64s, reach: Float64s) -> Float32s:
    """Return the mean of a normal variable truncated to [middle - reach, middle + reach]."""
    from scipy.special import ndtr

    # Use the side of 0 on which the distribution function does not lose digits.
    sign = np.where(middle > mean, -1, 1)
    centre = sign * (middle - mean) / sigma
    low, high = centre - reach / sigma, centre + reach / sigma
    mass = ndtr(high) - ndtr(low)
    slope = (np.exp(-np.square(low) / 2) - np.exp(-np.square(high) / 2)) / np.sqrt(2 * np.pi)
    # Far from the mean, nearly all mass is at the nearer end.
    inside = np.clip(np.where(mass > 1e-30, slope / np.maximum(mass, 1e-30), high), low, high)
    return np.asarray(mean + sign * sigma * inside, np.float32)


def compressed(image: JpegImage, pixels: Float32s) -> Float32s:
    """Simulate JPEG compression of pixels; beyond whole blocks only chroma is averaged."""
    planes = image.planes_of(pixels)
    for plane, steps in zip(planes, image.tables, strict=True):
        rounded = _from_coefficients(np.rint(coefficients_of(plane) / steps) * steps)
        plane[: len(rounded), : rounded.shape[1]] = rounded
    planes[0] += 128
    return image.pixels_of(planes, pixels.shape)


def _interpolated(plane: Float32s, span: tuple[int, int]) -> Float32s:
    """Upsample a plane to pixels; like decoders, interpolate between samples two pixels apart."""
    for axis, times in enumerate(span):
        if times != 2:
            plane = plane.repeat(times, axis=axis)
            continue
        samples = np.moveaxis(plane, axis, 0)
        around = np.concatenate([samples[:1], samples, samples[-1:]])
        pixels = np.empty((2 * len(samples), *samples.shape[1:]), np.float32)
        pixels[::2] = _NEAREST_SHARE * samples + _NEXT_SHARE * around[:-2]
        pixels[1::2] = _NEAREST_SHARE * samples + _NEXT_SHARE * around[2:]
        plane = np.moveaxis(pixels, 0, axis)
    return plane


def _uninterpolated(means: Float32s, span: tuple[int, int]) -> Float32s:
    """Return the samples whose interpolated pixels have these means over spans."""
    from scipy.linalg import solve_banded

    for axis, times in enumerate(span):
        if times == 2 and means.shape[axis] > 1:
            rows = np.moveaxis(means, axis, 0)
            bands = np.full((3, len(rows)), _NEXT_SHARE / 2)
            bands[1] = _NEAREST_SHARE
            bands[1, [0, -1]] += _NEXT_SHARE / 2
            samples = solve_banded((1, 1), bands, rows.reshape(len(rows), -1)).reshape(rows.shape)
            means = np.moveaxis(samples.astype(np.float32), 0, axis)
    return means


def _means_over(plane: Float32s, span: tuple[int, int]) -> Float32s:
    rows, columns = (size // step for size, step in zip(plane.shape, span, strict=True))
    whole = plane[: rows * span[0], : columns * span[1]]
    return np.asarray(whole.reshape(rows, span[0], columns, span[1]).mean(axis=(1, 3)), np.float32)


def _in_blocks(plane: Array) -> Array:
    """View the whole blocks of a plane, shape (R, C, 8, 8)."""
    rows, columns = (size // SIDE for size in plane.shape)
    whole = plane[: rows * SIDE, : columns * SIDE]
    return whole.reshape(rows, SIDE, columns, SIDE).transpose(0, 2, 1, 3)


def coefficients_of(plane: Float32s) -> Float32s:
    """Return the DCT of the whole blocks of a plane, shape (R, C, 8, 8)."""
    from scipy.fft import dctn

    return np.asarray(dctn(_in_blocks(plane), axes=(2, 3), norm="ortho"), np.float32)


def _from_coefficients(blocks: Array) -> Float32s:
    from scipy.fft import idctn

    rows, columns = blocks.shape[:2]
    plane = idctn(blocks, axes=(2, 3), norm="ortho").transpose(0, 2, 1, 3)
    return np.asarray(plane.reshape(rows * SIDE, columns * SIDE), np.float32)
