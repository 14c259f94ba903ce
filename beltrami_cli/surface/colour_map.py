"""Values as colours for display."""

from __future__ import annotations

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s, Uint8s
from beltrami_cli.surface.colour_values import LUMINANCE

# The colour map viridis in steps of a tenth: its lightness grows evenly, also for the colour-blind and in grey. S. van
# der Walt, N. Smith, "A better default colormap for matplotlib" (2015), in the public domain (CC0).
VIRIDIS = np.array([
    [0.267, 0.005, 0.329], [0.283, 0.141, 0.458], [0.254, 0.265, 0.530], [0.207, 0.372, 0.553],
    [0.164, 0.471, 0.558], [0.128, 0.567, 0.551], [0.135, 0.659, 0.518], [0.267, 0.749, 0.441],
    [0.478, 0.821, 0.318], [0.741, 0.873, 0.150], [0.993, 0.906, 0.144],
])  # fmt: skip
# Range of greys where there is no value: neither black nor white.
_GREY_FROM, _GREY_TO = 0.35, 0.9


def colour_by_value(values: Float32s, colours: Float32s, known: Bools) -> Float64s:
    """Map values in [0, 1], of any shape, to viridis; where unknown, show the grey of `colours`."""
    at = np.clip(np.where(known, values, 0), 0, 1)
    steps = np.linspace(0, 1, len(VIRIDIS))
    mapped = np.stack([np.interp(at, steps, channel) for channel in VIRIDIS.T], axis=-1)
    grey = _GREY_FROM + (_GREY_TO - _GREY_FROM) * (colours.astype(np.float64) @ LUMINANCE)
    return np.where(known[..., None], mapped, grey[..., None])


def as_bytes(colours: Float64s) -> Uint8s:
    return np.rint(255 * colours).astype(np.uint8)
