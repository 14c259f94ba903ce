"""The noise model: an immutable value that kernels, patches and all estimates take.

Neighbouring samples may share noise. The model therefore has a covariance of the channels for each scale of Haar
details. The Haar transform splits a grid into the details of single cells, of means of 2 x 2 cells, of 4 x 4, and so on
[1]_; on meshes, clusters of about four vertices replace squares. Independent noise has the same variance at all scales.
Noise that was filtered, scaled or compressed has less at the finer scales, and its channels are correlated. Covariances
of N channels have the shape (L, N, N): of the details of single samples, of means of about four, and so on. The last
one holds for all coarser scales. In their units they are equal for independent noise.

References
----------
.. [1] S. Mallat, "A theory for multiresolution signal decomposition: the wavelet representation", IEEE Trans. Pattern
   Analysis and Machine Intelligence 11(7), 1989, doi:10.1109/34.192463
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s
from beltrami_cli.flow.noise.components import covariance_of_cells, sigma_of_covariances
from beltrami_cli.flow.noise.stabiliser import VarianceStabiliser
from beltrami_cli.flow.noise_amount import COLOURS, NEGLIGIBLE, VISIBLE
from beltrami_cli.flow.parameters import STRENGTHS

# Probability of no noise above which colours are not changed, and from which on there is certainly no noise. By
# `noise_model/train_sizes.py`, 0.3 instead of 0.2 gains 0.06 dB on noisy grids of the usual kinds and 0.13 dB on those
# of cameras, and loses 0.04 dB on clean ones.
MAX_NO_NOISE_PROBABILITY, _CERTAINLY_NO_NOISE = 0.3, 0.95

# Ratio of the removed noise to its median. Noisy images lost 0.53 dB against a known noise, and 0.72 dB with a
# factor of 1, by benchmarks/bench_regret.py: underestimated noise is kept as edges.
_REMOVED_PER_MEDIAN = 1.1

# Levels of dark, middle and bright colours at which noise is described.
_DESCRIBED_LEVELS = {"dark": 0.1, "middle": 0.5, "bright": 0.9}

# Quantiles of the relative variance at which quiet and loud places are described.
_QUIET_QUANTILE, _LOUD_QUANTILE = 0.05, 0.95


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
        logs = np.log(np.maximum((self.low, self.median, self.high), 1e-9))
        return (1 - self.none) * float(np.interp(math.log(VISIBLE), logs, (0.95, 0.5, 0.05)))


@dataclass(frozen=True)
class NoiseModel:
    """Noise of N channels; of stabilised colours, if the variance depends on the level (`VarianceStabiliser`).

    Neighbouring samples share noise if there are covariances of several scales.
    """

    covariances: Float64s  # at each scale, shape (L, N, N)
    stabiliser: VarianceStabiliser | None = None
    # Variance of each sample by its mean, a stack of one channel; None: the same everywhere.
    relative: Float32s | None = None
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
    def rms_sigma(self) -> float:
        """Standard deviation of all channels together."""
        return float(np.sqrt(np.mean(np.square(self.sigma))))

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
        facts: dict[str, float] = {}
        if not len(self.sigma):
            return facts
        sigma = float(np.sqrt(np.mean(np.square(self.sigma[:COLOURS]))))
        if self.stabiliser is not None:
            for name, level in _DESCRIBED_LEVELS.items():
                facts[name] = float(self.stabiliser.sigma_at(level, sigma))
        if self.relative is not None:
            quiet, loud = np.quantile(self.relative, (_QUIET_QUANTILE, _LOUD_QUANTILE))
            facts |= {
                "quiet": self.overall * float(np.sqrt(quiet)),
                "loud": self.overall * float(np.sqrt(loud)),
            }
        return {**facts, "grain": self.grain}


def scaled_description(described: Mapping[str, float], factor: float) -> dict[str, float]:
    """Multiply all sigmas of `NoiseModel.described` by a factor; the grain is in samples, and stays."""
    return {name: value if name == "grain" else factor * value for name, value in described.items()}
