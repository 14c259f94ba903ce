"""Statistics of details in small neighbourhoods, from which the noise model reads the noise.

The orthonormal details of a neighbourhood at four scales hold independent noise with the same variance; textures and
filtered noise grow from scale to scale. Details are described for the mean of three channels and two differences of
channels, which are orthonormal as well.

`neighbourhoods` measures the details of cells. It sorts channels by the energy of their finest details, so that
features do not depend on the order of the input.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
_SHARE_OF_COVARIANCES = 0.25

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
class EvenCells:
    """The k most even ones of the measured cells of one scale."""

    products: Float32s  # as in `Cells`, shape (6, k)
    freedom: Float32s  # shape (k,)
    unevenness: Float32s  # shape (k,)
    residuals: Float32s | None  # as in `KindStatistics`, shape (6, k); None: not a feature

    @classmethod
    def of(cls, cells: Cells, measured: Bools, share: float) -> EvenCells:
        """Choose a share of the cells in the mask `measured`."""
        unevenness = cells.unevenness[measured]
        residuals = cells.of_kind.residuals if share == _SHARE_OF_RESIDUALS else None
        # Cells within one coarser cell are equally even, so ties are included.
        even = unevenness <= np.sort(unevenness)[int(share * (len(unevenness) - 1))]
        return cls(
            cells.products[:, measured][:, even],
            cells.freedom[measured][even],
            unevenness[even],
            None if residuals is None else residuals[:, measured][:, even],
        )


@dataclass(frozen=True)
class EvenFeatures:
    """The features of even cells that the network of a kind of neighbourhoods reads, in the order of its input."""

    # Of the masks of known and of measured cells, of each share of the most even cells, and of the blocks.
    of_masks: tuple[Callable[[Bools, Bools], list[Array]], ...]
    of_shares: tuple[Callable[[EvenCells], list[Array]], ...]
    of_blocks: tuple[Callable[[Float32s], list[Array]], ...]


@dataclass(frozen=True)
class KindStatistics:
    """Statistics of one scale that each kind of neighbourhoods measures in its own way."""

    fourth: Float32s  # mean fourth power of the details by component, shape (P, 3)
    others: Float32s  # features that only this kind of neighbourhood has, shape (P, F)
    even: EvenFeatures
    # Share of clipped samples around each cell, shape (P, n); None: not measured.
    clipped: Float32s | None = None
    # Mean products of residuals, which are free of slopes, in each cell, shape (6, P, n); None: not measured.
    residuals: Float32s | None = None


@dataclass(frozen=True)
class Cells:
    """The details of one scale in P neighbourhoods of up to n cells and m blocks of cells."""

    products: Float32s  # mean products of the components' details in each cell, by `PAIRS`, shape (6, P, n)
    freedom: Float32s  # details in each cell, shape (P, n); 0: no cell
    blocks: Float32s  # mean squares by component in blocks of cells, shape (3, P, m); infinite: no block
    unevenness: Float32s  # energy of the next two scales around a cell, shape (P, n); infinite: unknown
    of_kind: KindStatistics

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
        np.log2((cells.of_kind.fourth + 1e-3) / (mean**2 + 1e-3)) / 4,
        np.sum(energy < _CONSTANT, axis=2, where=valid) / count,
        cells.of_kind.others,
    ]
    if cells.of_kind.residuals is not None:
        energy = np.moveaxis(cells.of_kind.residuals[:3], 0, 1)
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
        even, (known, measured) = scale.of_kind.even, _known_cells(scale)
        by_share = [_describe_even(scale, measured, share) for share in EVEN_SHARES]
        features += [column for feature in even.of_masks for column in feature(known, measured)]
        features += [column for columns in by_share for column in columns]
        features += [column for feature in even.of_blocks for column in feature(scale.blocks)]
        by_place.append(_even_by_neighbourhood(scale, measured))
        deviations.append([*(columns[0] for columns in by_share), *by_place[-1]])
    features += [statistics.ravel() for statistics in by_place]
    return np.concatenate(features).astype(np.float32), np.array(deviations, np.float32)


def _even_by_neighbourhood(cells: Cells, measured: Bools) -> Float32s:
    """Return features of the even quarter of each neighbourhood, which are unbiased if noise depends on the place.

    They are the mean, median and lower quartile of the energy of components over the neighbourhoods, as logarithms of
    deviations, shape (3, 3).
    """
    has_even = measured.any(axis=1)
    if not has_even.any():
        return np.full((3, 3), log_deviation(0))
    measured = measured[has_even]
    uneven = np.where(measured, cells.unevenness[has_even], np.inf)
    last = (_SHARE_OF_COVARIANCES * (measured.sum(axis=1) - 1)).astype(np.intp)
    limit = np.take_along_axis(np.sort(uneven, axis=1), last[:, None], axis=1)
    weights = cells.freedom[has_even] * ((uneven <= limit) & measured)
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
        measured = _known_cells(cells, chosen[:, None])[1]
        if not measured.any():
            continue
        unevenness = (cells.unevenness / variances[:, None])[measured]
        even = unevenness <= np.sort(unevenness)[int(_SHARE_OF_COVARIANCES * (len(unevenness) - 1))]
        products, freedom = (
            (cells.products / variances[:, None])[:, measured][:, even],
            cells.freedom[measured][even],
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
    if cells.of_kind.clipped is None:
        return known, known
    measured = known & (cells.of_kind.clipped <= _MAX_CLIPPED)
    return known, measured if 4 * measured.sum() > _SHARE_OF_COVARIANCES * known.sum() else known


def _describe_even(cells: Cells, measured: Bools, share: float) -> list[Float32s]:
    """Return features of a share of the cells in the mask `measured`, the most even ones; deviations come first."""
    is_empty = not measured.any()
    # All features of no cells have the value of no noise, in as many columns as any cells have.
    even = EvenCells.of(cells, np.ones_like(measured) if is_empty else measured, share)
    columns = [column for feature in cells.of_kind.even.of_shares for column in feature(even)]
    return [
        np.full_like(own, log_deviation(0), np.float32) if is_empty else own.astype(np.float32)
        for own in columns
    ]


def _count(known: Bools, measured: Bools) -> list[Array]:
    return [np.log2([1 + measured.sum()])]


def _share_measured(known: Bools, measured: Bools) -> list[Array]:
    return [np.array([measured.sum() / max(1, known.sum())])]


def _noise(even: EvenCells) -> list[Array]:
    sums = np.einsum("kn,n->k", even.products, even.freedom)
    return _deviations_and_correlations(sums[None] / np.maximum(even.freedom.sum(), 1))


def _scatter(even: EvenCells) -> list[Array]:
    energies = even.products[:3]
    scatter = (np.square(energies).mean(axis=1) + 1e-3) / (np.square(energies.mean(axis=1)) + 1e-3)
    return [np.log2(scatter) / 4]


def _surroundings(even: EvenCells) -> list[Array]:
    around = np.minimum(even.unevenness, 1e6).mean()
    return [np.array([log_deviation(around), np.mean(even.products[:3].sum(axis=0) < _CONSTANT)])]


def _noise_of_residuals(even: EvenCells) -> list[Array]:
    return [] if even.residuals is None else _deviations_and_correlations(even.residuals.mean(axis=1)[None])


def _energies_of_blocks(blocks: Float32s) -> list[Array]:
    ordered = np.sort(blocks.reshape(3, -1), axis=1)
    return [quantile[:, 0] for quantile in _quantiles(ordered[:, None], _SHARES_OF_BLOCKS)]


EVEN_FEATURES_OF_GRIDS = EvenFeatures(of_masks=(_count,), of_shares=(_noise,), of_blocks=())
EVEN_FEATURES_OF_CLUSTERS = EvenFeatures(
    of_masks=(_count, _share_measured),
    of_shares=(_noise, _scatter, _surroundings, _noise_of_residuals),
    of_blocks=(_energies_of_blocks,),
)


def _deviations_and_correlations(means: Float32s) -> list[Array]:
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
