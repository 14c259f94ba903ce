"""Gaussian means on a regular grid, for the regularised metric and for averages over coarse levels."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from beltrami_cli._native import convolve
from beltrami_cli.arrays import Bools, Float32s, Int32s, Uint8s
from beltrami_cli.flow.manifolds.blocks import SUMMED_ROWS
from beltrami_cli.flow.manifolds.grid.connected_means import ConnectedMeans
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import EMPTY, Atlas


def gaussian_taps(scale: float) -> Float32s:
    """Weights of a Gaussian with a standard deviation in cells, shape (2 reach + 1,), of sum 1."""
    # Beyond 2.5 standard deviations lies one per cent of a Gaussian.
    reach = max(1, int(np.ceil(2.5 * scale - 0.5)))
    taps = np.exp(-(np.arange(-reach, reach + 1) ** 2) / (2 * scale**2))
    return np.asarray(taps / taps.sum(), np.float32)


def gaussian_reach(scale: float) -> int:
    """Reach of a `GridGaussian` to each side in cells."""
    return len(gaussian_taps(scale)) // 2 if scale > 0 else 0


@dataclass(frozen=True, eq=False)
class GridGaussian:
    """Gaussian means over the filled cells of a grid, shape (R, C)."""

    taps: Float32s
    # Cells at which means do not stop; None: charts are so far apart that they need not stop
    reachable: Bools | None
    partial: Int32s  # flat indices of the filled cells that lack a neighbour
    totals: Float32s  # sums of their weights
    cut_means: ConnectedMeans | None
    threads: int
    first: int = 0  # row of the canvas at which planes begin

    @classmethod
    def of(cls, atlas: Atlas, scale: float, *, stop_at_holes: bool, threads: int) -> GridGaussian:
        """Prepare a standard deviation of `scale` cells: find the cells that lack a neighbour."""
        taps, reachable = gaussian_taps(scale), atlas.is_filled if stop_at_holes else None
        partial, totals = _partial_totals(atlas.kind, taps, threads, stop_at_holes=stop_at_holes)
        cut_means = ConnectedMeans.of(atlas, taps) if len(atlas.cut_cells) else None
        return cls(taps, reachable, partial, totals, cut_means, threads)

    @property
    def gain(self) -> float:
        """Standard deviation of smoothed white noise of unit variance, away from borders."""
        return float(np.sum(self.taps**2))

    def from_row(self, first: int) -> GridGaussian:
        """Return the Gaussian for planes that begin with row `first`; within reach of their ends, means are wrong."""
        return dataclasses.replace(self, first=first)

    def smooth(self, planes: Float32s) -> Float32s:
        """Smooth planes, shape (N, K, C), which must be 0 where cells are not filled."""
        first, (count, columns) = self.first, planes.shape[1:]
        reachable = None if self.reachable is None else self.reachable[first : first + count]
        smoothed = _convolved(planes, self.taps, reachable, self.threads)
        here = slice(*np.searchsorted(self.partial, [first * columns, (first + count) * columns]))
        partial = self.partial[here] - first * columns
        for plane, result in zip(planes, smoothed, strict=True):
            result.reshape(-1)[partial] /= self.totals[here]
            if self.cut_means is not None:
                self.cut_means.write(plane, result, first)
        return smoothed


def _partial_totals(
    kind: Uint8s, taps: Float32s, threads: int, *, stop_at_holes: bool
) -> tuple[Int32s, Float32s]:
    """Find the filled cells (flat indices) that lack a neighbour, and the sums of their weights."""
    reach = len(taps) // 2
    # Most cells have all neighbours, where weights sum to 1 up to rounding. The least weight is in a corner.
    enough = 1 - taps[0] ** 2 / 2
    cells, totals = [np.zeros(0, np.int32)], [np.zeros(0, np.float32)]
    # Row by row: whole planes would need the memory that this class saves.
    for rows in large_arrays.blocks(len(kind), SUMMED_ROWS):
        above = min(rows.start, reach)
        band = kind[rows.start - above : rows.stop + reach] != EMPTY
        (total,) = _convolved(band[None].astype(np.float32), taps, band if stop_at_holes else None, threads)
        here = slice(above, above + rows.stop - rows.start)
        total = total[here]
        lacking = np.flatnonzero((total < enough) & band[here])
        cells.append((lacking + rows.start * kind.shape[1]).astype(np.int32))
        totals.append(total.reshape(-1)[lacking])
    return np.concatenate(cells), np.concatenate(totals)


def _convolved(planes: Float32s, taps: Float32s, reachable: Bools | None, threads: int) -> Float32s:
    """Convolve planes; if the unreachable cells are given, stop at them."""
    if reachable is None:
        return convolve(planes, taps, threads)
    along = [_convolve_up_to_holes(plane, reachable, taps) for plane in planes]
    return np.stack([_convolve_up_to_holes(plane.T, reachable.T, taps).T for plane in along])


def _convolve_up_to_holes(plane: Float32s, filled: Bools, taps: Float32s) -> Float32s:
    """Convolve along the first axis, from each cell only up to the next cell that is not filled."""
    reach = len(taps) // 2
    result = np.where(filled, taps[reach] * plane, np.float32(0))
    for ahead in (True, False):
        seen = filled
        for step in range(1, min(reach, len(plane) - 1) + 1):
            near, far = (
                (slice(None, -step), slice(step, None)) if ahead else (slice(step, None), slice(None, -step))
            )
            # All cells from the nearest to the furthest.
            seen = (seen[:-1] if ahead else seen[1:]) & filled[far]
            result[near] += taps[reach + step] * np.where(seen, plane[far], np.float32(0))
    return result
