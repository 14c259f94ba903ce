"""Statistics of details in small neighbourhoods, from which the noise model reads the noise.

A neighbourhood is a square of 32 x 32 cells of a grid, or a cluster of vertices. Its orthonormal details at four scales
hold independent noise with the same variance; textures and filtered noise grow from scale to scale. Details are
described for the mean of three channels and two differences of channels, which are orthonormal as well.

`neighbourhoods` measures the details of cells. What follows does not depend on the order of the channels, which are
sorted by the energy of their finest details.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s

SCALES = 4

# The mean of three channels and two differences, orthonormal.
COMPONENTS = (np.array([[1, 1, 1], [1, 0, -1], [1, -2, 1]]) / np.sqrt([[3], [2], [6]])).astype(np.float32)

# Pairs of components whose products are measured: first the squares.
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))

# How the products of pairs of components add up to the squares of each channel.
_OF_CHANNELS = np.stack([COMPONENTS[k] * COMPONENTS[m] * (1 if k == m else 2) for k, m in PAIRS])

# Neighbourhoods that are read of a large picture; at most half as many were seen in training.
MAX_SQUARES = 128

# Steps of 8 bits.
STEPS = np.float32(255)

# Shares of the cells of a neighbourhood, and of its blocks of cells, whose energies are described.
_QUANTILES = (0.1, 0.25, 0.5, 0.75, 0.9)
_QUANTILES_OF_BLOCKS = (0.0, 0.25)

# Shares of all cells, the most even ones, whose energies are described together.
EVEN_SHARES = (0.01, 0.05, 0.25)

# The share of them that shows the covariance of the noise.
_EVEN_SHARE = 0.25

# The share whose residuals are described, too.
_SHARE_OF_RESIDUALS = 0.05

# Shares of the blocks of a picture whose energies are described.
_SHARES_OF_BLOCKS = (0.01, 0.05, 0.2, 0.5)

# Cells where more of the samples are at a limit of the colours are not counted as even, since their noise is cut off.
_MAX_CUT_OFF = 0.05

# Energies of noise that is invisible in 8 bits, in units of a step of 8 bits; for logarithms.
FLOOR = 0.01

# A squared detail, in steps of 8 bits, below which a cell is constant: the least of 8-bit pictures is 1 / 4.
_CONSTANT = 0.01


@dataclass(frozen=True)
class Cells:
    """The details of one scale in P neighbourhoods of up to n cells and m blocks of cells."""

    products: Float32s  # mean products of the components' details in each cell, by `PAIRS`, shape (6, P, n)
    freedom: Float32s  # details in each cell, shape (P, n); 0: there is no cell
    blocks: (
        Float32s  # mean squares by component in blocks of cells, shape (3, P, m); infinite: there is no block
    )
    unevenness: Float32s  # energy of the next two scales around a cell, shape (P, n); infinite: not known
    cut_off: Float32s  # share of samples at a limit of the colours around a cell, shape (P, n)
    fourth: Float32s  # mean fourth power of the details by component, shape (P, 3)
    others: Float32s  # features that only this kind of neighbourhood has, shape (P, F)
    # Mean products of residuals, which are free of slopes, in each cell, shape (6, P, n); None: not measured.
    residuals: Float32s | None = None
    is_grid: bool = True

    @property
    def is_valid(self) -> Bools:
        """Which cells there are."""
        return self.freedom > 0


def describe(described: Float32s, cells: Sequence[Cells]) -> Float32s:
    """Return the features of each neighbourhood, shape (P, F)."""
    columns = [described]
    for own in cells:
        columns += _describe_scale(own)
    return np.concatenate(columns, axis=1).astype(np.float32)


def _describe_scale(cells: Cells) -> list[Float32s]:
    """Describe the details of one scale, by component; and by channel, how components vary together."""
    energy, valid = np.moveaxis(cells.products[:3], 0, 1), cells.is_valid[:, None]
    count = np.maximum(valid.sum(axis=2), 1)
    mean = np.maximum(energy.sum(axis=2, where=valid) / count, 1e-9)
    features = [
        *_quantiles(np.where(valid, energy, np.inf), _QUANTILES),
        *_quantiles(np.moveaxis(cells.blocks, 0, 1), _QUANTILES_OF_BLOCKS),
        log_deviation(mean),
        np.log2((cells.fourth + 1e-3) / (mean**2 + 1e-3)) / 4,
        np.sum(energy < _CONSTANT, axis=2, where=valid) / count,
        cells.others,
    ]
    if cells.residuals is not None:
        energy = np.moveaxis(cells.residuals[:3], 0, 1)
        features += _quantiles(np.where(valid, energy, np.inf), _QUANTILES[:-1])
        features.append(log_deviation(energy.sum(axis=2, where=valid) / count))
    return [*features, *_describe_quiet(cells)]


def _describe_quiet(cells: Cells) -> list[Float32s]:
    """Describe the quieter half of the cells: the energy of each channel, and the correlation of components."""
    total = np.where(cells.is_valid, cells.products[:3].sum(axis=0), np.inf)
    middle = np.maximum(cells.is_valid.sum(axis=1) - 1, 0) // 2
    median = np.take_along_axis(np.sort(total, axis=1), middle[:, None], axis=1)
    quiet = (total <= median) & cells.is_valid
    products = np.einsum("kpn,pn->pk", cells.products, quiet) / np.maximum(quiet.sum(axis=1), 1)[:, None]
    return [log_deviation(_variances_of_channels(products)), _correlations(products)]


def describe_even_cells(cells: Sequence[Cells]) -> Float32s:
    """Describe the most even cells and blocks of a picture at each scale, shape (F,).

    Cells are even where details of the next two scales are small. Independent noise is independent of these, so that
    its energy there is an unbiased estimate.
    """
    found = [np.log2([len(cells[0].freedom)])]
    for own in cells:
        known, whole = _known_cells(own)
        found.append(np.log2([1 + whole.sum()]))
        if own.is_grid:
            found += _describe_even(own, whole)
            continue
        found.append(np.array([whole.sum() / max(1, known.sum())]))
        found += _describe_even(own, whole)
        blocks = np.sort(own.blocks.reshape(3, -1), axis=1)
        found += [own[:, 0] for own in _quantiles(blocks[:, None], _SHARES_OF_BLOCKS)]
    found += [_even_by_neighbourhood(own, _known_cells(own)[1]) for own in cells]
    return np.concatenate(found).astype(np.float32)


def _even_by_neighbourhood(cells: Cells, whole: Bools) -> Float32s:
    """Describe the energy of components in the even quarter of each neighbourhood, which noise by place does not bias.

    That is its mean, median and lower quartile over the neighbourhoods, as logarithms of deviations, shape (9,).
    """
    some = whole.any(axis=1)
    if not some.any():
        return np.full(9, log_deviation(0))
    whole = whole[some]
    uneven = np.where(whole, cells.unevenness[some], np.inf)
    last = (_EVEN_SHARE * (whole.sum(axis=1) - 1)).astype(np.intp)
    limit = np.take_along_axis(np.sort(uneven, axis=1), last[:, None], axis=1)
    weights = cells.freedom[some] * ((uneven <= limit) & whole)
    energies = np.einsum("kpn,pn->kp", cells.products[:3, some], weights) / weights.sum(axis=1)
    parts = [energies.mean(axis=1), *np.quantile(energies, (0.5, 0.25), axis=1)]
    return np.concatenate([log_deviation(own) for own in parts])


def even_covariances(cells: Sequence[Cells], chosen: Bools, variances: Float64s) -> tuple[Float64s, Float64s]:
    """Return the covariance of components in the even cells of some neighbourhoods, shape (SCALES, 3, 3).

    It is divided by the relative variance of each neighbourhood, shape (P,). The second result is how many details of
    each component show it, shape (SCALES,).
    """
    found, counts = np.zeros((SCALES, 3, 3)), np.zeros(SCALES)
    for scale, own in enumerate(cells):
        whole = _known_cells(own, chosen[:, None])[1]
        if not whole.any():
            continue
        unevenness = (own.unevenness / variances[:, None])[whole]
        even = unevenness <= np.sort(unevenness)[int(_EVEN_SHARE * (len(unevenness) - 1))]
        products, freedom = (own.products / variances[:, None])[:, whole][:, even], own.freedom[whole][even]
        total = freedom.sum()
        found[scale] = symmetric(np.einsum("kn,n->k", products, freedom, dtype=np.float64) / total)
        counts[scale] = total
    return found, counts


def _known_cells(cells: Cells, chosen: Bools | bool = True) -> tuple[Bools, Bools]:
    """Return the cells whose unevenness is known, and the ones of them that were not cut off; (P, n) each."""
    valid = cells.is_valid & chosen
    known = valid & np.isfinite(cells.unevenness)
    known = known if known.any() else valid
    whole = known & (cells.cut_off <= _MAX_CUT_OFF)
    return known, whole if 4 * whole.sum() > _EVEN_SHARE * known.sum() else known


def _describe_even(cells: Cells, whole: Bools) -> list[Float32s]:
    """Describe the most even of some cells."""
    products, freedom, unevenness = cells.products[:, whole], cells.freedom[whole], cells.unevenness[whole]
    found, ranked = [], np.sort(unevenness)
    for share in EVEN_SHARES:
        residuals = cells.residuals if share == _SHARE_OF_RESIDUALS else None
        if not len(ranked):
            size = (9 if cells.is_grid else 14) + (0 if residuals is None else 9)
            found.append(np.full(size, log_deviation(0)))
            continue
        # Cells of one coarser cell are equally even: all of them count.
        even = unevenness <= ranked[int(share * (len(ranked) - 1))]
        own, weights = products[:, even], freedom[even]
        means = np.einsum("kn,n->k", own, weights)[None] / weights.sum()
        found += _variances_and_correlations(means)
        if not cells.is_grid:
            scatter = (np.square(own[:3]).mean(axis=1) + 1e-3) / (np.square(own[:3].mean(axis=1)) + 1e-3)
            around = np.minimum(unevenness[even], 1e6).mean()
            found.append(np.log2(scatter) / 4)
            found.append(np.array([log_deviation(around), np.mean(own[:3].sum(axis=0) < _CONSTANT)]))
        if residuals is not None:
            found += _variances_and_correlations(residuals[:, whole][:, even].mean(axis=1)[None])
    return [np.asarray(own, np.float32) for own in found]


def _variances_and_correlations(means: Float32s) -> list[Float32s]:
    """Describe mean products, shape (1, 6): variances of components and channels, correlations of components."""
    variances = [log_deviation(part[0]) for part in (means[:, :3], _variances_of_channels(means))]
    return [*variances, _correlations(means)[0]]


def symmetric(products: Array) -> Array:
    """Return matrices of products, shape (..., 3, 3)."""
    found = np.empty((*products.shape[:-1], 3, 3), products.dtype)
    for number, (one, other) in enumerate(PAIRS):
        found[..., one, other] = found[..., other, one] = products[..., number]
    return found


def _variances_of_channels(products: Float32s) -> Float32s:
    """Return the variances of channels, by the mean products of components, shape (P, 6)."""
    return np.asarray(np.einsum("pk,kc->pc", products, _OF_CHANNELS), np.float32)


def _correlations(products: Float32s) -> Float32s:
    """Return the correlations of three components by their mean products, shape (P, 6)."""
    deviations = np.sqrt(products[:, :3] + FLOOR)
    pairs = PAIRS[3:]
    both = np.stack([deviations[:, k] * deviations[:, m] for k, m in pairs], axis=1)
    return np.asarray(products[:, 3:] / both, np.float32)


def _quantiles(values: Float32s, shares: Sequence[float]) -> list[Float32s]:
    """Return quantiles along the last axis among finite values, as logarithms of deviations."""
    ordered = np.sort(values, axis=-1)
    last = np.isfinite(ordered).sum(axis=-1, keepdims=True) - 1
    places = np.maximum(np.rint(np.array(shares) * last), 0).astype(np.intp)
    picked = np.take_along_axis(ordered, places, axis=-1)
    return list(np.moveaxis(log_deviation(np.where(np.isfinite(picked), picked, 0)), -1, 0))


def log_deviation(variance: Array | float) -> Float32s:
    """Return log2 of deviations in steps of 8 bits, with a floor well below a step."""
    return np.asarray(np.log2(np.maximum(variance, 0) + FLOOR) / 2, np.float32)
