"""The noise model: an immutable value that kernels, patches and all estimates take.

Neighbouring samples may share noise. The model therefore has a covariance of the channels for each scale of Haar
details. The Haar transform splits a grid into the details of single cells, of means of 2 x 2 cells, of 4 x 4, and so on
[1]_; on meshes, clusters of about four vertices replace squares. Independent noise has the same variance at all scales.
Noise that was filtered, scaled or compressed has less at the finer scales, and its channels are correlated. Covariances
of N channels have the shape (L, N, N): of the details of single samples, of means of about four, and so on. The last
one holds for all coarser scales. In their units they are equal for independent noise.

Noise of cameras depends on the level: shot noise grows with light, and the encoding of colours stretches the dark. With
sigma(s) at the level s, the transformation with the derivative 1 / sigma(s) makes it 1 everywhere [2]_. It is scaled to
map 0 and full scale to themselves, which preserves the limits at which noise was clipped.

References
----------
.. [1] S. Mallat, "A theory for multiresolution signal decomposition: the wavelet representation", IEEE Trans. Pattern
   Analysis and Machine Intelligence 11(7), 1989, doi:10.1109/34.192463
.. [2] M. Makitalo, A. Foi, "Optimal inversion of the generalized Anscombe transformation for Poisson-Gaussian noise",
   IEEE Trans. Image Processing 22(1), 2013. https://doi.org/10.1109/TIP.2012.2202675
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s
from beltrami_cli.fields import BYTE_STEP
from beltrami_cli.flow.parameters import NEGLIGIBLE, STRENGTHS, VISIBLE
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.colour_values import srgb_to_linear

if TYPE_CHECKING:
    from beltrami_cli.flow.vertex_graph import Level

# Red, green and blue share a curve by level; other channels are not levels.
COLOURS = 3

# Probability of no noise above which colours are not changed, and from which on there is certainly no noise. By
# `noise_model/train_sizes.py`, 0.3 instead of 0.2 gains 0.06 dB on noisy grids of the usual kinds and 0.13 dB on those
# of cameras, and loses 0.04 dB on clean ones.
MAX_NO_NOISE_PROBABILITY, _CERTAINLY_NO_NOISE = 0.3, 0.95

# Ratio of the removed noise to its median. Noisy pictures lost 0.53 dB against a known noise, and 0.72 dB with a
# factor of 1, by benchmarks/bench_regret.py: underestimated noise is kept as edges.
_REMOVED_PER_MEDIAN = 1.1

# Beta times sigma: the distance of colours at which the first kernel should decay, in units of the noise. A search over
# vertex colours and textures at sigma 20 of 255, with t = 2.4, a growth of 2, two regularised and three plain
# iterations, has its flat optimum here.
_BETA_SIGMA = 0.8

# Levels of dark, middle and bright colours at which noise is described.
_DESCRIBED_LEVELS = {"dark": 0.1, "middle": 0.5, "bright": 0.9}

# Quantiles of the relative variance at which quiet and loud places are described.
_QUIET_QUANTILE, _LOUD_QUANTILE = 0.05, 0.95

# Number of steps of a transformation table.
_TABLE_STEPS = 1024

# Number of levels at which the noise of a camera is tabulated.
_CAMERA_LEVELS = 65

# Minimum relative standard deviation of samples, as a divisor of colours.
_MIN_RELATIVE_SIGMA = 0.05

# Rows processed at a time where each needs temporary memory.
_BLOCK_ROWS = 64


@dataclass(frozen=True)
class Reading:
    """The estimated size of the noise: root mean square over the colours."""

    none: float  # probability that there is no noise
    # Given that there is noise: its 5 % quantile, median, and 95 % quantile.
    low: float
    median: float
    high: float

    @property
    def is_likely(self) -> bool:
        """Whether there is noise to remove, given the harm to clean colours."""
        return self.none <= MAX_NO_NOISE_PROBABILITY

    def assumed(self, strength: float) -> float:
        """Return the size to remove: the lower end of the interval if gentle, the upper end if strong.

        It is 0 where no noise is likely enough, unless the strength is high.
        """
        low, median = (self.low, _REMOVED_PER_MEDIAN * self.median) if self.is_likely else (0.0, 0.0)
        # No noise counts as 0, so that the upper end may be 0.
        high = max(median, self.high) if self.none < _CERTAINLY_NO_NOISE else 0.0
        return float(np.interp(strength, tuple(STRENGTHS.values()), (low, median, high)))

    @property
    def is_doubtful(self) -> bool:
        """Whether there may be no noise."""
        return self.none > NEGLIGIBLE

    @property
    def visible(self) -> float:
        """Probability of visible noise."""
        places = np.log(np.maximum((self.low, self.median, self.high), 1e-9))
        return (1 - self.none) * float(np.interp(math.log(VISIBLE), places, (0.95, 0.5, 0.05)))


@dataclass(frozen=True)
class NoiseModel:
    """Noise of N channels; of stabilised colours, if the variance depends on the level (`VarianceStabiliser`).

    Neighbouring samples share noise if there are covariances of several scales.
    """

    covariances: Float64s  # at each scale, shape (L, N, N)
    stabiliser: VarianceStabiliser | None = None
    relative: Float32s | None = (
        None  # variance by its mean, a stack of one channel; None: the same everywhere
    )
    reading: Reading | None = None  # None: the noise is given

    @classmethod
    def independent(cls, sigma: Float64s) -> NoiseModel:
        """Return the model of noise that is independent between samples and channels, given sigma by channel."""
        return cls(np.diag(np.square(sigma))[None])

    @property
    def sigma(self) -> Float64s:
        """Standard deviation by channel, shape (N,)."""
        return sigma_of_covariances(self.covariances)

    @property
    def largest_sigma(self) -> Float64s:
        """Upper bound of sigma by channel with a certainty of 95 %, shape (N,)."""
        if self.reading is None or not self.overall:
            return self.sigma
        return self.sigma * max(1.0, self.reading.high / self.overall)

    @property
    def covariance(self) -> Float64s:
        """Covariance of the noise of single samples, shape (N, N)."""
        return covariance_of_cells(self.covariances)

    @property
    def is_shared(self) -> bool:
        """Whether neighbouring samples share noise."""
        return len(self.covariances) > 1

    @property
    def is_independent(self) -> bool:
        """Whether neither neighbouring samples nor channels share noise."""
        only = self.covariances[0]
        return not self.is_shared and not (only - np.diag(np.diag(only))).any()

    @property
    def _growth(self) -> float:
        """RMS factor from differences of stabilised colours to differences of the input's colours."""
        return 1.0 if self.stabiliser is None else self.stabiliser.growth

    @property
    def of_input(self) -> Float64s:
        """Standard deviation of the noise in the input's colours, by channel."""
        sigma = self.sigma
        sigma[:COLOURS] *= self._growth
        return sigma

    @property
    def overall(self) -> float:
        """RMS noise of the input's colours."""
        colours = self.of_input[:COLOURS]
        return float(np.sqrt(np.mean(np.square(colours)))) if len(colours) else 0.0

    @property
    def grain(self) -> float:
        """Width in samples of the area over which noise is shared; 1: independent samples."""
        # Filtered noise has a power at the coarsest scale that is divided by the filter's area.
        single = np.trace(self.covariance)
        return float(np.sqrt(max(1.0, np.trace(self.covariances[-1]) / max(single, 1e-12))))

    def difference_to_input(self, size: float) -> float:
        """Convert an RMS difference of stabilised colours to the input's colours."""
        return self._growth * size

    def square_to_input(self, square: float) -> float:
        """Convert a mean square of differences of stabilised colours to the input's colours."""
        return self._growth**2 * square

    def beta_to_input(self, beta: float) -> float:
        """Convert beta, a length per unit of stabilised colours, to the input's colours; lengths are preserved."""
        return beta / self._growth

    def to_input(self, rows: Float32s) -> Float32s:
        """Convert stabilised colours, shape (S, N), to colours of the input."""
        if self.stabiliser is None:
            return rows
        rows = rows.copy()
        self.stabiliser.restore_in_place(rows.T)
        return rows

    def scaled_to(self, sigma: float) -> NoiseModel:
        """Return a model with the same structure and an RMS noise of the colours of `sigma`.

        Without noise, samples and channels get independent noise.
        """
        covariances = self.covariances.copy()
        colours = covariances[:, :COLOURS, :COLOURS]
        if self.overall:
            colours *= (sigma / self.overall) ** 2
        else:
            colours[:] = np.square(sigma / self._growth) * np.eye(colours.shape[1])
        return dataclasses.replace(self, covariances=covariances)

    def as_read(self) -> NoiseModel:
        """Return the model with the median size; the removed noise differs from it by the strength."""
        if self.reading is None or not self.reading.is_likely:
            return self
        return self.scaled_to(self.reading.median)

    def described(self) -> dict[str, float]:
        """Describe the noise: mean sigma of the colour channels, of full scale 1, and the grain.

        "dark", "middle" and "bright": sigma at these levels; "quiet" and "loud": sigma at places, if they differ.
        """
        found: dict[str, float] = {}
        if not len(self.sigma):
            return found
        sigma = float(np.sqrt(np.mean(np.square(self.sigma[:COLOURS]))))
        if self.stabiliser is not None:
            for name, level in _DESCRIBED_LEVELS.items():
                found[name] = float(self.stabiliser.sigma_at(level, sigma))
        if self.relative is not None:
            quiet, loud = np.quantile(self.relative, (_QUIET_QUANTILE, _LOUD_QUANTILE))
            found |= {
                "quiet": self.overall * float(np.sqrt(quiet)),
                "loud": self.overall * float(np.sqrt(loud)),
            }
        return {**found, "grain": self.grain}


class VarianceStabiliser:
    """Stabilising transformation for noise of a relative sigma at ascending levels, each of some samples."""

    def __init__(
        self, levels: Float64s, relative: Float64s, samples: Float64s, full_scale: float = 1.0
    ) -> None:
        self._levels = np.linspace(0, full_scale, _TABLE_STEPS + 1)
        inverse = 1 / np.interp(self._levels, levels, relative)
        steps = (inverse[1:] + inverse[:-1]) / (2 * _TABLE_STEPS)
        self.scale = 1 / float(steps.sum())
        """Standard deviation of stabilised noise whose relative standard deviation is 1."""
        self._stable = np.append(0, np.cumsum(steps)) * (self.scale * full_scale)
        self._stable[-1] = full_scale
        self.growth = float(np.sqrt(np.average(np.square(relative / self.scale), weights=samples)))
        """Root mean square factor by which small differences grow when they are transformed back."""

    @classmethod
    def of_camera(cls, shot: float, read: float) -> VarianceStabiliser:
        """Make the transformation for shot and read noise of a camera, in sRGB colours."""
        levels = np.linspace(0, 1, _CAMERA_LEVELS) ** 2  # denser where the sRGB curve is steep
        light = srgb_to_linear(levels).astype(np.float64)
        slopes = np.maximum(np.gradient(light, levels), 1 / 12.92)
        sigma = np.sqrt(shot * light + read**2) / slopes
        return cls(levels, np.maximum(sigma, sigma.max() / 1000), np.ones(len(sigma)))

    @cached_property
    def _slopes(self) -> Float64s:
        return np.diff(self._levels) / np.diff(self._stable)

    def stabilised(self, channels: Float32s) -> Float32s:
        """Return transformed channels, which are along the first axis."""
        stable = large_arrays.copy_of(channels)
        self.stabilise_in_place(stable)
        return stable

    def stabilise_in_place(self, channels: Float32s) -> None:
        """Transform channels along the first axis."""
        self._each(channels, self._levels, self._stable)

    def restore_in_place(self, channels: Float32s) -> None:
        """Apply the inverse transformation."""
        self._each(channels, self._stable, self._levels)

    def slopes(self, channels: Float32s) -> Float32s:
        """Return the derivative of the inverse transformation at stabilised channels."""
        factors = np.ones_like(channels)
        for own, plane in zip(factors, channels[:COLOURS], strict=False):
            own[:] = np.interp(plane, (self._stable[1:] + self._stable[:-1]) / 2, self._slopes)
        return factors

    def sigma_at(self, level: Array | float, sigma: float) -> Float64s:
        """Return sigma at levels of colour, given that of stabilised colours."""
        slopes = np.interp(level, (self._levels[1:] + self._levels[:-1]) / 2, self._slopes)
        return np.asarray(sigma * slopes, np.float64)

    def _each(self, channels: Float32s, before: Float64s, after: Float64s) -> None:
        first, last = (
            (after[at] - after[at - 1]) / (before[at] - before[at - 1]) for at in (1, len(before) - 1)
        )
        rows = max(1, large_arrays.BLOCK // max(1, int(np.prod(channels.shape[2:]))))
        for block in large_arrays.blocks(channels.shape[1], rows):
            for plane in channels[:COLOURS, block]:
                within = np.interp(plane, before, after)
                # Extrapolate with the slopes at the limits.
                within += np.minimum(plane, 0) * first + np.maximum(plane - before[-1], 0) * last
                plane[...] = within


def relative_to_mean(deviations: Float32s) -> tuple[Float32s, Float64s]:
    """Split deviations, shape (S, K), into variances relative to their mean, shape (S, 1), and sigma by channel."""
    variances = np.square(deviations, dtype=np.float64)
    sigma = np.sqrt(variances.mean(axis=0))
    mean = np.mean(np.square(sigma))
    if not mean > 0:
        return np.ones((len(deviations), 1), np.float32), sigma
    relative = np.maximum(variances.mean(axis=1, keepdims=True) / mean, _MIN_RELATIVE_SIGMA**2)
    return relative.astype(np.float32), sigma


def choose_beta(sigma: Float64s, contrast: float = _BETA_SIGMA) -> float:
    """Choose beta, in spacings per unit of colour, so that noise has a length of `contrast` spacings."""
    # Standard deviation of rounding to 8 bits; less noise cannot be measured.
    rounding = BYTE_STEP / math.sqrt(12)
    return contrast / max(overall_noise(sigma), rounding)


def overall_noise(sigma: Float64s) -> float:
    """Return the RMS noise of the channels that have any; others may be constant alpha."""
    noisy = sigma[sigma > 0.1 * sigma.max()] if len(sigma) else sigma
    return float(np.sqrt(np.mean(np.square(noisy)))) if len(noisy) else 0.0


def covariance_of_cells(covariances: Float64s) -> Float64s:
    """Return the covariance of single cells' noise, shape (N, N), from that of each scale, shape (L, N, N)."""
    # Three quarters of independent noise are in details, and one quarter in the means of 2 x 2 cells.
    shares = 3 / 4.0 ** np.arange(1, len(covariances) + 1)
    shares[-1] += 1 / 4.0 ** len(covariances)
    total: Float64s = np.einsum("l,lij->ij", shares, covariances)
    return total


def sigma_of_covariances(covariances: Float64s) -> Float64s:
    """Return sigma of single cells' noise, per channel, from covariances of shape (L, N, N)."""
    return np.sqrt(np.maximum(np.diag(covariance_of_cells(covariances)), 0))


def draw_model(covariances: Float64s, shape: tuple[int, int], random: np.random.Generator) -> Float32s:
    """Draw noise, shape (N, *shape), of the given covariances of Haar details, shape (L, N, N)."""
    levels = len(covariances)
    noise = mixed_signs(covariances[-1], [-(-size // 2**levels) for size in shape], random)
    noise /= np.float32(2**levels)
    for level in reversed(range(levels)):
        details = [mixed_signs(covariances[level], noise.shape[1:], random) for _ in range(3)]
        noise = _with_details(noise, details, np.float32(2 ** (level + 1)))
    if noise.shape[1:] == shape:
        return noise
    cropped: Float32s = large_arrays.empty((len(noise), *shape), np.float32)
    for rows in large_arrays.blocks(shape[0], _BLOCK_ROWS):
        cropped[:, rows] = noise[:, rows, : shape[1]]
    return cropped


def _with_details(noise: Float32s, details: list[Float32s], size: np.float32) -> Float32s:
    """Upsample noise to twice as many rows and columns, and add details divided by `size`."""
    channels, rows, columns = noise.shape
    finer: Float32s = large_arrays.empty((channels, 2 * rows, 2 * columns), np.float32)
    cells = finer.reshape(channels, rows, 2, columns, 2)
    for block in large_arrays.blocks(rows, _BLOCK_ROWS):
        own = noise[:, block]
        across, down, both = (detail[:, block] / size for detail in details)
        cells[:, block, 0, :, 0] = own + across + down + both
        cells[:, block, 0, :, 1] = own - across + down - both
        cells[:, block, 1, :, 0] = own + across - down - both
        cells[:, block, 1, :, 1] = own - across - down + both
    return finer


def mixed_signs(covariance: Float64s, shape: Sequence[int], random: np.random.Generator) -> Float32s:
    """Draw white noise with a covariance of the channels, shape (N, *shape)."""
    root = root_of(covariance)
    signs = large_arrays.random_signs((len(root), *shape), random)
    mixed: Float32s = large_arrays.empty(signs.shape, np.float32)
    for rows in large_arrays.blocks(shape[0], _BLOCK_ROWS):
        # Not with BLAS, whose idle threads keep spinning.
        mixed[:, rows] = np.einsum("ij,jrc->irc", root, signs[:, rows].astype(np.float32))
    return mixed


def root_of(covariance: Float64s) -> Float32s:
    """Return the symmetric square root of a covariance."""
    values, vectors = np.linalg.eigh(covariance)
    root: Float32s = ((vectors * np.sqrt(np.maximum(values, 0))) @ vectors.T).astype(np.float32)
    return root


def draw_noise_of_clusters(covariances: Float64s, levels: Sequence[Level], signs: Float32s) -> Float32s:
    """Draw the noise on clusters instead, from independent signs of samples for each level."""
    noise: Float32s = np.zeros(signs.shape[1:], np.float32)
    for number, (level, own) in enumerate(zip(levels, signs, strict=True)):
        root = root_of(covariances[min(number, len(covariances) - 1)])
        drawn = np.einsum("ij,sj->si", root, own[level.centres]) / np.sqrt(level.counts)[:, None]
        if number + 1 < len(levels):  # details: differences from the mean of the next level
            above, held = levels[number + 1], drawn * level.counts[:, None]
            parents = above.members[level.centres]
            sums = np.stack([np.bincount(parents, column, above.graph.size) for column in held.T], axis=1)
            drawn -= (sums / above.counts[:, None])[parents].astype(np.float32)
        noise += drawn[level.members]
    return noise
