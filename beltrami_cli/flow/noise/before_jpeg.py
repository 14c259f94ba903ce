"""White noise that was in pictures before JPEG coded them.

In even blocks the share of DCT coefficients that are not 0 tells how strong it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s, Int64s
from beltrami_cli.flow.clipping import variance_at
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

# Blocks in which limits leave less than this share of the variance of noise are left out; a third is left at a limit
# itself. How much is left is known from the means of quarters, and not from pixels at a limit: JPEG leaves none there
# in a bright block of which it took all noise. Shares are rounded to so many parts.
_LEAST_LEFT, _PARTS = 0.15, 16

# Noise by which more than two thirds of the blocks would lie beyond limits is texture of the others.
_LEAST_WITHIN = 1 / 3

# Standard deviation of noise, full scale 255, for which blocks are chosen at first, and how often they are chosen anew,
# unless it changes by less than this share.
_FIRST_SIGMA, _ROUNDS, _CHANGE = 20.0, 8, 0.01

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
    if not telling or not _Counts.joined(telling).is_noise or counted.within < _LEAST_WITHIN:
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
    """Count coefficients of blocks, by the noise that limits leave in them."""
    chosen = [
        (picture, [_band_of(picture, rows) for rows in some])
        for picture, some in zip(pictures, some_bands(pictures), strict=True)
    ]
    sigma = _FIRST_SIGMA
    for _ in range(_ROUNDS):
        counted = _Counted()
        for picture, bands in chosen:
            counted.add(picture, bands, sigma)
        joined, last = _Counts.joined(counted.luma), sigma
        sigma = joined.sigma if joined.observed >= _TELLING else sigma / 2
        if abs(sigma - last) < _CHANGE * last:
            break
    return counted


def is_changed(pictures: Sequence[CodedPicture], sigma: float) -> bool:
    """Whether JPEG did not leave noise of a standard deviation as it was."""
    return any(
        max(each.span) > 1 or np.median(each.steps[0]) > _COARSE * each.sigma_of_planes(255 * sigma)[0]
        for each in pictures
    )


@dataclass(frozen=True)
class _Blocks:
    """Blocks of a plane, which can be indexed."""

    coefficients: Float32s  # shape (B, 64)
    left: Float64s  # the share of the variance of noise that limits leave in each, shape (B,)
    steps: Float64s  # of coefficients, shape (64,)
    unit: float  # the standard deviation of noise in them, relative to that of pixels

    def __getitem__(self, some: Array | slice) -> _Blocks:
        return replace(self, coefficients=self.coefficients[some], left=self.left[some])

    @property
    def multiples(self) -> Float64s:
        """The coefficients in units of their steps."""
        return np.rint(self.coefficients / self.steps)

    def most_even(self) -> _Blocks:
        """Return those in which the first orders have the least energy beside that of noise, from the least on."""
        first = self.coefficients[:, (_ORDERS > 0) & (_ORDERS <= _FIRST)]
        count = max(_FEWEST, int(_EVEN * len(first)))
        return self[np.argsort(np.square(first).sum(axis=1) / self.left, kind="stable")[:count]]

    def free_of_texture(self) -> _Blocks:
        """Return as many of the first ones as differ by no more than noise does."""
        blocks = self
        while len(blocks.left) > _FEWEST:
            counts = _Counts()
            counts.add(blocks, _OF_LUMA[0])
            if counts.scatter <= _EVEN_SCATTER:
                break
            blocks = blocks[: max(_FEWEST, len(blocks.left) // 2)]
        return blocks


def _blocks_of(picture: CodedPicture, bands: Sequence[_Band], plane: int, sigma: float) -> _Blocks:
    return _Blocks(
        np.concatenate([band.planes[plane] for band in bands]),
        np.concatenate([band.left(plane, sigma) for band in bands]),
        picture.tables[plane].reshape(-1),
        picture.sigma_of_planes(1.0)[plane],
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

    def add(self, blocks: _Blocks, orders: range) -> None:
        """Add coefficients of some orders."""
        of_order = np.isin(_ORDERS, orders)
        found, steps = blocks.multiples[:, of_order] != 0, blocks.steps[of_order] / blocks.unit
        self.observed += int(np.count_nonzero(found))
        parts = np.rint(_PARTS * blocks.left)
        for part in np.unique(parts):
            own = found[parts == part]
            shares = own.mean(axis=0)
            self._variance += len(own) * float(own.sum(axis=1).var())
            self._even += len(own) * float((shares * (1 - shares)).sum())
            self._steps.append(steps / np.sqrt(part / _PARTS))
            self._blocks.append(len(own))

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
        self._whole, self._telling = 0, 0  # blocks of luma, and those in which limits leave enough noise
        self.places: list[list[_Counts]] = []  # by orders of luma, in each part of the pictures

    def add(self, picture: CodedPicture, bands: Sequence[_Band], sigma: float) -> None:
        """Add bands of rows of a picture; `sigma`: of noise of pixels, which may be cut off."""
        for plane in range(len(picture.tables)):
            blocks = _blocks_of(picture, bands, plane, sigma)
            telling = blocks.left >= _LEAST_LEFT
            if not plane:
                self._whole += len(telling)
                self._telling += int(np.count_nonzero(telling))
            blocks = blocks[telling]
            if len(blocks.left) < _FEWEST:
                continue
            even = blocks.most_even()
            if plane:
                self.chroma.add(even, _LOW)
                continue
            even = even.free_of_texture()
            self.low.add(even, _LOW)
            bright = even.coefficients[:, 0] > np.median(even.coefficients[:, 0])
            for number, orders in enumerate(_OF_LUMA):
                for level in (0, 1):
                    self.luma[2 * number + level].add(even[bright == level], orders)
            places = np.concatenate([band.places for band in bands])[telling]
            for place in np.unique(places):
                own, there = [_Counts() for _ in _OF_LUMA], blocks[places == place].most_even()
                for counts, orders in zip(own, _OF_LUMA, strict=True):
                    counts.add(there, orders)
                self.places.append(own)

    @property
    def within(self) -> float:
        """The share of blocks that limits leave enough noise in."""
        return self._telling / max(1, self._whole)

    def differs(self, sigma: float) -> bool:
        """Whether noise is stronger than elsewhere in many places."""
        louder = sum(_is_louder(first, last, _LOUDER * sigma) for first, last in self.places)
        return louder > _MANY * len(self.places)


def _is_louder(first: _Counts, last: _Counts, sigma: float) -> bool:
    """Whether there is noise above this in both orders of luma; texture, as of wood, has less of the last ones."""
    if first.observed < _TELLING or not first.is_noise or first.sigma <= sigma:
        return False
    return last.sigma > sigma or last.expected(sigma) < 2 * _TELLING


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
    gaps: list[Float64s]  # of each plane: from means of quarters to a limit, shape (4, B, channels)
    places: Int64s  # in which blocks of luma are, shape (B,)

    def left(self, plane: int, sigma: float) -> Float64s:
        """Return which share of the variance of a plane's noise limits leave in each block."""
        gaps = self.gaps[plane]
        of_channels = shares_of_channels(gaps.shape[2])[plane]
        left: Float64s = variance_at(gaps / sigma).mean(axis=0) @ of_channels
        return left


def _band_of(picture: CodedPicture, rows: slice) -> _Band:
    pixels, used = picture.pixels[rows], picture.used[rows].astype(np.float32)
    planes: list[Float32s] = []
    gaps: list[Float64s] = []
    places = np.zeros(0, np.int64)
    for number, plane in enumerate(picture.stored_planes(rows)):
        span = picture.span if number else (1, 1)
        whole = in_blocks(means_over(used, span) == 1).all(axis=(2, 3))
        planes.append(coefficients_of(plane)[whole].reshape(-1, SIDE**2))
        quarter = span[0] * SIDE // 2, span[1] * SIDE // 2
        means = np.stack([means_over(channel, quarter) for channel in np.moveaxis(pixels, 2, 0)])
        nearest = corners_of(np.minimum(means, 255 - means))[:, :, whole]
        gaps.append(nearest.swapaxes(1, 2).astype(np.float64))
        if not number:
            down = rows.start // (SIDE * _BLOCKS_OF_PLACE)
            places = down * picture.used.shape[1] + np.nonzero(whole)[1] // _BLOCKS_OF_PLACE
    return _Band(planes, gaps, places)
