"""The noise that is left when pictures that JPEG coded are decoded with the noise before known.

It shows on a pilot, with noise added, coded and decoded alike.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s
from beltrami_cli.flow.noise.before_jpeg import some_bands
from beltrami_cli.flow.noise.by_scale import SCALES, FoundNoise
from beltrami_cli.flow.noise.coded_picture import CodedPicture, coded, expected
from beltrami_cli.flow.noise.grid_scales import all_filled, corners_of
from beltrami_cli.flow.noise.haar_noise import sigma_of_covariances

# Noise is shared by neighbours if its standard deviation grows by this factor to the third scale.
_GROWS = 1.6

# By how much more JPEG took of pictures than it takes once more: 1 to 3.5 on samples, most where hues meet.
_LOST = 3.0

# Decoding leaves more noise than it does with a pilot that is the truth. The standard deviation is larger by 1.2 to 1.5
# on photographs with noise of 10 of 255; by this factor, painted pictures gain 1 to 2 dB, and photographs lose 0.1.
PILOT_ERROR = 1.2

_SEED = 80


def noise_after(
    pictures: Sequence[CodedPicture], pilots: Sequence[Float32s], sigma: float
) -> tuple[FoundNoise, Float64s]:
    """Find what `decode` leaves of noise, and the root mean square of what stored pixels differ by, per channel.

    Both on the pilots, noise added and coded.
    """
    random = np.random.default_rng(_SEED)
    channels = pictures[0].pixels.shape[2]
    after, lost = (_Covariances(channels) for _ in range(2))
    squares, used = np.zeros(channels), 0
    for number, (picture, some) in enumerate(zip(pictures, some_bands(pictures), strict=True)):
        for rows in some:
            truth = 255 * pilots[number][rows]
            noisy = truth + np.float32(255 * sigma) * random.standard_normal(truth.shape, np.float32)
            stored = coded(picture, np.rint(np.clip(noisy, 0, 255)))
            lost.add(coded(picture, truth) - truth, picture.used[rows])
            error = (np.clip(stored, 0, 255) - truth)[picture.used[rows]] / 255
            squares += np.square(error).sum(axis=0, dtype=np.float64)
            used += len(error)
            decoded = expected(picture, stored, picture.decoded_planes(stored), truth, sigma)
            after.add(decoded - truth, picture.used[rows])
    covariances, stored_error = PILOT_ERROR**2 * after.mean(), np.sqrt(squares / max(1, used))
    # What JPEG takes of a picture that went through it already, it took of the picture before.
    doubt = _LOST * float(np.mean(np.square(sigma_of_covariances(lost.mean()))))
    own = sigma_of_covariances(covariances)
    fine, coarse = (np.linalg.eigvalsh(covariances[scale]) for scale in (0, 2))
    if np.all(coarse < _GROWS**2 * np.maximum(fine, 1e-12)):
        return FoundNoise(doubt=doubt, sigma=own), stored_error
    return FoundNoise(None, covariances, doubt, own), stored_error


class _Covariances:
    """Covariances of Haar details of noise, as `haar_noise` has them."""

    def __init__(self, channels: int) -> None:
        self._sums, self._counted = np.zeros((SCALES, channels, channels)), np.zeros(SCALES)

    def add(self, noise: Float32s, used: Bools) -> None:
        """Add the details of noise, shape (R, C, N), full scale 255, in squares of used cells."""
        means, filled = np.moveaxis(noise / np.float32(255), 2, 0), used
        for scale in range(SCALES):
            corners = corners_of(means)
            means = corners.mean(axis=0)
            filled = all_filled(filled)
            details = (corners - means)[:, :, filled].astype(np.float64)
            self._sums[scale] += 4**scale * np.einsum("aik,ajk->ij", details, details) / 3
            self._counted[scale] += np.count_nonzero(filled)

    def mean(self) -> Float64s:
        """Return them, shape (L, N, N); coarse ones of which there were none are as the next finer ones."""
        means: Float64s = self._sums / np.maximum(self._counted, 1)[:, None, None]
        for scale in range(1, SCALES):
            if not self._counted[scale]:
                means[scale] = means[scale - 1]
        return means
