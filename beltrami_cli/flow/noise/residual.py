"""The residual of a pilot, which shows the noise where the pilot is even.

A pilot, an edge-preserving mean of few neighbours, removes noise of a known size. It is even at levels and places that
are not mixed by noise, and keeps most of the texture.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int64s
from beltrami_cli.flow.noise.components import symmetric
from beltrami_cli.flow.noise.neighbourhoods import ThreeChannels, ranks_within
from beltrami_cli.flow.noise.stabiliser import VarianceStabiliser

# Ratio of the noise that the pilot assumes to the noise. From 1.5 on it removes nine tenths of white noise.
_ASSUMED_NOISE = 1.5

# Share of the most even blocks of a level or neighbourhood, and of the most even cells.
_EVEN_SHARE = 0.5

# Maximum share of clipped samples in a block whose noise is measured.
_MAX_CLIPPED_IN_BLOCK = 0.05

# Exponent of the share of energy in quiet tiles or even cells that is trusted as noise. With 1, texture is taken for
# white noise, which costs 0.2 dB of PSNR.
_TRUST_EXPONENT = 3

# Relative variance below which a neighbourhood is quiet, and its residual mostly texture.
_MAX_QUIET_VARIANCE = 0.25


@dataclass(frozen=True, eq=False)
class Blocks:
    """Up to m blocks of about sixteen samples in each of P neighbourhoods; unknown values are infinite."""

    levels: Float32s  # of the pilot by channel, in steps of 8 bits, shape (3, P, m)
    energies: Float32s  # mean squares of the residual's details by channel, shape (3, P, m)
    unevenness: Float32s  # of the pilot, shape (P, m)

    @property
    def is_known(self) -> Bools:
        """Mask of existing blocks, shape (P, m)."""
        return np.isfinite(self.unevenness)

    def most_even(self, groups: Int64s) -> Bools:
        """Mark the most even known blocks of each group, given the group of each known block."""
        ranks = ranks_within(groups, np.lexsort((self.unevenness[self.is_known], groups)))
        return np.asarray(ranks < np.ceil(_EVEN_SHARE * np.bincount(groups))[groups])


@dataclass(frozen=True, eq=False)
class Residual:
    """The difference between channels and their pilot."""

    channels: ThreeChannels
    pilot: ThreeChannels

    @classmethod
    def of(cls, channels: ThreeChannels, variances: Float32s) -> Residual:
        """Compute the pilot that removes noise of some variances, in squared steps of 8 bits."""
        colours = channels.neighbourhoods.pilot(channels.colours, np.float32(_ASSUMED_NOISE**2) * variances)
        return cls(channels, dataclasses.replace(channels, colours=colours))

    @cached_property
    def removed(self) -> ThreeChannels:
        return dataclasses.replace(self.channels, colours=self.channels.colours - self.pilot.colours)

    @property
    def correlation_of_neighbours(self) -> float:
        """Correlation of the residual between neighbouring samples; near 0 for white noise."""
        removed = self.removed.colours
        variance = float(np.mean(np.square(removed, dtype=np.float64)))
        return self.channels.neighbourhoods.product_of_neighbours(removed) / max(1e-9, variance)

    def stabilised(self, stabiliser: VarianceStabiliser, step: float) -> Residual:
        """Return the residual of stabilised colours; `step`: a step of 8 bits, of the stabiliser's full scale."""
        parts = []
        for part in (self.channels, self.pilot):
            colours = part.colours * np.float32(step)
            stabiliser.stabilise_in_place(colours)
            parts.append(dataclasses.replace(part, colours=colours / np.float32(step)))
        return Residual(*parts)

    def blocks(self) -> Blocks:
        fine, coarse, *above = self.channels.scales[:4]
        freedom = coarse.freedom + coarse.sums(fine.freedom)
        energies = coarse.sums(fine.sums(_squares_in_blocks(self.removed))) / np.maximum(freedom, 1)
        within = coarse.sums(fine.sums(_squares_in_blocks(self.pilot).sum(axis=0))) / np.maximum(freedom, 1)
        around = _energies(self.pilot, 2) + above[1].spread(_energies(self.pilot, 3))
        uneven = within + above[0].spread(around) / 2
        clipped = coarse.means(fine.means(self.channels.is_clipped.max(axis=0).astype(np.float64)))
        used = coarse.is_whole & (freedom > 2) & (clipped <= _MAX_CLIPPED_IN_BLOCK)
        return Blocks(
            coarse.padded(self.pilot.means[2], np.inf),
            coarse.padded(energies, np.inf),
            coarse.padded(np.where(used, uneven, np.inf), np.inf),
        )

    def even_covariance(self, variances: Float64s) -> Float64s:
        """Return the covariance of components of single samples in even cells, shape (3, 3), in squared steps.

        It is divided by the relative variance of each neighbourhood, shape (P,). Quiet neighbourhoods are ignored.
        """
        finest = self.channels.scales[0]
        unevenness = self.pilot.unevenness(0) + self.pilot.products[0][:3].sum(axis=0)
        uneven = finest.padded(np.where(finest.is_whole & (finest.freedom > 0), unevenness, np.inf), np.inf)
        known = np.isfinite(uneven) & (variances > _MAX_QUIET_VARIANCE)[:, None]
        energies = finest.padded(self.channels.products[0][:3].sum(axis=0))
        if not known.any() or np.median(energies[known]) == 0:  # most cells are constant: no noise
            return np.zeros((3, 3))
        relative = uneven / variances[:, None]
        even = known & (relative <= np.quantile(relative[known], _EVEN_SHARE))
        weights = finest.padded(finest.freedom) * even
        products = finest.padded(self.removed.products[0]) / variances[:, None].astype(np.float32)
        total = max(1.0, weights.sum())
        return symmetric(np.einsum("kpn,pn->k", products, weights, dtype=np.float64) / total)


def _squares_in_blocks(channels: ThreeChannels) -> Array:
    """Return the squared differences of samples from the means of their blocks, shape (3, n).

    In each block they have the same sum as the squared details of the finest two scales.
    """
    fine, coarse = channels.scales[:2]
    return np.asarray(np.square(channels.means[0] - fine.spread(coarse.spread(channels.means[2]))))


def _energies(channels: ThreeChannels, number: int) -> Array:
    """Return the mean squared detail in each cell of a scale, summed over the channels."""
    scale = channels.scales[number]
    squares = np.square(scale.details(*channels.means[number : number + 2])).sum(axis=0)
    return np.asarray(scale.sums_of_details(squares) / np.maximum(scale.freedom, 1))


def shares_of_noise(variances: Float64s, energies: Float64s) -> Float64s:
    """Return the share of energies that is trusted to be noise, given the variances read."""
    most = np.maximum(np.maximum(variances, energies), np.finfo(np.float64).tiny)
    return np.asarray((variances / most) ** _TRUST_EXPONENT, np.float64)
