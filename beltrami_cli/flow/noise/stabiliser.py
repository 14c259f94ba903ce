"""Variance stabilisation of colours whose noise depends on the level.

Noise of cameras depends on the level: shot noise grows with light, and the encoding of colours stretches the dark. With
sigma(s) at the level s, the transformation with the derivative 1 / sigma(s) makes it 1 everywhere [1]_. It is scaled to
map 0 and full scale to themselves, which preserves the limits at which noise was clipped.

References
----------
.. [1] M. Makitalo, A. Foi, "Optimal inversion of the generalized Anscombe transformation for Poisson-Gaussian noise",
   IEEE Trans. Image Processing 22(1), 2013. https://doi.org/10.1109/TIP.2012.2202675
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s
from beltrami_cli.flow.noise_amount import COLOURS
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.colour_values import srgb_to_linear

# Number of steps of a transformation table.
_TABLE_STEPS = 1024

# Number of levels at which the noise of a camera is tabulated.
_CAMERA_LEVELS = 65


class VarianceStabiliser:
    """Stabilising transformation for noise of a relative sigma at ascending levels, each of some samples.

    Red, green and blue share it; other channels, which are not levels, are left as they are.
    """

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
