"""The noise of colours: an immutable value that kernels, patches and all estimates take.

Noise of cameras depends on the level: shot noise grows with light, and the encoding of colours stretches the dark. With
sigma(s) at the level s, the transformation with the derivative 1 / sigma(s) makes it 1 everywhere [1]_. It is scaled so
that 0 and full scale stay, and limits at which noise was cut off keep their places.

References
----------
.. [1] M. Makitalo, A. Foi, "Optimal inversion of the generalized Anscombe transformation for Poisson-Gaussian noise",
   IEEE Trans. Image Processing 22(1), 2013. https://doi.org/10.1109/TIP.2012.2202675
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s
from beltrami_cli.flow.noise.haar_noise import covariance_of_cells, sigma_of_covariances
from beltrami_cli.surface import large_arrays

# Colours of red, green and blue share a curve by their level; other channels are no levels.
COLOURS = 3

# Levels of dark, middle and bright colours at which noise is described.
_DESCRIBED_LEVELS = {"dark": 0.1, "middle": 0.5, "bright": 0.9}

# Quantiles of the relative variance at which quiet and loud places are described.
_QUIET, _LOUD = 0.05, 0.95

# Steps of the table of a transformation.
_STEPS = 1024


class VarianceStabiliser:
    """The transformation for noise of a relative standard deviation at ascending levels, each of some samples."""

    def __init__(
        self, levels: Float64s, relative: Float64s, samples: Float64s, full_scale: float = 1.0
    ) -> None:
        self._levels = np.linspace(0, full_scale, _STEPS + 1)
        inverse = 1 / np.interp(self._levels, levels, relative)
        steps = (inverse[1:] + inverse[:-1]) / (2 * _STEPS)
        self.scale = 1 / float(steps.sum())
        """Standard deviation of stabilised noise whose relative standard deviation is 1."""
        self._stable = np.append(0, np.cumsum(steps)) * (self.scale * full_scale)
        self._stable[-1] = full_scale
        self.growth = float(np.sqrt(np.average(np.square(relative / self.scale), weights=samples)))
        """Root mean square factor by which small differences grow when they are transformed back."""

    @cached_property
    def _slopes(self) -> Float64s:
        return np.diff(self._levels) / np.diff(self._stable)

    def stabilise(self, channels: Float32s) -> None:
        """Transform channels, the first axis, in place."""
        self._each(channels, self._levels, self._stable)

    def restore(self, channels: Float32s) -> None:
        """Transform them back, in place."""
        self._each(channels, self._stable, self._levels)

    def slopes(self, channels: Float32s) -> Float32s:
        """Return by what factor small differences of stabilised channels grow when they are transformed back."""
        factors = np.ones_like(channels)
        for own, plane in zip(factors, channels[:COLOURS], strict=False):
            own[:] = np.interp(plane, (self._stable[1:] + self._stable[:-1]) / 2, self._slopes)
        return factors

    def sigma_at(self, level: Array | float, sigma: float) -> Float64s:
        """Return the standard deviation at levels of colour, by that of stabilised colours."""
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
                # Colours beyond the limits go on with the slopes there.
                within += np.minimum(plane, 0) * first + np.maximum(plane - before[-1], 0) * last
                plane[...] = within


@dataclass(frozen=True)
class NoiseModel:
    """Noise of N channels of colours that a `VarianceStabiliser` has transformed, if its variance depends on the level.

    Neighbouring samples share noise if there are covariances of several scales, see `haar_noise`.
    """

    covariances: Float64s  # at each scale, shape (L, N, N)
    stabiliser: VarianceStabiliser | None = None
    relative: Float32s | None = (
        None  # variance by its mean, a stack of one channel; None: the same everywhere
    )
    interval: tuple[float, float] | None = None  # 90 % interval of `overall`; None: it is given

    @classmethod
    def independent(cls, sigma: Float64s) -> NoiseModel:
        """Return the model of noise that neither samples nor channels share, of standard deviations by channel."""
        return cls(np.diag(np.square(sigma))[None])

    @property
    def sigma(self) -> Float64s:
        """Standard deviation by channel, shape (N,)."""
        return sigma_of_covariances(self.covariances)

    @property
    def largest_sigma(self) -> Float64s:
        """Standard deviation by channel that the noise may have with a certainty of 95 %, shape (N,)."""
        if self.interval is None or not self.overall:
            return self.sigma
        return self.sigma * (self.interval[1] / self.overall)

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
    def growth(self) -> float:
        """Root mean square factor from differences of stabilised colours to those of the input."""
        return 1.0 if self.stabiliser is None else self.stabiliser.growth

    @property
    def of_input(self) -> Float64s:
        """Standard deviation of the noise of the input's colours, by channel."""
        sigma = self.sigma
        sigma[:COLOURS] *= self.growth
        return sigma

    @property
    def overall(self) -> float:
        """Root mean square of the noise of the input's colours."""
        colours = self.of_input[:COLOURS]
        return float(np.sqrt(np.mean(np.square(colours)))) if len(colours) else 0.0

    @property
    def doubt(self) -> tuple[float, float]:
        """Mean squares that the noise may have more than the model, and less, with a certainty of 90 %."""
        if self.interval is None:
            return 0.0, 0.0
        low, high = self.interval
        return max(0.0, high**2 - self.overall**2), max(0.0, self.overall**2 - low**2)

    @property
    def grain(self) -> float:
        """The width, in samples, of the area that samples share noise over; 1: each has its own."""
        # Noise of a filter has its power at the coarsest scale divided by the filter's area.
        single = np.trace(self.covariance)
        return float(np.sqrt(max(1.0, np.trace(self.covariances[-1]) / max(single, 1e-12))))

    def to_input(self, rows: Float32s) -> Float32s:
        """Return stabilised colours, shape (S, N), as colours of the input."""
        if self.stabiliser is None:
            return rows
        rows = rows.copy()
        self.stabiliser.restore(rows.T)
        return rows

    def scaled_to(self, sigma: float) -> NoiseModel:
        """Return a model of the same structure whose colours have a root mean square noise of `sigma`.

        Where there is no noise, samples and channels get independent noise.
        """
        covariances = self.covariances.copy()
        colours = covariances[:, :COLOURS, :COLOURS]
        if self.overall:
            colours *= (sigma / self.overall) ** 2
        else:
            colours[:] = np.square(sigma / self.growth) * np.eye(colours.shape[1])
        return dataclasses.replace(self, covariances=covariances, interval=None)

    def described(self) -> dict[str, float]:
        """Return standard deviations, the mean of colour channels, of full scale 1, and the grain.

        "dark", "middle" and "bright" are deviations at these levels, "quiet" and "loud" at places that differ.
        """
        found: dict[str, float] = {}
        if not len(self.sigma):
            return found
        sigma = float(np.sqrt(np.mean(np.square(self.sigma[:COLOURS]))))
        if self.stabiliser is not None:
            for name, level in _DESCRIBED_LEVELS.items():
                found[name] = float(self.stabiliser.sigma_at(level, sigma))
        if self.relative is not None:
            quiet, loud = np.quantile(self.relative, (_QUIET, _LOUD))
            found |= {
                "quiet": self.overall * float(np.sqrt(quiet)),
                "loud": self.overall * float(np.sqrt(loud)),
            }
        return {**found, "grain": self.grain}
