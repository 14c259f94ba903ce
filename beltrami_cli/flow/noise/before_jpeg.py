"""White noise that was in pictures before JPEG coded them.

In even blocks the share of DCT coefficients that are not 0 tells how strong it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s, Int64s
from beltrami_cli.flow.noise.coded_picture import (
    SIDE,
    CodedPicture,
    coefficients_of,
    in_blocks,
    means_over,
    shares_of_channels,
)
from beltrami_cli.flow.noise.grid_scales import MOST_CELLS, corners_of

# The order of a coefficient is that of its row plus that of its column.
_ORDERS = np.add.outer(np.arange(SIDE), np.arange(SIDE)).reshape(-1)

# Blocks in which the first orders have the least energy are even: this share, but not fewer than so many, and of luma
# the more even half while the scatter, see below, exceeds that of noise by this factor.
_FIRST, _EVEN, _FEWEST, _EVEN_SCATTER = 2, 0.25, 40, 1.3

# Noise of channels is cut off in blocks of which a quarter has a mean within this many standard deviations of a limit,
# and those in which more than this share of a plane's noise is lost so are left out. That no pixel is cut off does not
# do: of a bright block, JPEG leaves none at the limit if it took all noise, so that those would count alone.
_NEAR_LIMIT, _MOST_LOST = 1.25, 0.3

# Standard deviation of noise, full scale 255, for which blocks are chosen at first, and how often they are chosen anew.
_FIRST_SIGMA, _ROUNDS = 20.0, 4

# Orders of coefficients that are counted together: of luma, where texture hides the lower ones, and the low ones, which
# are all that coarse steps, and decoders that interpolate it, show of chroma.
_OF_LUMA, _LOW = (range(5, 8), range(8, 15)), range(3, 5)

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
_LOUDER, _MANY, _BLOCKS_OF_PLACE = 1.7, 0.2, 16

# Noise that is worth it; and steps of luma, relative to its noise, that do, unless chroma is coarser.
_LEAST_SIGMA, _COARSE = 2.0 / 255, 1.5


def noise_before_jpeg(pictures: Sequence[CodedPicture]) -> float | None:
    """Estimate sigma of white noise that pictures had before JPEG, full scale 1.

    None if there is little beside texture, or if it was not white, or not the same in all channels, at all levels and
    places.
    """
    counted = _counted(pictures)
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


def _counted(pictures: Sequence[CodedPicture]) -> _Counted:
    """Count coefficients of blocks in which the noise that they show is not cut off."""
    chosen = [
        (picture, [_band_of(picture, rows) for rows in some])
        for picture, some in zip(pictures, some_bands(pictures), strict=True)
    ]
    sigma = _FIRST_SIGMA
    for _ in range(_ROUNDS):
        counted = _Counted()
        for picture, bands in chosen:
            counted.add(picture, bands, sigma)
        joined = _Counts.joined(counted.luma)
        sigma = joined.sigma if joined.observed >= _TELLING else sigma / 2
    return counted


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
        return self.scatter <= _MOST_SCATTER

    @property
    def scatter(self) -> float:
        """The variance of their number in a block, relative to that of independent ones."""
        return self._variance / self._even if self._even else 0.0

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
        self.places: list[list[_Counts]] = []  # by orders of luma, in each part of the pictures

    def add(self, picture: CodedPicture, bands: Sequence[_Band], sigma: float) -> None:
        """Add bands of rows of a picture; `sigma`: of noise of pixels, which may be cut off."""
        for plane, (table, unit) in enumerate(zip(picture.tables, picture.sigma_of_planes(1.0), strict=True)):
            whole = np.concatenate([band.within(plane, sigma) for band in bands])
            blocks = np.concatenate([band.planes[plane] for band in bands])[whole]
            steps = table.reshape(-1)
            if len(blocks) < _FEWEST:
                continue
            even = _most_even(blocks)
            multiples = np.rint(even / steps)
            if plane:
                self.chroma.add(multiples, steps / unit, _LOW)
                continue
            count = _free_of_texture(multiples)
            even, multiples = even[:count], multiples[:count]
            self.low.add(multiples, steps / unit, _LOW)
            bright = even[:, 0] > np.median(even[:, 0])
            for number, orders in enumerate(_OF_LUMA):
                for level in (0, 1):
                    self.luma[2 * number + level].add(multiples[bright == level], steps / unit, orders)
            places = np.concatenate([band.places for band in bands])[whole]
            for place in np.unique(places):
                own, there = [_Counts() for _ in _OF_LUMA], _most_even(blocks[places == place])
                for counts, orders in zip(own, _OF_LUMA, strict=True):
                    counts.add(np.rint(there / steps), steps / unit, orders)
                self.places.append(own)

    def differs(self, sigma: float) -> bool:
        """Whether noise is stronger than elsewhere in many places."""
        louder = sum(_is_louder(first, last, _LOUDER * sigma) for first, last in self.places)
        return louder > _MANY * len(self.places)


def _is_louder(first: _Counts, last: _Counts, sigma: float) -> bool:
    """Whether there is noise above this in both orders of luma; texture, as of wood, has less of the last ones."""
    if first.observed < _TELLING or not first.is_noise or first.sigma <= sigma:
        return False
    return last.sigma > sigma or last.expected(sigma) < 2 * _TELLING


def _most_even(blocks: Float32s) -> Float32s:
    """Return the coefficients of the blocks, shape (B, 64), in which the first orders have the least energy."""
    energy = np.square(blocks[:, (_ORDERS > 0) & (_ORDERS <= _FIRST)]).sum(axis=1)
    count = max(_FEWEST, int(_EVEN * len(blocks)))
    return blocks[np.argsort(energy, kind="stable")[:count]]


def _free_of_texture(multiples: Float64s) -> int:
    """Return how many blocks differ by no more than noise does; the most even ones come first."""
    count = len(multiples)
    while count > _FEWEST:
        own = _Counts()
        own.add(multiples[:count], np.ones(SIDE**2), _OF_LUMA[0])
        if own.scatter <= _EVEN_SCATTER:
            break
        count = max(_FEWEST, count // 2)
    return count


def some_bands(pictures: Sequence[CodedPicture]) -> list[list[slice]]:
    """Choose bands of rows of each picture, evenly spread, with enough pixels together to estimate noise from."""
    share, chosen = MOST_CELLS / max(1, sum(each.used.size for each in pictures)), []
    for picture in pictures:
        bands = list(picture.bands)
        wanted = max(1, min(len(bands), round(share * len(bands))))
        chosen.append([bands[number] for number in np.linspace(0, len(bands) - 1, wanted).astype(int)])
    return chosen


@dataclass(frozen=True)
class _Band:
    """Blocks of some rows of a picture that do not reach beyond borders."""

    planes: list[Float32s]  # coefficients of each plane, shape (B, 64)
    gaps: list[
        Float32s
    ]  # the same of channels: the least from the mean of a quarter to a limit, shape (B, channels)
    places: Int64s  # in which blocks of luma are, shape (B,)

    def within(self, plane: int, sigma: float) -> Bools:
        """Return which blocks of a plane keep most of their noise."""
        gaps = self.gaps[plane]
        shares = shares_of_channels(gaps.shape[1])[plane].astype(np.float32)
        return np.asarray(((gaps < _NEAR_LIMIT * sigma) * shares).sum(axis=1) <= _MOST_LOST)


def _band_of(picture: CodedPicture, rows: slice) -> _Band:
    pixels, used = picture.pixels[rows], picture.used[rows].astype(np.float32)
    planes, gaps, places = [], [], np.zeros(0, np.int64)
    for number, plane in enumerate(picture.stored_planes(rows)):
        span = picture.span if number else (1, 1)
        whole = in_blocks(means_over(used, span) == 1).all(axis=(2, 3))
        planes.append(coefficients_of(plane)[whole].reshape(-1, SIDE**2))
        quarter = span[0] * SIDE // 2, span[1] * SIDE // 2
        means = np.stack([means_over(channel, quarter) for channel in np.moveaxis(pixels, 2, 0)])
        least = corners_of(np.minimum(means, 255 - means)).min(axis=0)
        gaps.append(least[:, whole].T)
        if not number:
            down = rows.start // (SIDE * _BLOCKS_OF_PLACE)
            places = down * picture.used.shape[1] + np.nonzero(whole)[1] // _BLOCKS_OF_PLACE
    return _Band(planes, gaps, places)
