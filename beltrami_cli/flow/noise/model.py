"""The noise of colours: an immutable value that kernels, patches and all estimates take."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s
from beltrami_cli.flow.noise.haar_noise import covariance_of_cells, sigma_of_covariances
from beltrami_cli.flow.noise.stabilising import COLOURS, VarianceStabiliser

# Levels of dark, middle and bright colours at which noise is described.
_DESCRIBED_LEVELS = {"dark": 0.1, "middle": 0.5, "bright": 0.9}

# Quantiles of the relative variance at which quiet and loud places are described.
_QUIET, _LOUD = 0.05, 0.95


@dataclass(frozen=True)
class NoiseModel:
    """Noise of colours that a `VarianceStabiliser` has transformed, if its variance depends on the level."""

    sigma: Float64s  # standard deviation by channel, shape (N,)
    covariances: Float64s | None = (
        None  # at each scale, (L, N, N), if neighbouring samples share it, see `haar_noise`
    )
    stabiliser: VarianceStabiliser | None = None
    relative: Float32s | None = (
        None  # variance by that of sigma, a stack of one channel; None: the same everywhere
    )
    doubt: float = 0.0  # mean square error that estimates may lack because of JPEG; infinite if unknown

    @property
    def is_shared(self) -> bool:
        """Whether neighbouring samples share noise."""
        return self.covariances is not None

    @property
    def growth(self) -> float:
        """Root mean square factor from differences of stabilised colours to those of the input."""
        return 1.0 if self.stabiliser is None else self.stabiliser.growth

    @property
    def of_input(self) -> Float64s:
        """Standard deviation of the noise of the input's colours, by channel."""
        sigma = self.sigma.astype(np.float64)
        sigma[:COLOURS] *= self.growth
        return sigma

    @property
    def covariance(self) -> Float64s:
        """Covariance of the noise of single samples, shape (N, N)."""
        if self.covariances is None:
            return np.diag(np.square(self.sigma))
        return covariance_of_cells(self.covariances)

    @property
    def grain(self) -> float:
        """The width, in samples, of the area that samples share noise over; 1: each has its own."""
        if self.covariances is None:
            return 1.0
        # Noise of a filter has its power at the coarsest scale divided by the filter's area.
        single = np.trace(covariance_of_cells(self.covariances))
        return float(np.sqrt(max(1.0, np.trace(self.covariances[-1]) / max(single, 1e-12))))

    def to_input(self, rows: Float32s) -> Float32s:
        """Return stabilised colours, shape (S, N), as colours of the input."""
        if self.stabiliser is None:
            return rows
        rows = rows.copy()
        self.stabiliser.restore(rows.T)
        return rows

    def with_covariances(self, covariances: Float64s) -> NoiseModel:
        return dataclasses.replace(self, sigma=sigma_of_covariances(covariances), covariances=covariances)

    def with_relative(self, relative: Float32s | None) -> NoiseModel:
        return dataclasses.replace(self, relative=relative)

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
                found[name] = self.stabiliser.sigma_at(level, sigma)
        if self.relative is not None:
            mean = float(np.sqrt(np.mean(np.square(self.of_input[:COLOURS]))))
            quiet, loud = np.quantile(self.relative, (_QUIET, _LOUD))
            found |= {"quiet": mean * float(np.sqrt(quiet)), "loud": mean * float(np.sqrt(loud))}
        return {**found, "grain": self.grain}
