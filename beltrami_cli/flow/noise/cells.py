"""Statistics of the cells of one scale, laid out by neighbourhood: P neighbourhoods of up to n cells."""

from __future__ import annotations

from dataclasses import dataclass

from beltrami_cli.arrays import Bools, Float32s


@dataclass(frozen=True)
class KindStatistics:
    """Statistics that each kind of neighbourhoods computes in its own way."""

    mean_squares: (
        Float32s  # of the energies of details or cells by component, large for heavy tails, shape (P, 3)
    )
    others: Float32s  # features that only this kind of neighbourhood has, shape (P, F)
    clipped: Float32s | None = None  # share of clipped samples around each cell, shape (P, n), if it is used
    # Mean products of residuals, which are free of slopes, in each cell, shape (6, P, n), if they are used.
    residuals: Float32s | None = None


@dataclass(frozen=True)
class CellStatistics:
    """The details of the cells of one scale, and of up to m blocks of cells in each neighbourhood."""

    products: Float32s  # mean products of the components' details in each cell, by `PAIRS`, shape (6, P, n)
    freedom: Float32s  # number of details in each cell, shape (P, n); 0: no cell
    blocks: Float32s  # mean squares by component in blocks of cells, shape (3, P, m); infinite: no block
    unevenness: Float32s  # energy of the next two scales around a cell, shape (P, n); infinite: unknown
    of_kind: KindStatistics

    @property
    def is_valid(self) -> Bools:
        """Mask of existing cells, shape (P, n)."""
        return self.freedom > 0
