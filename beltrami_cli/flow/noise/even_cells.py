"""The most even cells of a surface, whose energy is an unbiased estimate of the noise.

Cells are even where the details of the next two scales are small. The noise in a cell does not depend on these.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s
from beltrami_cli.flow.noise.cells import CellStatistics
from beltrami_cli.flow.noise.components import (
    CONSTANT,
    SCALES,
    correlations_of_components,
    log_deviation,
    log_quantiles,
    symmetric,
    variances_of_channels,
)

# Shares of the most even cells of a surface that are described.
EVEN_SHARES = (0.01, 0.05, 0.25)

# Number of deviations by component: those in these shares, and three statistics over the neighbourhoods.
STATISTICS = len(EVEN_SHARES) + 3

# Share of the most even cells whose residuals are described as well.
_SHARE_OF_RESIDUALS = 0.05

# Share of the most even cells in which the covariance of the noise is measured.
_SHARE_OF_COVARIANCES = 0.25

# Quantiles of the energies of the blocks of a surface.
_SHARES_OF_BLOCKS = (0.01, 0.05, 0.2, 0.5)

# Maximum share of clipped samples around an even cell. Clipping reduces the noise.
_MAX_CLIPPED = 0.05


@dataclass(frozen=True)
class EvenCells:
    """The k most even cells of one scale, and their features."""

    products: Float32s  # as in `CellStatistics`, shape (6, k)
    freedom: Float32s  # shape (k,)
    unevenness: Float32s  # shape (k,)
    residuals: Float32s | None  # as in `KindStatistics`, shape (6, k); None: not described

    @cached_property
    def noise(self) -> list[Array]:
        """log2 of the deviations of components and of channels, and correlations of components."""
        sums = np.einsum("kn,n->k", self.products, self.freedom)
        return _deviations_and_correlations(sums[None] / np.maximum(self.freedom.sum(), 1))

    @property
    def noise_of_residuals(self) -> list[Array]:
        """The same of residuals; empty if these are not described."""
        return (
            [] if self.residuals is None else _deviations_and_correlations(self.residuals.mean(axis=1)[None])
        )

    @property
    def scatter(self) -> Array:
        """Scatter of the energies of cells, by component."""
        energies = self.products[:3]
        scatter = (np.square(energies).mean(axis=1) + 1e-3) / (np.square(energies.mean(axis=1)) + 1e-3)
        return np.asarray(np.log2(scatter) / 4)

    @property
    def surroundings(self) -> Array:
        """log2 of the deviation around the cells, and the share of constant cells."""
        around = np.minimum(self.unevenness, 1e6).mean()
        return np.array([log_deviation(around), np.mean(self.products[:3].sum(axis=0) < CONSTANT)])


@dataclass(frozen=True)
class EvenScale:
    """The cells of one scale that may be even, and features of the most even ones."""

    cells: CellStatistics
    known: Bools  # mask of the cells with a known unevenness, or of all if there are none, shape (P, n)
    usable: Bools  # mask of the unclipped ones among them, or of all if too few are unclipped, shape (P, n)

    @classmethod
    def of(cls, cells: CellStatistics, chosen: Bools | bool = True) -> EvenScale:
        """Choose among the cells in a mask."""
        valid = cells.is_valid & chosen
        known = valid & np.isfinite(cells.unevenness)
        known = known if known.any() else valid
        if cells.of_kind.clipped is None:
            return cls(cells, known, known)
        unclipped = known & (cells.of_kind.clipped <= _MAX_CLIPPED)
        are_enough = 4 * unclipped.sum() > _SHARE_OF_COVARIANCES * known.sum()
        return cls(cells, known, unclipped if are_enough else known)

    @property
    def count(self) -> Array:
        return np.log2([1 + self.usable.sum()])

    @property
    def usable_share(self) -> Array:
        return np.array([self.usable.sum() / max(1, self.known.sum())])

    @property
    def energies_of_blocks(self) -> list[Array]:
        """Quantiles of the energies of blocks, by component."""
        ordered = np.sort(self.cells.blocks.reshape(3, -1), axis=1)
        return [quantile[:, 0] for quantile in log_quantiles(ordered[:, None], _SHARES_OF_BLOCKS)]

    @property
    def deviations(self) -> list[Array]:
        """`STATISTICS` of log2 of the deviations of components, shape (3,) each."""
        return [*self.by_share(lambda even: even.noise[:1]), *self.by_neighbourhood]

    def by_share(self, features: Callable[[EvenCells], list[Array]]) -> list[Array]:
        """Return features of each of the `EVEN_SHARES`; if there are no cells, all have the value of no noise."""
        columns = [column for even in self._shares for column in features(even)]
        if self.usable.any():
            return columns
        return [np.full_like(column, log_deviation(0), np.float32) for column in columns]

    @cached_property
    def _shares(self) -> list[EvenCells]:
        # Without cells, features of any cells show how many columns there are.
        mask = self.usable if self.usable.any() else np.ones_like(self.usable)
        return [self._most_even(mask, share) for share in EVEN_SHARES]

    def _most_even(self, mask: Bools, share: float) -> EvenCells:
        cells, unevenness = self.cells, self.cells.unevenness[mask]
        residuals = cells.of_kind.residuals if share == _SHARE_OF_RESIDUALS else None
        even = _are_most_even(unevenness, share)
        return EvenCells(
            cells.products[:, mask][:, even],
            cells.freedom[mask][even],
            unevenness[even],
            None if residuals is None else residuals[:, mask][:, even],
        )

    @cached_property
    def by_neighbourhood(self) -> Float32s:
        """Features of the even quarter of each neighbourhood, which are unbiased if noise depends on the place.

        They are the mean, median and lower quartile of the energy of components over the neighbourhoods, as logarithms
        of deviations, shape (3, 3).
        """
        has_even = self.usable.any(axis=1)
        if not has_even.any():
            return np.full((3, 3), log_deviation(0))
        cells, mask = self.cells, self.usable[has_even]
        uneven = np.where(mask, cells.unevenness[has_even], np.inf)
        last = (_SHARE_OF_COVARIANCES * (mask.sum(axis=1) - 1)).astype(np.intp)
        limit = np.take_along_axis(np.sort(uneven, axis=1), last[:, None], axis=1)
        weights = cells.freedom[has_even] * ((uneven <= limit) & mask)
        energies = np.einsum("kpn,pn->kp", cells.products[:3, has_even], weights) / weights.sum(axis=1)
        parts = [energies.mean(axis=1), *np.quantile(energies, (0.5, 0.25), axis=1)]
        return np.stack([log_deviation(own) for own in parts])


def even_covariances(
    scales: Sequence[CellStatistics], chosen: Bools, variances: Float64s
) -> tuple[Float64s, Float64s]:
    """Return the covariance of components in the even cells of some neighbourhoods, shape (SCALES, 3, 3).

    It is divided by the relative variance of each neighbourhood, shape (P,). The second result is the number of details
    by scale that it was measured from, shape (SCALES,).
    """
    covariances, counts = np.zeros((SCALES, 3, 3)), np.zeros(SCALES)
    for number, cells in enumerate(scales):
        mask = EvenScale.of(cells, chosen[:, None]).usable
        if not mask.any():
            continue
        even = _are_most_even((cells.unevenness / variances[:, None])[mask], _SHARE_OF_COVARIANCES)
        products, freedom = (cells.products / variances[:, None])[:, mask][:, even], cells.freedom[mask][even]
        counts[number] = total = freedom.sum()
        covariances[number] = symmetric(np.einsum("kn,n->k", products, freedom, dtype=np.float64) / total)
    return covariances, counts


def _are_most_even(unevenness: Array, share: float) -> Bools:
    """Mark a share of the cells; those within one coarser cell are equally even, so ties are included."""
    return np.asarray(unevenness <= np.sort(unevenness)[int(share * (len(unevenness) - 1))])


def _deviations_and_correlations(products: Float32s) -> list[Array]:
    """Return log2 of the deviations of components and channels, and correlations, from mean products, shape (1, 6)."""
    deviations = [log_deviation(part[0]) for part in (products[:, :3], variances_of_channels(products))]
    return [*deviations, correlations_of_components(products)[0]]
