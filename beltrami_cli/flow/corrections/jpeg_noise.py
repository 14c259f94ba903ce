"""The white noise before JPEG compression, and the noise that decoding again leaves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s
from beltrami_cli.flow.corrections.coded_picture import YCC, CodedPicture, coded, expected
from beltrami_cli.flow.noise.features import COMPONENTS, SCALES, STEPS, symmetric
from beltrami_cli.flow.noise.grid_squares import Grid
from beltrami_cli.flow.noise.model import NoiseModel, Reading, sigma_of_covariances

# Neighbours share noise if its standard deviation grows by this factor up to the third scale.
_SHARED_GROWTH = 1.6

# Loss of originals by JPEG, as a multiple of the loss of decoded results: 1 to 3.5 on samples, largest at edges of hue.
_LOSS_OF_ORIGINAL = 3.0

# Standard deviation after decoding, relative to decoding around the true colours. It is 1.2 to 1.5 on photographs with
# noise of 10 of 255. By this factor, hand-painted pictures gain 1 to 2 dB, and photographs lose 0.1.
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


def sigma_before(pictures: Sequence[CodedPicture], noise: NoiseModel) -> float | None:
    """Estimate sigma of white noise before compression from the decoded noise; None if it cannot be estimated."""
    if noise.relative is not None:
        return None
    noise = noise.as_read()
    channels = pictures[0].pixels.shape[2]
    luma = YCC[0] if channels > 1 else np.ones(1)
    variances = np.einsum("i,lij,j->l", luma, noise.covariances[:, :channels, :channels], luma)
    # JPEG preserves most of the luma noise in means of 2 x 2 pixels, where its steps are small.
    fine, middle, coarse = (variances[min(scale, len(variances) - 1)] for scale in range(3))
    sigma = noise.difference_to_input(float(np.sqrt(middle / np.square(luma).sum())))
    is_white = coarse < _SHARED_GROWTH**2 * middle and middle < _MAX_TAKEN**2 * fine
    return sigma if is_white and sigma >= _MIN_SIGMA else None


def is_changed(pictures: Sequence[CodedPicture], sigma: float) -> bool:
    """Whether JPEG changes noise of this standard deviation."""
    return any(
        max(each.span) > 1 or np.median(each.steps[0]) > _COARSE * each.sigma_of_planes(255 * sigma)[0]
        for each in pictures
    )


def noise_after(
    pictures: Sequence[CodedPicture], pilots: Sequence[Float32s], sigma: float
) -> tuple[NoiseModel, Float64s]:
    """Estimate the noise left by decoding, and the RMS error of stored pixels, per channel.

    Both are measured on the pilots, with noise added and compressed.
    """
    random = np.random.default_rng(_SEED)
    channels = pictures[0].pixels.shape[2]
    after, lost = (_Covariances(channels) for _ in range(2))
    squares, used = np.zeros(channels), 0
    for picture, pilot, bands in zip(pictures, pilots, _choose_bands(pictures), strict=True):
        for rows in bands:
            truth = 255 * pilot[rows]
            noisy = truth + np.float32(255 * sigma) * random.standard_normal(truth.shape, np.float32)
            stored = coded(picture, np.rint(np.clip(noisy, 0, 255)))
            lost.add(coded(picture, truth) - truth, picture.used[rows])
            error = (np.clip(stored, 0, 255) - truth)[picture.used[rows]] / 255
            squares += np.square(error).sum(axis=0, dtype=np.float64)
            used += len(error)
            decoded = expected(picture, stored, picture.decoded_planes(stored), truth, sigma)
            after.add(decoded - truth, picture.used[rows])
    covariances, stored_error = PILOT_ERROR**2 * after.mean(), np.sqrt(squares / max(1, used))
    # The loss of detail of the original is estimated by that of the pilot.
    doubt = _LOSS_OF_ORIGINAL * float(np.mean(np.square(sigma_of_covariances(lost.mean()))))
    fine, coarse = (np.linalg.eigvalsh(covariances[scale]) for scale in (0, 2))
    sigma_after = sigma_of_covariances(covariances)
    if np.all(coarse < _SHARED_GROWTH**2 * np.maximum(fine, 1e-12)):
        covariances = np.diag(np.square(sigma_after))[None]
    overall = float(np.sqrt(np.mean(np.square(sigma_after))))
    reading = Reading(0.0, overall, overall, float(np.hypot(overall, np.sqrt(doubt))))
    return NoiseModel(covariances, reading=reading), stored_error


def _choose_bands(pictures: Sequence[CodedPicture]) -> list[list[slice]]:
    """Choose evenly spread bands of rows of each picture, with enough pixels together to measure noise."""
    share, chosen = _ENOUGH_PIXELS / max(1, sum(each.used.size for each in pictures)), []
    for picture in pictures:
        bands = list(picture.bands)
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
        seen = Grid.of(used, most=used.size).cut(planes, np.arange(3))
        for number, scale in enumerate(seen.where.scales[:SCALES]):
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
