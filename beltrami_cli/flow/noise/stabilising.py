"""Colours in which noise has the same standard deviation at every level.

Noise of cameras depends on the level: shot noise grows with light, and the encoding of colours stretches the dark. With
sigma(s) at the level s, the transformation with the derivative 1 / sigma(s) makes it 1 everywhere [1]_. It is scaled so
that 0 and full scale stay, and limits at which noise was cut off keep their places.

References
----------
.. [1] M. Makitalo, A. Foi, "Optimal inversion of the generalized Anscombe transformation for Poisson-Gaussian noise",
   IEEE Trans. Image Processing 22(1), 2013. https://doi.org/10.1109/TIP.2012.2202675
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s

# Colours of red, green and blue share the curve; other channels are no levels.
COLOURS = 3

# Steps of the table.
_STEPS = 1024


class VarianceStabiliser:
    """The transformation for noise of a relative standard deviation at ascending levels, each of some samples."""

    def __init__(self, levels: Float64s, relative: Float64s, samples: Float64s) -> None:
        self._levels = np.linspace(0, 1, _STEPS + 1)
        inverse = 1 / np.interp(self._levels, levels, relative)
        steps = (inverse[1:] + inverse[:-1]) / (2 * _STEPS)
        self.scale = 1 / float(steps.sum())
        """Standard deviation of stabilised noise whose relative standard deviation is 1."""
        self._stable = np.append(0, np.cumsum(steps)) * self.scale
        self._stable[-1] = 1
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
        for own, plane in zip(factors, channels[: _count(channels)], strict=False):
            own[:] = np.interp(plane, (self._stable[1:] + self._stable[:-1]) / 2, self._slopes)
        return factors

    def sigma_at(self, level: float, sigma: float) -> float:
        """Return the standard deviation at a level of colour, by that of stabilised colours."""
        return sigma * float(np.interp(level, (self._levels[1:] + self._levels[:-1]) / 2, self._slopes))

    def _each(self, channels: Float32s, before: Float64s, after: Float64s) -> None:
        first, last = (
            (after[at] - after[at - 1]) / (before[at] - before[at - 1]) for at in (1, len(before) - 1)
        )
        for plane in channels[: _count(channels)]:
            within = np.interp(plane, before, after)
            # Colours beyond the limits go on with the slopes there.
            within += np.minimum(plane, 0) * first + np.maximum(plane - 1, 0) * last
            plane[...] = within


def _count(channels: Float32s) -> int:
    """Return how many of the channels are colours."""
    return min(COLOURS, len(channels))
