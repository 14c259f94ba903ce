"""An upper bound of noise from the quietest squares, which needs no place without texture.

Whatever is painted, a square of samples is no more likely to look even with it than by its noise alone: for normal
noise n, any t, and any convex set C that is symmetric about 0, P(n + t in C) <= P(n in C) [1]_. So a low quantile of
the energies of squares is at least that of noise. Stripes, checks and fabrics have no even tile, but squares within one
colour, so that the bound is close to their noise.

References
----------
.. [1] T. W. Anderson, "The integral of a symmetric unimodal function over a symmetric convex set and some probability
   inequalities", Proc. Amer. Math. Soc. 6 (1955), 170-176, doi:10.1090/S0002-9939-1955-0069229-1
"""

from __future__ import annotations

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float64s
from beltrami_cli.flow.noise.flat_patch_noise import quantile

# The quantile, and that of the chi-square distribution with three degrees of freedom, over these; and how many squares
# are needed, of which fifty are below it: the root of what they show is known within 5 %.
_QUANTILE, _OF_NOISE, _ENOUGH = 0.05, 0.351846 / 3, 1000

# Whatever is painted, normal noise has this share of the energy at a lower quantile, or more; what JPEG left has less.
_LOWER, _LEAST_BELOW = 0.01, 0.24

# How far noise may exceed the bound that differs by level or place: noise of cameras, enlarged noise and grain on
# photographs do by up to 1.25, and stripes are read as 1.7 to 5 times as much.
_SLACK = 1.6

# Rounding to 8 bit is not normal: no bound is less.
_LEAST = 2 / 255

# Squares without any details hold no noise.
_PLAIN = 1e-9


def most_noise(details: Array, usable: Bools) -> Float64s:
    """Return sigma at most, by channel, shape (K,); infinite where that is not known.

    `details`: mean squares of the three details of squares, shape (K, R, C).
    """
    most = np.full(len(details), np.inf)
    used = usable & (details.max(axis=0) > _PLAIN)
    if np.count_nonzero(used) < _ENOUGH:
        return most
    for number, own in enumerate(details):
        energies = own[used].astype(np.float64)
        lower, quiet = quantile(energies, _LOWER), quantile(energies, _QUANTILE)
        if lower > _LEAST_BELOW * quiet:
            most[number] = max(_SLACK * np.sqrt(quiet / _OF_NOISE), _LEAST)
    return most
