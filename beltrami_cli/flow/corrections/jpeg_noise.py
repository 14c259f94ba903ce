"""The white noise before JPEG compression, and the noise that decoding again leaves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s
from beltrami_cli.flow.corrections.jpeg_image import YCC, JpegImage, compressed, expected_pixels
from beltrami_cli.flow.noise.components import COMPONENTS, SCALES, STEPS, sigma_of_covariances, symmetric
from beltrami_cli.flow.noise.grid_squares import GridSquares
from beltrami_cli.flow.noise.model import NoiseModel, Reading

# Neighbours share noise if its standard deviation grows by this factor up to the third scale.
_SHARED_GROWTH = 1.6

# Loss of originals by JPEG, as a multiple of the loss of decoded results: 1 to 3.5 on samples, largest at edges of hue.
_LOSS_OF_ORIGINAL = 3.0

# Standard deviation after decoding, relative to decoding around the true colours. It is 1.2 to 1.5 on photographs with
# noise of 10 of 255. By this factor, hand-painted images gain 1 to 2 dB, and photographs lose 0.1.
PILOT_ERROR = 1.2

# Minimum standard deviation of noise that is worth decoding again.
_MIN_SIGMA = 2.0 / 255

# Largest reduction of the finest luma noise by JPEG: white noise of 6 is halved at a quality of 75.
_MAX_TAKEN = 2.7

# Luma steps relative to the noise, from which on they change the noise.
_COARSE = 1.5

# Number of pixels that suffices to estimate covariances.
_ENOUGH_PIXELS = 400_000

_SEED = 80


def sigma_before(images: Sequence[JpegImage], noise: NoiseModel) -> float | None:
    """Estimate sigma of white noise before compression from the decoded noise; None if it cannot be estimated."""
    if noise.relative is not None:
        return None
    noise = noise.as_read()
    channels = images[0].pixels.shape[2]
    luma = YCC[0] if channels > 1 else np.ones(1)
    variances = np.einsum("i,lij,j->l", luma, noise.covariances[:, :channels, :channels], luma)
    # JPEG preserves most of the luma noise in means of 2 x 2 pixels, where its steps are small.
    fine, middle, coarse = (variances[min(scale, len(variances) - 1)] for scale in range(3))
    sigma = noise.difference_to_input(float(np.sqrt(middle / np.square(luma).sum())))
    is_white = coarse < _SHARED_GROWTH**2 * middle and middle < _MAX_TAKEN**2 * fine
    return sigma if is_white and sigma >= _MIN_SIGMA else None


def is_changed(images: Sequence[JpegImage], sigma: float) -> bool:
    """Whether JPEG changes noise of this standard deviation."""
    return any(
        max(each.span) > 1 or np.median(each.steps[0]) > _COARSE * each.sigma_of_planes(255 * sigma)[0]
        for each in images
    )


def noise_after(
    images: Sequence[JpegImage], pilots: Sequence[Float32s], sigma: float
) -> tuple[NoiseModel, Float64s]:
    """Estimate the noise left by decoding, and the RMS error of stored pixels, per channel.

    Both are measured on the pilots, with noise added and compressed.
    """
    channels = images[0].pixels.shape[2]
    after, lost = (_Covariances(channels) for _ in range(2))
    squares, count = np.zeros(channels), 0
    for image, used, truth, stored in _simulated(images, pilots, sigma):
        lost.add(compressed(image, truth) - truth, used)
        decoded = expected_pixels(image, stored, image.uninterpolated_planes_of(stored), truth, sigma)
        after.add(decoded - truth, used)
        errors = (np.clip(stored, 0, 255) - truth)[used] / 255
        squares += np.square(errors).sum(axis=0, dtype=np.float64)
        count += len(errors)
    return _model_of(PILOT_ERROR**2 * after.mean(), lost.mean()), np.sqrt(squares / max(1, count))


def _simulated(
    images: Sequence[JpegImage], pilots: Sequence[Float32s], sigma: float
) -> Iterator[tuple[JpegImage, Bools, Float32s, Float32s]]:
    """Compress pilots with added noise, in bands of rows; yield the image, its samples, the pilot and the result."""
    random = np.random.default_rng(_SEED)
    for image, pilot, bands in zip(images, pilots, _choose_bands(images), strict=True):
        for rows in bands:
            truth = 255 * pilot[rows]
            noisy = truth + np.float32(255 * sigma) * random.standard_normal(truth.shape, np.float32)
            yield image, image.used[rows], truth, compressed(image, np.rint(np.clip(noisy, 0, 255)))


def _model_of(covariances: Float64s, lost: Float64s) -> NoiseModel:
    """Model the noise after decoding by its covariances, and by how compression changes pilots."""
    # The loss of detail of the original is estimated by that of the pilot.
    doubt = _LOSS_OF_ORIGINAL * float(np.mean(np.square(sigma_of_covariances(lost))))
    fine, coarse = (np.linalg.eigvalsh(covariances[scale]) for scale in (0, 2))
    sigma_after = sigma_of_covariances(covariances)
    if np.all(coarse < _SHARED_GROWTH**2 * np.maximum(fine, 1e-12)):
        covariances = np.diag(np.square(sigma_after))[None]
    overall = float(np.sqrt(np.mean(np.square(sigma_after))))
    reading = Reading(0.0, overall, overall, float(np.hypot(overall, np.sqrt(doubt))))
    return NoiseModel(covariances, reading=reading)


def _choose_bands(images: Sequence[JpegImage]) -> list[list[slice]]:
    """Choose evenly spread bands of rows of each image, with enough pixels together to measure noise."""
    share, chosen = _ENOUGH_PIXELS / max(1, sum(each.used.size for each in images)), []
    for image in images:
        bands = list(image.bands)
        wanted = max(1, min(len(bands), round(share * len(bands))))
        chosen.append([bands[number] for number in np.linspace(0, len(bands) - 1, wanted).astype(int)])
    return chosen


class _Covariances:
    """Covariances of Haar details of noise, in the form of `noise.model`."""

    def __init__(self, channels: int) -> None:
        self._channels, self._sums, self._counted = channels, np.zeros((SCALES, 6)), np.zeros(SCALES)

    def add(self, noise: Float32s, used: Bools) -> None:
        """Add details of noise, shape (R, C, 1 or 3), full scale 255, in squares of used cells."""
        planes = np.broadcast_to(np.moveaxis(noise / np.float32(255), 2, 0), (3, *used.shape))
        seen = GridSquares.of(used, most=used.size).cut(planes, np.arange(3))
        for number, scale in enumerate(seen.scales[:SCALES]):
            self._sums[number] += seen.products[number] @ scale.freedom
            self._counted[number] += scale.freedom.sum()

    def mean(self) -> Float64s:
        """Return the mean covariances, shape (L, N, N); scales without details repeat the next finer one."""
        means = self._sums / np.maximum(self._counted, 1)[:, None] / np.square(float(STEPS))
        for scale in range(1, SCALES):
            if not self._counted[scale]:
                means[scale] = means[scale - 1]
        mixing = COMPONENTS[:, : self._channels].astype(np.float64)
        covariances: Float64s = np.einsum("kc,lkm,md->lcd", mixing, symmetric(means), mixing)
        return covariances
