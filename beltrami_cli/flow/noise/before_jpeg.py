"""White noise that was in pictures before JPEG coded them.

In even blocks the share of DCT coefficients that are not 0 tells how strong it was. What is left of it when pictures
are decoded with that known shows on a pilot, with noise added, coded and decoded alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s, Int64s
from beltrami_cli.flow.noise.by_scale import SCALES, FoundNoise
from beltrami_cli.flow.noise.coded_picture import (
    SIDE,
    CodedPicture,
    coded,
    coefficients_of,
    correction,
    in_blocks,
    means_over,
)
from beltrami_cli.flow.noise.grid_scales import MOST_CELLS, all_filled, corners_of
from beltrami_cli.flow.noise.haar_noise import sigma_of_covariances

# The order of a coefficient is that of its row plus that of its column.
_ORDERS = np.add.outer(np.arange(SIDE), np.arange(SIDE)).reshape(-1)

# Blocks in which the first order has the least energy are even: this share, but not fewer than so many.
_EVEN, _FEWEST = 0.25, 40

# Orders of coefficients that are counted together: of luma, where texture hides the lower ones, and the low ones, which
# are all that coarse steps, and decoders that interpolate it, show of chroma.
_OF_LUMA, _LOW = (range(5, 8), range(8, 15)), range(2, 5)

# With this many that are not 0 a count tells something; where twice as many are expected, none tells it, too.
_TELLING = 8

# Texture has many of them in some blocks and few in others, so that their number varies by more than this factor of
# what it does with noise: by 1.7 to 12 on samples and photographs without noise, by up to 1.6 with noise of 10 of 255.
_MOST_SCATTER = 1.6

# Standard deviations differ by no more than this factor if they are of one white noise; some texture makes them larger,
# and those up to the other factor above the least are taken together.
_ALIKE, _NEAR = 1.45, 1.15

# With fewer of the highest orders, nothing but the low ones can tell that noise was not white. That of cameras exceeds
# this factor on photographs, from 1.25 on, and grain of two texels from 1.6 on, white noise on one of five.
_CERTAIN, _ALIKE_LOW = 100, 1.3

# Noise differs from place to place if it is louder by this factor in more than this share of them; and the rows and
# columns of blocks of a place.
_LOUDER, _MANY, _BLOCKS_OF_PLACE = 1.7, 0.1, 16

# Noise that is worth it; and steps of luma, relative to its noise, that do, unless chroma is coarser.
_LEAST_SIGMA, _COARSE = 2.0 / 255, 1.5

# Noise is shared by neighbours if its standard deviation grows by this factor to the third scale.
_GROWS = 1.6

# By how much more JPEG took of pictures than it takes once more: 1 to 3.5 on samples, most where hues meet.
_LOST = 3.0

# Decoding leaves more noise than it does with a pilot that is the truth. The standard deviation is larger by 1.2 to 1.5
# on photographs with noise of 10 of 255; by this factor, painted pictures gain 1 to 2 dB, and photographs lose 0.1.
PILOT_ERROR = 1.2

_SEED = 80


def noise_before_jpeg(pictures: Sequence[CodedPicture]) -> float | None:
    """Estimate sigma of white noise that pictures had before JPEG, full scale 1.

    None if there is little beside texture, or if it was not white, or not the same in all channels, at all levels and
    places.
    """
    counted = _Counted()
    for picture, some in zip(pictures, _some_bands(pictures), strict=True):
        counted.add(picture, some)
    luma = counted.luma
    telling = [own for own in luma if own.observed >= _TELLING]
    if not telling or not _Counts.joined(telling).is_noise:
        return None
    sigmas = [own.sigma for own in telling]
    least, most = min(sigmas), max(sigmas)
    if most > _ALIKE * least or least < 255 * _LEAST_SIGMA:
        return None
    if any(own.expected(least) > 2 * _TELLING for own in luma if own not in telling):
        return None
    near = [own for own, found in zip(telling, sigmas, strict=True) if found < _NEAR * least]
    sigma = _Counts.joined(near).sigma
    is_white = min(own.observed for own in luma[-2:]) >= _CERTAIN
    if not is_white and counted.low.sigma > _ALIKE_LOW * sigma:
        return None
    if counted.chroma.expected(sigma) > 2 * _TELLING and counted.chroma.sigma < sigma / _ALIKE:
        return None
    if counted.differs(sigma):
        return None
    return sigma / 255


def is_changed(pictures: Sequence[CodedPicture], sigma: float) -> bool:
    """Whether JPEG did not leave noise of a standard deviation as it was."""
    return any(
        max(each.span) > 1 or np.median(each.steps[0]) > _COARSE * each.sigma_of_planes(255 * sigma)[0]
        for each in pictures
    )


class _Counts:
    """How many coefficients of some kind are not 0, and of how many of each step."""

    def __init__(self) -> None:
        self.observed = 0
        self._variance, self._even = 0.0, 0.0  # of their number in a block, and that if they were independent
        self._steps: list[Float64s] = []  # of coefficients, in units of their noise for a sigma of 1
        self._blocks: list[int] = []

    @classmethod
    def joined(cls, parts: Sequence[_Counts]) -> _Counts:
        """Count all together."""
        whole = cls()
        whole.observed = sum(part.observed for part in parts)
        whole._steps = [steps for part in parts for steps in part._steps]
        whole._blocks = [blocks for part in parts for blocks in part._blocks]
        whole._variance, whole._even = (
            sum(own) for own in zip(*((p._variance, p._even) for p in parts), strict=True)
        )
        return whole

    def add(self, multiples: Float64s, steps: Float64s, orders: range) -> None:
        """Add coefficients of some orders, in units of their steps, shape (B, 64); `steps`: in units of noise."""
        of_order = np.isin(_ORDERS, orders)
        found, steps = multiples[:, of_order] != 0, steps[of_order]
        self.observed += int(np.count_nonzero(found))
        if len(found):
            shares = found.mean(axis=0)
            self._variance += len(found) * float(found.sum(axis=1).var())
            self._even += len(found) * float((shares * (1 - shares)).sum())
        self._steps.append(steps)
        self._blocks.append(len(multiples))

    def expected(self, sigma: float) -> float:
        """Return how many are not 0 for white noise."""
        from scipy.special import ndtr

        parts = zip(self._steps, self._blocks, strict=True)
        return float(sum(2 * blocks * ndtr(-steps / (2 * sigma)).sum() for steps, blocks in parts))

    @property
    def is_noise(self) -> bool:
        """Whether their numbers differ from block to block as those of noise do."""
        return self._variance <= _MOST_SCATTER * self._even

    @property
    def sigma(self) -> float:
        """The noise that explains them."""
        low, high = 0.0, 255.0
        for _ in range(30):
            middle = (low + high) / 2
            low, high = (middle, high) if self.expected(middle) < self.observed else (low, middle)
        return high


class _Counted:
    """Coefficients of even blocks that are not 0."""

    def __init__(self) -> None:
        self.luma = [_Counts() for _ in range(2 * len(_OF_LUMA))]  # by orders, in darker and brighter blocks
        self.low, self.chroma = _Counts(), _Counts()  # low orders of luma and of chroma
        self.places: list[_Counts] = []  # the first of the orders of luma in each part of the pictures

    def add(self, picture: CodedPicture, some: Sequence[slice]) -> None:
        """Add bands of rows of a picture."""
        parts = [_band_of(picture, rows) for rows in some]
        for plane, (table, unit) in enumerate(zip(picture.tables, picture.sigma_of_planes(1.0), strict=True)):
            blocks, steps = np.concatenate([part.planes[plane] for part in parts]), table.reshape(-1)
            if len(blocks) < _FEWEST:
                continue
            even = _most_even(blocks)
            multiples = np.rint(even / steps)
            (self.chroma if plane else self.low).add(multiples, steps / unit, _LOW)
            if plane:
                continue
            bright = even[:, 0] > np.median(even[:, 0])
            for number, orders in enumerate(_OF_LUMA):
                for level in (0, 1):
                    self.luma[2 * number + level].add(multiples[bright == level], steps / unit, orders)
            places = np.concatenate([part.places for part in parts])
            for place in np.unique(places):
                own = _Counts()
                own.add(np.rint(_most_even(blocks[places == place]) / steps), steps / unit, _OF_LUMA[0])
                self.places.append(own)

    def differs(self, sigma: float) -> bool:
        """Whether noise is stronger than elsewhere in many places."""
        louder = [
            own
            for own in self.places
            if own.observed >= _TELLING and own.is_noise and own.sigma > _LOUDER * sigma
        ]
        return len(louder) > _MANY * len(self.places)


def _most_even(blocks: Float32s) -> Float32s:
    """Return the coefficients of the blocks, shape (B, 64), in which the first order has the least energy."""
    energy = np.square(blocks[:, _ORDERS == 1]).sum(axis=1)
    count = max(_FEWEST, int(_EVEN * len(blocks)))
    return blocks[np.argsort(energy, kind="stable")[:count]]


def _some_bands(pictures: Sequence[CodedPicture]) -> list[list[slice]]:
    """Choose bands of rows of each picture, evenly spread, with enough pixels together to estimate noise from."""
    share, chosen = MOST_CELLS / max(1, sum(each.used.size for each in pictures)), []
    for picture in pictures:
        bands = list(picture.bands)
        wanted = max(1, min(len(bands), round(share * len(bands))))
        chosen.append([bands[number] for number in np.linspace(0, len(bands) - 1, wanted).astype(int)])
    return chosen


@dataclass(frozen=True)
class _Band:
    """Blocks of some rows of a picture, where nothing is cut off or beyond borders."""

    planes: list[Float32s]  # coefficients of each plane, shape (B, 64)
    places: Int64s  # in which blocks of luma are, shape (B,)


def _band_of(picture: CodedPicture, rows: slice) -> _Band:
    pixels = picture.pixels[rows]
    inside = picture.used[rows] & ((pixels > 0) & (pixels < 255)).all(axis=2)
    planes, places = [], np.zeros(0, np.int64)
    for number, plane in enumerate(picture.planes(pixels)):
        fits = means_over(inside.astype(np.float32), picture.span) == 1 if number else inside
        whole = in_blocks(fits).all(axis=(2, 3))
        planes.append(coefficients_of(plane)[whole].reshape(-1, SIDE**2))
        if not number:
            down = rows.start // (SIDE * _BLOCKS_OF_PLACE)
            places = down * picture.used.shape[1] + np.nonzero(whole)[1] // _BLOCKS_OF_PLACE
    return _Band(planes, places)


def noise_after(
    pictures: Sequence[CodedPicture], pilots: Sequence[Float32s], sigma: float
) -> tuple[FoundNoise, Float64s]:
    """Find what `decode` leaves of noise, and sigma by channel before it: on the pilots, noise added and coded."""
    random = np.random.default_rng(_SEED)
    channels = pictures[0].pixels.shape[2]
    before, after, lost = (_Covariances(channels) for _ in range(3))
    for number, (picture, some) in enumerate(zip(pictures, _some_bands(pictures), strict=True)):
        for rows in some:
            truth = 255 * pilots[number][rows]
            noisy = truth + np.float32(255 * sigma) * random.standard_normal(truth.shape, np.float32)
            stored = coded(picture, np.rint(np.clip(noisy, 0, 255)))
            lost.add(coded(picture, truth) - truth, picture.used[rows])
            before.add(stored - truth, picture.used[rows])
            after.add(stored + correction(picture, stored, truth, sigma) - truth, picture.used[rows])
    covariances, read = PILOT_ERROR**2 * after.mean(), sigma_of_covariances(before.mean())
    # What JPEG takes of a picture that went through it already, it took of the picture before.
    doubt = _LOST * float(np.mean(np.square(sigma_of_covariances(lost.mean()))))
    own = sigma_of_covariances(covariances)
    fine, coarse = (np.linalg.eigvalsh(covariances[scale]) for scale in (0, 2))
    if np.all(coarse < _GROWS**2 * np.maximum(fine, 1e-12)):
        return FoundNoise(doubt=doubt, sigma=own), read
    return FoundNoise(None, covariances, doubt, own), read


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
