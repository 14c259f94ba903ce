"""Squares of a grid as neighbourhoods; flips and quarter turns of squares change nothing."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int64s
from beltrami_cli.flow.noise.features import MAX_SQUARES, SCALES, log_deviation
from beltrami_cli.flow.noise.neighbourhoods import Neighbourhoods, Samples, Scale
from beltrami_cli.surface import large_arrays

# Cells per side of a square: the least with four cells at the coarsest scale.
SIDE = 2 ** (SCALES + 1)

# Share of its cells that a square must hold, or as many as the fullest square.
MIN_FILLED_SHARE = 0.5

# Powers of the plastic number: rows and columns times these, less whole numbers, spread evenly in two dimensions
# (M. Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018).
_PLASTIC = 1.3247179572447460 ** -np.arange(1.0, 3.0)

# Cells a side of a tile, whose 48 details by component show the deviation of noise within a tenth.
_TILE = 8

# The quantile of the tiles of a square that is free of texture; and what it is of white noise of variance 1, for one
# component and for the quietest of three, by simulation.
_QUIET = 0.3
_OF_NOISE = {1: 0.876, 3: 0.754}


@dataclass(frozen=True)
class Grid(Neighbourhoods):
    """Up to so many squares of the cells of a grid that are filled, shape (R, C)."""

    filled: Bools
    most: int = MAX_SQUARES
    kind: ClassVar[str] = "grid"

    @cached_property
    def corners(self) -> Int64s:
        """Row and column of the first cell of each square, shape (P, 2)."""
        return choose_corners(self.filled, self.most)

    @property
    def centres(self) -> Float64s:
        return np.asarray(self.corners / SIDE, np.float64)

    @cached_property
    def _squares(self) -> Bools:
        """Which cells of the squares are filled, shape (P, SIDE, SIDE)."""
        return self._cut_out(self.filled)

    def _cut_out(self, plane: Array) -> Array:
        """Return the squares of a plane; 0 beyond its border."""
        found = np.zeros((len(self.corners), SIDE, SIDE), plane.dtype)
        for square, (row, column) in zip(found, self.corners, strict=True):
            own = plane[row : row + SIDE, column : column + SIDE]
            square[: own.shape[0], : own.shape[1]] = own
        return found

    @cached_property
    def scales(self) -> list[Scale]:
        whole, found = self._squares, []
        parts = np.flatnonzero(whole)
        for number in range(SCALES + 1):
            side = whole.shape[-1] // 2
            square, row, column = np.unravel_index(parts, whole.shape)
            parents = (square * side + row // 2) * side + column // 2
            whole = np.logical_and.reduce([whole[:, i::2, j::2] for i in (0, 1) for j in (0, 1)])
            tile, slot = np.divmod(np.arange(whole.size), side**2)
            is_whole = whole.ravel()
            found.append(
                Scale(parents, np.full(len(parts), 4.0**number), 3.0 * is_whole, is_whole, tile, slot)
            )
            parts = np.arange(whole.size)
        return found

    @cached_property
    def tiles(self) -> Int64s:
        return np.nonzero(self._squares)[0].astype(np.int64)

    def chosen_of(self, planes: Float32s) -> Float32s:
        return np.stack([self._cut_out(plane)[self._squares] for plane in planes])

    def energies_for_order(self, samples: Samples) -> Float32s:
        (a, b, c, d), is_whole = self._quarters(samples.colours, 0)
        return np.asarray(np.abs(a - b - c + d).sum(axis=(1, 2, 3), where=is_whole), np.float32)

    def _quarters(self, values: Array, number: int) -> tuple[list[Float32s], Bools]:
        """Return the four parts of each cell of a scale, shape (N, P, n, n) each, and which cells are whole."""
        side = SIDE >> number
        squares = np.zeros((len(values), self.count, side, side), np.float32)
        if number:
            squares[:] = values.reshape(squares.shape)
        else:
            squares[:, self._squares] = values
        parts = [squares[..., i::2, j::2] for i in (0, 1) for j in (0, 1)]
        return parts, self.scales[number].is_whole.reshape(parts[0].shape[1:])

    def described(self, samples: Samples) -> list[Array]:
        """Describe filling, steps between JPEG blocks, and how many values there are."""
        squares = np.full((3, *self._squares.shape), -1, np.float32)
        squares[:, self._squares] = samples.colours
        ordered = np.sort(squares.reshape(3, self.count, -1), axis=2)
        values = np.log2(1 + np.count_nonzero(np.diff(ordered, axis=2) > 1 / 16, axis=2)).mean(axis=0)
        return [values / 4, self.counts / SIDE**2, self._steps_of_jpeg(squares.mean(axis=0))]

    def _steps_of_jpeg(self, means: Float32s) -> Float32s:
        """Return by how much steps between blocks of 8 x 8 exceed all others."""
        excess = np.zeros(len(means), np.float32)
        for axis in (1, 2):
            both = np.moveaxis(self._squares, axis, -1)
            both = both[..., 1:] & both[..., :-1]
            jumps = np.square(np.diff(np.moveaxis(means, axis, -1), axis=-1)) * both
            for part, sign in ((np.s_[..., 7::8], 1), (np.s_[...], -1)):
                count = np.maximum(both[part].sum(axis=(1, 2)), 1)
                excess += sign * log_deviation(jumps[part].sum(axis=(1, 2)) / count)
        return excess

    def described_cells(self, samples: Samples, number: int) -> tuple[Float32s, Float32s, None]:
        """Return the fourth power of details, how they depend on the direction, and their correlation."""
        (a, b, c, d), is_whole = self._quarters(samples.components(number), number)
        values = np.stack([a - b + c - d, a + b - c - d, a - b - c + d])
        values *= is_whole * np.float32(2.0**number / 2)
        count = np.maximum(is_whole.sum(axis=(1, 2)), 1)
        across, down, both = np.einsum("dkpij,dkpij->dkp", values, values) / count + 1e-3
        energy = np.maximum((across + down + both - 3e-3) / 3, 1e-9)
        right = np.einsum("dkpij,dkpij->kp", values[..., 1:], values[..., :-1]) / (3 * count * energy)
        below = np.einsum("dkpij,dkpij->kp", values[..., 1:, :], values[..., :-1, :]) / (3 * count * energy)
        others = [
            np.abs(np.log2(across / down)) / 2,
            np.log2(2 * both / (across + down)) / 2,
            (right + below) / 2,
            np.abs(right - below),
        ]
        fourth = np.square(np.square(values)).sum(axis=(0, 3, 4)) / (3 * count)
        return fourth.T, np.concatenate(others).T.astype(np.float32), None

    def over_samples(self, variances: Float64s) -> Float32s:
        down, across = ((np.arange(size) + 0.5) / SIDE - 0.5 for size in self.filled.shape)
        rows, columns = (np.arange(-(-size // SIDE)) for size in self.filled.shape)
        every = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2)
        nearest = variances[self.nearest(every)].reshape(len(rows), len(columns))
        wide = np.stack([np.interp(across, columns, row) for row in nearest]).astype(np.float32)
        result: Float32s = large_arrays.empty((1, *self.filled.shape), np.float32)
        total = 0.0
        for block in large_arrays.blocks(len(down), SIDE):
            above, share = np.divmod(down[block].clip(0, rows[-1]), 1)
            below = np.minimum(above + 1, rows[-1]).astype(int)
            share = share[:, None].astype(np.float32)
            result[0, block] = (1 - share) * wide[above.astype(int)] + share * wide[below]
            total += float(result[0, block].sum(where=self.filled[block], dtype=np.float64))
        result /= np.float32(total / np.count_nonzero(self.filled))
        return result

    def quiet_energies(self, samples: Samples, channels: int) -> Float64s:
        """Return the energy of the quietest component in the quiet tiles of each square, shape (P,).

        One channel is there three times. NaN: squares that lack cells show less than there is.
        """
        finest, side = self.scales[0], _TILE // 2
        products = samples.products_of(0)[: 3 if channels > 1 else 1]
        energies = finest.padded(products / (1 if channels > 1 else 3))
        tiles = energies.reshape(len(products), -1, SIDE // _TILE, side, SIDE // _TILE, side).mean(
            axis=(3, 5)
        )
        ordered = np.sort(tiles.min(axis=0).reshape(self.count, -1), axis=1)
        quiet = ordered[:, int(_QUIET * (ordered.shape[1] - 1))].astype(np.float64) / _OF_NOISE[len(products)]
        return np.where(self._squares.all(axis=(1, 2)), quiet, np.nan)


def choose_corners(filled: Bools, most: int = MAX_SQUARES) -> Int64s:
    """Choose the squares to be read, by the row and column of their first cell, shape (P, 2)."""
    # Squares begin with the first filled cell, as blocks of a JPEG picture do.
    first = [int(filled.any(axis=axis).argmax()) for axis in (1, 0)]
    filled = filled[first[0] :, first[1] :]
    down, across = (np.arange(0, size, SIDE) for size in filled.shape)
    counts = np.add.reduceat(np.add.reduceat(filled, down, axis=0, dtype=np.int64), across, axis=1)
    enough = counts >= max(1, min(MIN_FILLED_SHARE * SIDE**2, int(counts.max(initial=0))))
    corners: Int64s = np.argwhere(enough).astype(np.int64) * SIDE
    if len(corners) > most:
        spread = (corners // SIDE @ _PLASTIC) % 1
        corners = corners[np.sort(np.argsort(spread, kind="stable")[:most])]
    return corners + first
