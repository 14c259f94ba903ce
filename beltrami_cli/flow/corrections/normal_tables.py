"""Tables of a unit normal variable: censored at a limit, by the share of samples there, and beyond a limit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from statistics import NormalDist
from typing import ClassVar

import numpy as np

from beltrami_cli._native import interpolate
from beltrami_cli.arrays import Float32s, Float64s

# Lengths of the tables: over the share of samples at a limit, up to one half; over limits, for a quarter of their
# range.
_TABLE = 1024


@dataclass(frozen=True)
class CensoredNormal:
    """Statistics of a unit normal variable censored at a limit, by the share of samples at the limit."""

    share: Float64s  # ascending from 0 to 1
    alpha: Float64s  # distance from the mean before censoring to the limit
    gap: Float64s  # distance from the mean after censoring to the limit
    variance: Float64s  # after censoring


@cache
def censored_normal() -> CensoredNormal:
    # SciPy has these functions, but importing it takes longer than smoothing a small mesh.
    normal = NormalDist()
    share = np.linspace(0, 1, 2 * _TABLE - 1)
    # For shares of 0 and 1 alpha is unbounded; the values in the table there do not affect the mean.
    least = share[1] / 100
    inside = np.clip(share, least, 1 - least)
    alpha = -np.array([normal.inv_cdf(part) for part in inside])
    density = np.exp(-(alpha**2) / 2) / np.sqrt(2 * np.pi)
    gap = alpha * (1 - inside) + density
    variance = 1 - inside - alpha * density + alpha**2 * inside - (alpha - gap) ** 2
    variance[[0, -1]] = 1, 0
    return CensoredNormal(share, alpha, gap, variance)


def variance_of_clipped(share: Float64s) -> Float64s:
    """Return the variance of unit noise after clipping, given the share of samples at the limit."""
    table = censored_normal()
    variance: Float64s = np.interp(share, table.share, table.variance)
    return variance


@dataclass(frozen=True)
class NormalTables:
    """Functions of a limit a for a unit normal variable z, at even steps from `-furthest` to `furthest`."""

    furthest: ClassVar[float] = 8.0
    lost: Float32s  # E max(z - a, 0)
    share: Float32s  # P(z > a)
    beyond: Float64s  # E[z | z > a]

    @property
    def limits(self) -> Float64s:
        """The limits a of the table entries."""
        return np.linspace(-self.furthest, self.furthest, len(self.lost))

    def clipping_bias(self, colours: Float32s, sigma: float) -> Float32s:
        """Return the difference between colours and the mean of their noisy values clipped to [0, 1]."""
        low, high = (self._lost_at(gap / np.float32(sigma)) for gap in (colours, 1 - colours))
        return (high - low) * np.float32(sigma)

    def _lost_at(self, a: Float32s) -> Float32s:
        values = np.ravel(a).astype(np.float32)
        interpolate(values, self.limits, self.lost.astype(np.float64))
        return values.reshape(a.shape)


@cache
def normal_tables() -> NormalTables:
    limits = np.linspace(-NormalTables.furthest, NormalTables.furthest, 4 * _TABLE + 1)
    share = np.array([math.erfc(limit / math.sqrt(2)) / 2 for limit in limits])
    density = np.exp(-(limits**2) / 2) / np.sqrt(2 * np.pi)
    lost = density - limits * share
    return NormalTables(lost.astype(np.float32), share.astype(np.float32), density / share)
