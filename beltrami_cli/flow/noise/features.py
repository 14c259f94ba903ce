"""Statistics of details in small neighbourhoods, from which the noise model reads the noise.

The orthonormal details of a neighbourhood at four scales hold independent noise with the same variance; textures and
filtered noise grow from scale to scale. Details are described for the mean of three channels and two differences of
channels, which are orthonormal as well.

`neighbourhoods` measures the details of cells. It sorts channels by the energy of their finest details, so that
features do not depend on the order of the input.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s

SCALES = 4

# The mean of three channels and two differences, orthonormal.
COMPONENTS = (np.array([[1, 1, 1], [1, 0, -1], [1, -2, 1]]) / np.sqrt([[3], [2], [6]])).astype(np.float32)

# Pairs of components whose products are measured. Squares come first.
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))

# Weights by which products of component pairs add up to the square of each channel.
_OF_CHANNELS = np.stack([COMPONENTS[k] * COMPONENTS[m] * (1 if k == m else 2) for k, m in PAIRS])

# Number of 8-bit steps in full scale.
STEPS = np.float32(255)

# Quantiles of the energies of cells in a neighbourhood, and of its blocks of cells, that are features.
_QUANTILES = (0.1, 0.25, 0.5, 0.75, 0.9)
_QUANTILES_OF_BLOCKS = (0.0, 0.25)

# Shares of the most even cells of a picture whose mean energies are features.
EVEN_SHARES = (0.01, 0.05, 0.25)

# Share of the most even cells in which the covariance of the noise is measured.
_EVEN_SHARE = 0.25

# Share of the most even cells whose residuals are also features.
_SHARE_OF_RESIDUALS = 0.05

# Quantiles of the energies of blocks in a picture that are features.
_SHARES_OF_BLOCKS = (0.01, 0.05, 0.2, 0.5)

# Maximum share of clipped samples around an even cell. Clipping reduces the noise.
_MAX_CLIPPED = 0.05

# Energy that is added before a logarithm is taken, in squared 8-bit steps. Noise of this energy is invisible in 8 bits.
FLOOR = 0.01

# Energy below which a cell is constant, in squared 8-bit steps. The smallest squared detail of 8-bit pictures is 1 / 4.
_CONSTANT = 0.01


@dataclass(frozen=True)
class FurtherStatistics:
    """Statistics of one scale that only the network of clusters reads; the network of grids was trained without."""

    clipped: Float32s  # share of clipped samples around a cell, shape (P, n)
    # Mean products of residuals, which are free of slopes, in each cell, shape (6, P, n); None: not measured.
    residuals: Float32s | None


@dataclass(frozen=True)
class Cells:
    """The details of one scale in P neighbourhoods of up to n cells and m blocks of cells."""

    products: Float32s  # mean products of the components' details in each cell, by `PAIRS`, shape (6, P, n)
    freedom: Float32s  # details in each cell, shape (P, n); 0: no cell
    blocks: Float32s  # mean squares by component in blocks of cells, shape (3, P, m); infinite: no block
    unevenness: Float32s  # energy of the next two scales around a cell, shape (P, n); infinite: unknown
    fourth: Float32s  # mean fourth power of the details by component, shape (P, 3)
    others: Float32s  # features that only this kind of neighbourhood has, shape (P, F)
    further: FurtherStatistics | None

    @property
    def is_valid(self) -> Bools:
        """Mask of existing cells, shape (P, n)."""
        return self.freedom > 0


def describe(described: Float32s, cells: Sequence[Cells]) -> Float32s:
    """Return the features of each neighbourhood, shape (P, F)."""
    columns = [described]
    for scale in cells:
        columns += _describe_scale(scale)
    return np.concatenate(columns, axis=1).astype(np.float32)


def _describe_scale(cells: Cells) -> list[Float32s]:
    """Return features of one scale: energies by component and by channel, and correlations of components."""
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
    if cells.further is not None and cells.further.residuals is not None:
        energy = np.moveaxis(cells.further.residuals[:3], 0, 1)
        features += _quantiles(np.where(valid, energy, np.inf), _QUANTILES[:-1])
        features.append(log_deviation(energy.sum(axis=2, where=valid) / count))
    return [*features, quiet_deviations(cells), _correlations(_quiet_products(cells))]


def quiet_deviations(cells: Cells) -> Float32s:
    """Return log2 of the deviations of channels in the quieter half of each neighbourhood's cells, shape (P, 3)."""
    return log_deviation(_variances_of_channels(_quiet_products(cells)))


def _quiet_products(cells: Cells) -> Float32s:
    """Return the mean products of the quieter half of the cells of each neighbourhood, shape (P, 6)."""
    total = np.where(cells.is_valid, cells.products[:3].sum(axis=0), np.inf)
    middle = np.maximum(cells.is_valid.sum(axis=1) - 1, 0) // 2
    median = np.take_along_axis(np.sort(total, axis=1), middle[:, None], axis=1)
    quiet = (total <= median) & cells.is_valid
    sums = np.einsum("kpn,pn->pk", cells.products, quiet)
    return np.asarray(sums / np.maximum(quiet.sum(axis=1), 1)[:, None])


def describe_even_cells(cells: Sequence[Cells]) -> tuple[Float32s, Float32s]:
    """Return features of the most even cells and blocks of a picture, shape (F,), and the deviations among them.

    Cells are even where the details of the next two scales are small. The noise in a cell does not depend on these, so
    its energy in even cells is an unbiased estimate. Deviations, as log2, have the shape (SCALES, 6, 3): of components,
    by `EVEN_SHARES` of all cells, and by statistic over the neighbourhoods.
    """
    features, deviations, by_place = [np.log2([len(cells[0].freedom)])], [], []
    for scale in cells:
        known, whole = _known_cells(scale)
        features.append(np.log2([1 + whole.sum()]))
        if scale.further is not None:
            features.append(np.array([whole.sum() / max(1, known.sum())]))
        by_share = [_describe_even(scale, whole, share) for share in EVEN_SHARES]
        features += [column for columns in by_share for column in columns]
        if scale.further is not None:
            blocks = np.sort(scale.blocks.reshape(3, -1), axis=1)
            features += [quantile[:, 0] for quantile in _quantiles(blocks[:, None], _SHARES_OF_BLOCKS)]
        by_place.append(_even_by_neighbourhood(scale, whole))
        deviations.append([*(columns[0] for columns in by_share), *by_place[-1]])
    features += [statistics.ravel() for statistics in by_place]
    return np.concatenate(features).astype(np.float32), np.array(deviations, np.float32)


def _even_by_neighbourhood(cells: Cells, whole: Bools) -> Float32s:
    """Return features of the even quarter of each neighbourhood, which are unbiased if noise depends on the place.

    They are the mean, median and lower quartile of the energy of components over the neighbourhoods, as logarithms of
    deviations, shape (3, 3).
    """
    has_even = whole.any(axis=1)
    if not has_even.any():
        return np.full((3, 3), log_deviation(0))
    whole = whole[has_even]
    uneven = np.where(whole, cells.unevenness[has_even], np.inf)
    last = (_EVEN_SHARE * (whole.sum(axis=1) - 1)).astype(np.intp)
    limit = np.take_along_axis(np.sort(uneven, axis=1), last[:, None], axis=1)
    weights = cells.freedom[has_even] * ((uneven <= limit) & whole)
    energies = np.einsum("kpn,pn->kp", cells.products[:3, has_even], weights) / weights.sum(axis=1)
    parts = [energies.mean(axis=1), *np.quantile(energies, (0.5, 0.25), axis=1)]
    return np.stack([log_deviation(own) for own in parts])


def even_covariances(
    scales: Sequence[Cells], chosen: Bools, variances: Float64s
) -> tuple[Float64s, Float64s]:
    """Return the covariance of components in the even cells of some neighbourhoods, shape (SCALES, 3, 3).

    It is divided by the relative variance of each neighbourhood, shape (P,). The second result is the number of details
    by scale that it was measured from, shape (SCALES,).
    """
    covariances, counts = np.zeros((SCALES, 3, 3)), np.zeros(SCALES)
    for number, cells in enumerate(scales):
        whole = _known_cells(cells, chosen[:, None])[1]
        if not whole.any():
            continue
        unevenness = (cells.unevenness / variances[:, None])[whole]
        even = unevenness <= np.sort(unevenness)[int(_EVEN_SHARE * (len(unevenness) - 1))]
        products, freedom = (
            (cells.products / variances[:, None])[:, whole][:, even],
            cells.freedom[whole][even],
        )
        total = freedom.sum()
        covariances[number] = symmetric(np.einsum("kn,n->k", products, freedom, dtype=np.float64) / total)
        counts[number] = total
    return covariances, counts


def _known_cells(cells: Cells, chosen: Bools | bool = True) -> tuple[Bools, Bools]:
    """Return masks of shape (P, n): cells with a known unevenness, and the unclipped ones among them.

    A condition that too few cells meet is dropped.
    """
    valid = cells.is_valid & chosen
    known = valid & np.isfinite(cells.unevenness)
    known = known if known.any() else valid
    if cells.further is None:
        return known, known
    whole = known & (cells.further.clipped <= _MAX_CLIPPED)
    return known, whole if 4 * whole.sum() > _EVEN_SHARE * known.sum() else known


def _describe_even(cells: Cells, whole: Bools, share: float) -> list[Float32s]:
    """Return features of a share of the cells in the mask `whole`, the most even ones; deviations come first."""
    further = cells.further
    residuals = further.residuals if further is not None and share == _SHARE_OF_RESIDUALS else None
    products, freedom, unevenness = cells.products[:, whole], cells.freedom[whole], cells.unevenness[whole]
    if not len(unevenness):
        # As many columns as below: of channels and correlations, of clusters alone, and of residuals.
        others = 6 + (0 if further is None else 5) + (0 if residuals is None else 9)
        return [np.full(size, log_deviation(0)) for size in (3, others)]
    # Cells within one coarser cell are equally even, so ties are included.
    even = unevenness <= np.sort(unevenness)[int(share * (len(unevenness) - 1))]
    chosen, weights = products[:, even], freedom[even]
    features = _deviations_and_correlations(np.einsum("kn,n->k", chosen, weights)[None] / weights.sum())
    if further is not None:
        scatter = (np.square(chosen[:3]).mean(axis=1) + 1e-3) / (np.square(chosen[:3].mean(axis=1)) + 1e-3)
        around = np.minimum(unevenness[even], 1e6).mean()
        features.append(np.log2(scatter) / 4)
        features.append(np.array([log_deviation(around), np.mean(chosen[:3].sum(axis=0) < _CONSTANT)]))
    if residuals is not None:
        features += _deviations_and_correlations(residuals[:, whole][:, even].mean(axis=1)[None])
    return [np.asarray(column, np.float32) for column in features]


def _deviations_and_correlations(means: Float32s) -> list[Float32s]:
    """Return log2 of the deviations of components and channels, and correlations, from mean products, shape (1, 6)."""
    deviations = [log_deviation(part[0]) for part in (means[:, :3], _variances_of_channels(means))]
    return [*deviations, _correlations(means)[0]]


def symmetric(products: Array) -> Array:
    """Return symmetric matrices, shape (..., 3, 3), from products of `PAIRS`, shape (..., 6)."""
    matrices = np.empty((*products.shape[:-1], 3, 3), products.dtype)
    for number, (one, other) in enumerate(PAIRS):
        matrices[..., one, other] = matrices[..., other, one] = products[..., number]
    return matrices


def _variances_of_channels(products: Float32s) -> Float32s:
    """Return the variances of channels from the mean products of components, shape (P, 6)."""
    return np.asarray(np.einsum("pk,kc->pc", products, _OF_CHANNELS), np.float32)


def _correlations(products: Float32s) -> Float32s:
    """Return the correlations of three components from their mean products, shape (P, 6)."""
    deviations = np.sqrt(products[:, :3] + FLOOR)
    pairs = PAIRS[3:]
    both = np.stack([deviations[:, k] * deviations[:, m] for k, m in pairs], axis=1)
    return np.asarray(products[:, 3:] / both, np.float32)


def _quantiles(values: Float32s, shares: Sequence[float]) -> list[Float32s]:
    """Return quantiles of the finite values along the last axis, as logarithms of deviations."""
    ordered = np.sort(values, axis=-1)
    last = np.isfinite(ordered).sum(axis=-1, keepdims=True) - 1
    places = np.maximum(np.rint(np.array(shares) * last), 0).astype(np.intp)
    picked = np.take_along_axis(ordered, places, axis=-1)
    return list(np.moveaxis(log_deviation(np.where(np.isfinite(picked), picked, 0)), -1, 0))


def log_deviation(variance: Array | float) -> Float32s:
    """Return log2 of the deviation for a variance in squared 8-bit steps, with a floor far below one step."""
    return np.asarray(np.log2(np.maximum(variance, 0) + FLOOR) / 2, np.float32)
