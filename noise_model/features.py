"""Statistics of Haar details in small neighbourhoods, from which the noise model reads the noise.

A neighbourhood is a square of 32 x 32 cells. Its orthonormal Haar details at four scales hold independent noise with
the same variance; textures and filtered noise grow from scale to scale. Details are described for the mean of three
channels and two differences of channels, which are orthonormal as well.

The statistics do not depend on the order of the channels, which are sorted by the energy of their finest details, nor
on flips and quarter turns of squares.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Int64s

SCALES = 4

# Cells per side of a square: the least with four cells at the coarsest scale.
SIDE = 2 ** (SCALES + 1)

# The mean of three channels and two differences, orthonormal.
COMPONENTS = (np.array([[1, 1, 1], [1, 0, -1], [1, -2, 1]]) / np.sqrt([[3], [2], [6]])).astype(np.float32)

# Squares that are read of a large picture, evenly spread; at most so many were seen in training, times two.
MAX_SQUARES = 128

# Powers of the plastic number: rows and columns times these, less whole numbers, spread evenly in two dimensions
# (M. Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018).
_PLASTIC = 1.3247179572447460 ** -np.arange(1.0, 3.0)

# Share of its cells that a square must hold, or as many as the fullest square.
MIN_FILLED_SHARE = 0.5

# Bins of the level of colours, for noise that depends on it.
LEVEL_BINS = 8

# Shares of the cells of a square whose energies are described.
_QUANTILES = (0.1, 0.25, 0.5, 0.75, 0.9)

# Shares of the cells of a picture, the most even ones, whose energies are described together.
_EVEN_SHARES = (0.05, 0.25)

# Share of the blocks of a level, the most even ones, whose energies are described together.
_EVEN_SHARE_OF_LEVEL = 0.2

# Energies of noise that is invisible in 8 bits, in units of a step of 8 bits; for logarithms.
_FLOOR = 0.01

# A squared detail, in steps of 8 bits, below which a cell is constant: the least of 8-bit pictures is 1 / 4.
_CONSTANT = 0.01

# Steps of 8 bits.
STEPS = np.float32(255)


@dataclass(frozen=True)
class Details:
    """Orthonormal Haar details of the channels of P squares at one scale."""

    values: Float32s  # across, down and diagonal, shape (P, 3 channels, 3, n, n), in steps of 8 bits
    is_valid: Bools  # cells whose texels are all filled, shape (P, n, n)

    def by_component(self) -> Float32s:
        """Return the details of the components instead of the channels."""
        return np.asarray(np.einsum("kc,pcdij->pkdij", COMPONENTS, self.values), np.float32)


@dataclass(frozen=True)
class Squares:
    """P squares of three channels, in the order of the energy of their finest details."""

    colours: Float32s  # shape (P, 3, SIDE, SIDE), in steps of 8 bits
    is_filled: Bools  # shape (P, SIDE, SIDE)
    corners: Int64s  # row and column of their first cell, shape (P, 2)
    order: Int64s  # the channels as they were given, in the order that they have here, shape (3,)

    def details(self) -> list[Details]:
        """Return the details at each scale, and at one more, which shows where the last one is even."""
        return haar_details(self.colours, self.is_filled, SCALES + 1)


def choose_corners(filled: Bools, most: int = MAX_SQUARES) -> Int64s:
    """Choose the squares to be read, by the row and column of their first cell, shape (P, 2)."""
    rows, columns = filled.shape
    down, across = np.arange(0, rows, SIDE), np.arange(0, columns, SIDE)
    counts = np.add.reduceat(np.add.reduceat(filled, down, axis=0, dtype=np.int64), across, axis=1)
    enough = counts >= max(1, min(MIN_FILLED_SHARE * SIDE**2, int(counts.max(initial=0))))
    corners: Int64s = np.argwhere(enough).astype(np.int64) * SIDE
    if len(corners) <= most:
        return corners
    spread = (corners // SIDE @ _PLASTIC) % 1
    chosen: Int64s = corners[np.sort(np.argsort(spread, kind="stable")[:most])]
    return chosen


def cut_squares(planes: Float32s, filled: Bools, corners: Int64s, order: Int64s | None = None) -> Squares:
    """Cut squares out of three planes, shape (3, R, C); cells beyond the border are not filled."""
    colours = np.zeros((len(corners), 3, SIDE, SIDE), np.float32)
    is_filled = np.zeros((len(corners), SIDE, SIDE), bool)
    for number, (row, column) in enumerate(corners):
        own = planes[:, row : row + SIDE, column : column + SIDE]
        colours[number, :, : own.shape[1], : own.shape[2]] = own
        inside = filled[row : row + SIDE, column : column + SIDE]
        is_filled[number, : inside.shape[0], : inside.shape[1]] = inside
    colours *= STEPS
    if order is None:
        finest = haar_details(colours, is_filled, 1)[0]
        energy = np.abs(finest.values[:, :, 2]).sum(axis=(0, 2, 3), where=finest.is_valid[:, None])
        order = np.argsort(energy, kind="stable").astype(np.int64)
    return Squares(np.ascontiguousarray(colours[:, order]), is_filled, corners, order)


def haar_details(colours: Float32s, is_filled: Bools, scales: int = SCALES) -> list[Details]:
    """Split squares into orthonormal Haar details, scale by scale."""
    found = []
    for _ in range(scales):
        a, b, c, d = (colours[..., i::2, j::2] for i in (0, 1) for j in (0, 1))
        is_filled = (
            is_filled[:, ::2, ::2]
            & is_filled[:, ::2, 1::2]
            & is_filled[:, 1::2, ::2]
            & is_filled[:, 1::2, 1::2]
        )
        values: Float32s = np.stack([a - b + c - d, a + b - c - d, a - b - c + d], axis=2)
        values *= is_filled[:, None, None] * np.float32(0.5)
        found.append(Details(values, is_filled))
        colours = (a + b + c + d) / np.float32(2)
    return found


def describe(squares: Squares, details: Sequence[Details]) -> Float32s:
    """Return the features of each square, shape (P, F)."""
    columns = [_describe_square(squares)]
    for own in details[:SCALES]:
        columns += _describe_scale(own)
    return np.concatenate(columns, axis=1).astype(np.float32)


def _describe_square(squares: Squares) -> Float32s:
    """Describe levels, clipping, filling, steps between JPEG blocks, and how many values there are."""
    colours, filled = squares.colours, squares.is_filled[:, None]
    count = np.maximum(filled.sum(axis=(2, 3)), 1)
    level = np.sum(colours, axis=(2, 3), where=filled) / count
    low = np.sum(colours <= 0, axis=(2, 3), where=filled) / count
    high = np.sum(colours >= STEPS, axis=(2, 3), where=filled) / count
    variance = np.sum(np.square(colours - level[..., None, None]), axis=(2, 3), where=filled) / count
    ordered = np.sort(np.where(filled, colours, -1).reshape(*colours.shape[:2], -1), axis=2)
    values = np.log2(1 + np.count_nonzero(np.diff(ordered, axis=2) > 1 / 16, axis=2)).mean(axis=1)
    mean, whole = colours.mean(axis=1), filled[:, 0]
    steps = []
    for axis in (1, 2):
        both = np.moveaxis(whole, axis, -1)
        both = both[..., 1:] & both[..., :-1]
        jumps = np.square(np.diff(np.moveaxis(mean, axis, -1), axis=-1)) * both
        at, held = jumps[..., 7::8].sum(axis=(1, 2)), both[..., 7::8].sum(axis=(1, 2))
        all_jumps, all_held = jumps.sum(axis=(1, 2)), both.sum(axis=(1, 2))
        steps.append(
            log_deviation(at / np.maximum(held, 1)) - log_deviation(all_jumps / np.maximum(all_held, 1))
        )
    columns = [level / 64, low, high, log_deviation(variance), values[:, None] / 4, count[:, :1] / SIDE**2]
    return np.concatenate([*columns, np.sum(steps, axis=0)[:, None]], axis=1)


def _describe_scale(details: Details) -> list[Float32s]:
    """Describe the details of one scale, by component; and by channel, how components vary together."""
    values, valid = details.by_component(), details.is_valid[:, None]
    squares = np.square(values)
    energy = squares.mean(axis=2)
    count = np.maximum(valid.sum(axis=(2, 3)), 1)
    mean = np.maximum(energy.sum(axis=(2, 3)) / count, 1e-9)
    flat = np.where(valid, energy, np.inf).reshape(*energy.shape[:2], -1)
    by_block = _block_means(energy, valid)
    fourth = np.square(squares).mean(axis=2).sum(axis=(2, 3)) / count
    across, down, both = np.moveaxis(squares.sum(axis=(3, 4)) / count[..., None] + 1e-3, 2, 0)
    constant = np.sum(energy < _CONSTANT, axis=(2, 3), where=valid) / count
    right = (values[..., 1:] * values[..., :-1]).sum(axis=(2, 3, 4))
    below = (values[..., 1:, :] * values[..., :-1, :]).sum(axis=(2, 3, 4))
    beside = np.stack([right, below]) / (3 * mean * count)
    features = [
        *_quantiles(flat, _QUANTILES),
        *_quantiles(by_block, (0, 0.25)),
        log_deviation(mean),
        np.log2((fourth + 1e-3) / (mean**2 + 1e-3)) / 4,
        constant,
        np.abs(np.log2(across / down)) / 2,
        np.log2(2 * both / (across + down)) / 2,
        beside.mean(axis=0),
        np.abs(beside[0] - beside[1]),
    ]
    return [*features, *_describe_channels(details, values, energy)]


def _describe_channels(details: Details, values: Float32s, energy: Float32s) -> list[Float32s]:
    """Describe quiet cells: the energy of each channel, and the correlation of components."""
    valid = details.is_valid.reshape(len(values), -1)
    total = np.where(valid, energy.sum(axis=1).reshape(len(values), -1), np.inf)
    median = np.sort(total, axis=1)[np.arange(len(total)), np.maximum(valid.sum(axis=1) - 1, 0) // 2]
    quiet = (total <= median[:, None]) & valid
    own = values.reshape(*values.shape[:3], -1) * quiet[:, None, None]
    products = np.einsum("pkdn,pldn->pkl", own, own) / (3 * np.maximum(quiet.sum(axis=1), 1))[:, None, None]
    return [log_deviation(_variances_of_channels(products)), _correlations(products)]


def describe_even_cells(details: Sequence[Details]) -> Float32s:
    """Describe the most even cells of a picture at each scale, shape (F,).

    Cells are even where details of the next two scales are small. Independent noise is independent of these, so that
    its energy there is an unbiased estimate.
    """
    found, totals = [], [np.square(own.values).sum(axis=(1, 2)) for own in details]
    for scale, own in enumerate(details[:SCALES]):
        unevenness = sum(
            totals[coarse].repeat(2 ** (coarse - scale), axis=1).repeat(2 ** (coarse - scale), axis=2)
            for coarse in range(scale + 1, min(scale + 3, len(totals)))
        )
        # Where the coarser cell is not whole, its details are not known.
        whole = own.is_valid & details[scale + 1].is_valid.repeat(2, axis=1).repeat(2, axis=2)
        whole = whole if whole.any() else own.is_valid
        unevenness = unevenness[whole]
        ranked = np.sort(unevenness) if len(unevenness) else np.zeros(1, np.float32)
        values = np.moveaxis(own.by_component(), (1, 2), (0, 1))[:, :, whole]
        for share in _EVEN_SHARES:
            # Cells of one coarser cell are equally even: all of them count.
            even = values[..., unevenness <= ranked[int(share * (len(ranked) - 1))]]
            products = np.einsum("kdn,ldn->kl", even, even) / max(1, 3 * even.shape[-1])
            found += [log_deviation(own) for own in (np.diag(products), _variances_of_channels(products))]
            found.append(_correlations(products[None])[0])
        found.append(np.log2([1 + len(unevenness)]))
    found.append(np.log2([len(details[0].values)]))
    return np.concatenate(found).astype(np.float32)


def _variances_of_channels(products: Float32s) -> Float32s:
    """Return the variances of channels, by the covariances of components, shape (..., 3, 3)."""
    return np.asarray(np.einsum("kc,...kl,lc->...c", COMPONENTS, products, COMPONENTS), np.float32)


def _correlations(products: Float32s) -> Float32s:
    """Return the correlations of three components by their covariances, shape (P, 3, 3)."""
    deviations = np.sqrt(np.einsum("pkk->pk", products) + _FLOOR)
    pairs = [products[:, k, m] / (deviations[:, k] * deviations[:, m]) for k, m in ((0, 1), (0, 2), (1, 2))]
    return np.stack(pairs, axis=1)


def _block_means(energy: Float32s, valid: Bools) -> Float32s:
    """Return the mean energy of blocks of 2 x 2 cells; infinite where a block is not whole."""
    parts = [energy[..., i::2, j::2] for i in (0, 1) for j in (0, 1)]
    whole = np.all([valid[..., i::2, j::2] for i in (0, 1) for j in (0, 1)], axis=0)
    means = np.where(whole, sum(parts) / 4, np.inf)
    return means.reshape(*means.shape[:2], -1)


def _quantiles(values: Float32s, shares: Sequence[float]) -> list[Float32s]:
    """Return quantiles along the last axis among finite values, as logarithms of deviations."""
    ordered = np.sort(values, axis=-1)
    last = np.isfinite(ordered).sum(axis=-1, keepdims=True) - 1
    picked = (
        np.take_along_axis(ordered, np.maximum(np.rint(share * last), 0).astype(np.intp), axis=-1)
        for share in shares
    )
    return [log_deviation(np.where(np.isfinite(own), own, 0)[..., 0]) for own in picked]


def log_deviation(variance: Array) -> Float32s:
    """Return log2 of deviations in steps of 8 bits, with a floor well below a step."""
    return np.asarray(np.log2(np.maximum(variance, 0) + _FLOOR) / 2, np.float32)


@dataclass(frozen=True)
class Blocks:
    """Whole blocks of 4 x 4 cells of three channels, shape (3, B) each."""

    levels: Float32s  # of full scale 1
    energies: Float32s  # mean square of the details within them
    unevenness: Float32s  # mean square of the details of the next two scales there


def blocks_of(squares: Squares, details: Sequence[Details]) -> Blocks:
    """Return the blocks of all squares."""
    fine, coarse, *uneven = (np.square(own.values).sum(axis=2) for own in details[:4])
    total = coarse + sum(fine[..., i::2, j::2] for i in (0, 1) for j in (0, 1))
    around = sum(own.repeat(2**n, axis=2).repeat(2**n, axis=3) for n, own in enumerate(uneven, 1)) / 6
    blocks = squares.colours.reshape(len(fine), 3, SIDE // 4, 4, SIDE // 4, 4).mean(axis=(3, 5))
    whole = details[1].is_valid
    parts = (np.moveaxis(own, 1, 0)[:, whole] for own in (blocks / STEPS, total / 15, around))
    return Blocks(*(own.astype(np.float32) for own in parts))


def level_bins(level: Float32s) -> Int64s:
    """Return the bin of each level."""
    return np.clip(level * LEVEL_BINS, 0, LEVEL_BINS - 1).astype(np.int64)


def describe_levels(blocks: Blocks) -> Float32s:
    """Describe the blocks of each level by the energies of the most even ones, and of all, shape (3, F)."""
    found = np.zeros((3, LEVEL_BINS, 6), np.float32)
    for channel, (levels, energies, unevenness) in enumerate(
        zip(blocks.levels, blocks.energies, blocks.unevenness, strict=True)
    ):
        bins = level_bins(levels)
        for number in np.unique(bins):
            own, around = energies[bins == number], unevenness[bins == number]
            even = np.argsort(around, kind="stable")[: max(2, int(_EVEN_SHARE_OF_LEVEL * len(own)))]
            ordered = np.sort(own)
            picked = [ordered[int(share * (len(own) - 1))] for share in (0.05, 0.25, 0.5)]
            variances = np.array([own[even].mean(), around[even].mean(), *picked])
            found[channel, number, :5] = log_deviation(variances) + 4  # so that no blocks are far from any
            found[channel, number, 5] = np.log2(1 + len(own)) / 4
    return found.reshape(3, -1)
