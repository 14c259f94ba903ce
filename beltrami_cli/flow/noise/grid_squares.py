"""Neighbourhoods of a grid: squares, with features that are invariant under flips and quarter turns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from beltrami_cli._native import pilot_of_squares
from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int64s
from beltrami_cli.flow.noise import jpeg_traces
from beltrami_cli.flow.noise.cells import KindStatistics
from beltrami_cli.flow.noise.components import SCALES
from beltrami_cli.flow.noise.even_cells import EvenScale
from beltrami_cli.flow.noise.neighbourhoods import Neighbourhoods, Scale, ThreeChannels
from beltrami_cli.surface import large_arrays

# Maximum number of squares that are read from a grid. Training images have at most half as many.
MAX_SQUARES = 128

# Cells per side of a square: the smallest side with 2 x 2 cells at the coarsest scale.
SIDE = 2 ** (SCALES + 1)

# Cells per side of a part of a square, which is a cell of the coarsest scale.
_PART = SIDE // 2

# Minimum share of filled cells in a square. If no square has that many, the fullest squares are read.
_MIN_FILLED_SHARE = 0.5

# Inverse powers of the plastic number. The fractional parts of row and column times these are spread evenly
# (M. Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018).
_PLASTIC = 1.3247179572447460 ** -np.arange(1.0, 3.0)

# Cells per side of a tile. Its 48 details per component determine the deviation of the noise within a tenth.
_TILE = 8

# Quantile of the energies of tiles in a square that is assumed to be free of texture; and its value for white noise of
# variance 1, found by simulation, for the quieter of two components and for the quietest of three.
_QUIET = 0.3
_QUIET_OF_NOISE = {2: 0.795, 3: 0.754}

# Share of the largest variance of a component above which another component has noise, too.
_NOISY = 0.1


@dataclass(frozen=True)
class SquareScale(Scale):
    """Cells of 2 x 2 parts in squares, row by row."""

    side: int  # cells
    present: Bools | None  # mask of existing parts, shape (P, 2 * side, 2 * side); None: all

    def quarters(self, values: Array) -> list[Array]:
        """Return the four parts of each cell, shape (..., P, side, side) each; 0 where a part is missing."""
        squares = laid_out(values, self.present, 2 * self.side)
        return [squares[..., i::2, j::2] for i in (0, 1) for j in (0, 1)]

    def sums(self, values: Array) -> Array:
        a, b, c, d = self.quarters(values)
        return (a + b + c + d).reshape(*values.shape[:-1], -1)

    def means(self, values: Array) -> Array:
        return self.sums(values) / np.float32(4)

    def spread(self, values: Array) -> Array:
        squares = values.reshape(*values.shape[:-1], -1, self.side, self.side)
        parts = squares.repeat(2, axis=-1).repeat(2, axis=-2)
        if self.present is not None:
            return parts[..., self.present]
        return parts.reshape(*values.shape[:-1], -1)

    def details(self, fine: Array, coarse: Array) -> Array:
        """Return the three Haar details of each cell, shape (N, 3, cells); 0 where cells lack parts."""
        a, b, c, d = self.quarters(fine)
        right, left, factor = a - b, c - d, np.sqrt(self.counts) / 2
        details = np.stack([right + left, a + b - c - d, right - left], axis=1).reshape(len(fine), 3, -1)
        details *= self.is_whole * factor
        return details

    def sums_of_details(self, values: Array) -> Array:
        return np.asarray(values.sum(axis=-2))

    def padded(self, values: Array, empty: float = 0.0) -> Float32s:
        return values.reshape(*values.shape[:-1], -1, self.side**2).astype(np.float32)


def laid_out(values: Array, present: Bools | None, side: int) -> Array:
    """Return values of parts as squares, shape (..., P, side, side); 0 where there is no part."""
    if present is None:
        return values.reshape(*values.shape[:-1], -1, side, side)
    squares = np.zeros((*values.shape[:-1], *present.shape), values.dtype)
    squares[..., present] = values
    return squares


@dataclass(frozen=True, eq=False)
class GridSquares(Neighbourhoods):
    """Squares of a grid."""

    kind: ClassVar[str] = "grid"

    scales: list[SquareScale]
    filled: Bools  # mask of the filled cells of the grid, shape (R, C)
    corners: Int64s  # row and column of the first cell of each square, shape (P, 2)
    squares: Bools  # mask of the filled cells in each square, shape (P, SIDE, SIDE)

    @classmethod
    def of(cls, filled: Bools, most: int = MAX_SQUARES) -> GridSquares:
        """Choose at most `most` squares."""
        corners = choose_corners(filled, most)
        squares = _cut_out(filled, corners)
        of_samples = np.nonzero(squares)[0].astype(np.int64, copy=False)
        return cls(_scales_of(squares), of_samples, corners / SIDE, filled, corners, squares)

    @property
    def _present(self) -> Bools | None:
        return self.scales[0].present

    def means(self, rows: Array) -> Float32s:
        squares = laid_out(rows, self._present, SIDE).reshape(len(rows), self.count, -1)
        return np.asarray(squares.sum(axis=2, dtype=np.float32) / self.counts, np.float32)

    def sampled(self, planes: Float32s) -> Float32s:
        return np.stack([_cut_out(plane, self.corners)[self.squares] for plane in planes])

    def channel_energies(self, channels: ThreeChannels) -> Float32s:
        finest = self.scales[0]
        a, b, c, d = finest.quarters(channels.colours)
        is_whole = finest.is_whole.reshape(a.shape[1:])
        return np.asarray(np.abs(a - b - c + d).sum(axis=(1, 2, 3), where=is_whole), np.float32)

    def features(self, channels: ThreeChannels) -> list[Array]:
        """Return features of the number of values, of filling, and of JPEG."""
        squares = laid_out(channels.colours, self._present, SIDE)
        shown = squares if self._present is None else np.where(self.squares, squares, np.float32(-1))
        ordered = np.sort(shown.reshape(3, self.count, -1), axis=2)
        values = np.log2(1 + np.count_nonzero(np.diff(ordered, axis=2) > 1 / 16, axis=2)).mean(axis=0)
        luma = np.einsum("c,cpij->pij", jpeg_traces.LUMA[channels.order], squares)
        return [
            values / 4,
            self.counts / SIDE**2,
            jpeg_traces.block_steps(shown.mean(axis=0), self.squares),
            *jpeg_traces.coefficients(luma, self.squares),
        ]

    def even_features(self, even: EvenScale) -> list[Array]:
        return [even.count, *even.by_share(lambda cells: cells.noise)]

    def statistics(self, channels: ThreeChannels, number: int) -> KindStatistics:
        """Return mean squares of the energies of details, and features of their anisotropy and correlation."""
        scale = self.scales[number]
        values = channels.details[number].reshape(3, 3, self.count, scale.side, scale.side)
        is_whole = scale.is_whole.reshape(values.shape[2:])
        count = np.maximum(is_whole.sum(axis=(1, 2)), 1)
        squares = np.square(values)
        across, down, both = np.moveaxis(squares.sum(axis=(3, 4)), 1, 0) / count + 1e-3
        energy = np.maximum((across + down + both - 3e-3) / 3, 1e-9)
        right = np.einsum("kdpij,kdpij->kp", values[..., 1:], values[..., :-1]) / (3 * count * energy)
        below = np.einsum("kdpij,kdpij->kp", values[..., 1:, :], values[..., :-1, :]) / (3 * count * energy)
        others = [
            np.abs(np.log2(across / down)) / 2,
            np.log2(2 * both / (across + down)) / 2,
            (right + below) / 2,
            np.abs(right - below),
        ]
        mean_squares = np.square(squares).sum(axis=(1, 3, 4)) / (3 * count)
        return KindStatistics(
            mean_squares=mean_squares.T.astype(np.float32),
            others=np.concatenate(others).T.astype(np.float32),
        )

    def pilot(self, colours: Float32s, variances: Float32s) -> Float32s:
        present = self._present
        if len(variances) > 1:
            variances = laid_out(variances, present, SIDE)
        squares = pilot_of_squares(laid_out(colours, present, SIDE), present, variances.ravel())
        return squares.reshape(len(colours), -1) if present is None else squares[:, present]

    def quiet_energies(self, channels: ThreeChannels, variances: Float64s) -> Float64s | None:
        """Return the energies of quiet tiles in the quietest component, which has the least texture.

        They are unknown if only one component has noise, which then cannot be distinguished from texture.
        """
        noisy = np.flatnonzero(variances > _NOISY * variances.max())
        if len(noisy) < 2:
            return None
        finest = self.scales[0]
        energies = finest.padded(channels.products[0][noisy] / variances[noisy, None])
        in_tiles = energies.reshape(len(noisy), -1, *2 * (SIDE // _TILE, _TILE // 2))
        tiles = in_tiles.mean(axis=(3, 5)).min(axis=0)
        ordered = np.sort(tiles.reshape(len(tiles), -1), axis=1).astype(np.float64)
        is_whole = finest.padded(finest.is_whole).all(axis=1)
        quiet = ordered[:, int(_QUIET * (ordered.shape[1] - 1))] / _QUIET_OF_NOISE[len(noisy)]
        return np.where(is_whole, quiet, np.nan)

    def product_of_neighbours(self, values: Float32s) -> float:
        squares, filled, total, count = laid_out(values, self._present, SIDE), self.squares, 0.0, 0
        for one, other in ((np.s_[..., 1:, :], np.s_[..., :-1, :]), (np.s_[..., 1:], np.s_[..., :-1])):
            total += float(np.einsum("kpij,kpij->", squares[one], squares[other]))
            count += int(np.count_nonzero(filled[one] & filled[other]))
        return total / max(1, len(values) * count)

    def over_samples(self, variances: Float64s, parts: Float64s) -> Float32s:
        coarse = self._in_parts(variances, parts)
        wide = _stretched(coarse, self.filled.shape[1], _PART).astype(np.float32)
        down = (np.arange(self.filled.shape[0]) + 0.5) / _PART - 0.5
        result: Float32s = large_arrays.empty((1, *self.filled.shape), np.float32)
        total = 0.0
        for block in large_arrays.blocks(len(down), _PART):
            above, share = np.divmod(down[block].clip(0, len(wide) - 1), 1)
            below = np.minimum(above + 1, len(wide) - 1).astype(int)
            share = share[:, None].astype(np.float32)
            result[0, block] = (1 - share) * wide[above.astype(int)] + share * wide[below]
            total += float(result[0, block].sum(where=self.filled[block], dtype=np.float64))
        result /= np.float32(total / np.count_nonzero(self.filled))
        return result

    def _in_parts(self, variances: Float64s, parts: Float64s) -> Float64s:
        """Return the variances of all parts of the grid: those given, or interpolated between the nearest squares."""
        rows, columns = (np.arange(-(-size // SIDE)) for size in self.filled.shape)
        squares = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2)
        nearest = variances[self.nearest(squares)].reshape(len(rows), len(columns))
        coarse = _stretched(_stretched(nearest, 2 * len(columns), 2).T, 2 * len(rows), 2).T
        firsts = np.rint(self.corners / _PART).astype(int)
        for (row, column), given in zip(firsts, parts.reshape(-1, 2, 2), strict=True):
            square = coarse[row : row + 2, column : column + 2]
            given = given[: square.shape[0], : square.shape[1]]
            square[:] = np.where(np.isnan(given), square, given)
        return coarse


def _stretched(rows: Float64s, count: int, factor: int) -> Float64s:
    """Interpolate rows of cells at the centres of `count` smaller cells, `factor` to a cell."""
    middles = (np.arange(count) + 0.5) / factor - 0.5
    return np.stack([np.interp(middles, np.arange(len(row)), row) for row in rows])


def _cut_out(plane: Array, corners: Int64s) -> Array:
    """Return the squares of a plane, with 0 beyond its border."""
    squares = np.zeros((len(corners), SIDE, SIDE), plane.dtype)
    for square, (row, column) in zip(squares, corners, strict=True):
        inside = plane[row : row + SIDE, column : column + SIDE]
        square[: inside.shape[0], : inside.shape[1]] = inside
    return squares


def _scales_of(squares: Bools) -> list[SquareScale]:
    whole, present, scales = squares, None if squares.all() else squares, []
    for number in range(SCALES + 1):
        whole = np.logical_and.reduce([whole[:, i::2, j::2] for i in (0, 1) for j in (0, 1)])
        is_whole, samples = whole.ravel(), np.full(1, 4.0**number, np.float32)  # equal in all parts
        freedom = np.float32(3) * is_whole
        scales.append(SquareScale(samples, freedom, is_whole, whole.shape[-1], present))
        present = None
    return scales


def choose_corners(filled: Bools, most: int) -> Int64s:
    """Choose the squares to read; return row and column of their first cells, shape (P, 2)."""
    # Squares are aligned with the first filled cell, as the blocks of a JPEG image are.
    first = [int(filled.any(axis=axis).argmax()) for axis in (1, 0)]
    filled = filled[first[0] :, first[1] :]
    down, across = (np.arange(0, size, SIDE) for size in filled.shape)
    columns = (np.count_nonzero(filled[row : row + SIDE], axis=0) for row in down)
    counts = np.stack([np.add.reduceat(each, across) for each in columns])
    enough = counts >= max(1, min(_MIN_FILLED_SHARE * SIDE**2, int(counts.max(initial=0))))
    corners: Int64s = np.argwhere(enough).astype(np.int64) * SIDE
    if len(corners) > most:
        spread = (corners // SIDE @ _PLASTIC) % 1
        corners = corners[np.sort(np.argsort(spread, kind="stable")[:most])]
    return corners + first
