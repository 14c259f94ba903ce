"""The input of the network: features of each neighbourhood, and of the most even cells of all of them.

The orthonormal details of a neighbourhood at four scales hold independent noise with the same variance; textures and
filtered noise grow from scale to scale. Details are described for the mean of three channels and two differences of
channels, which are orthonormal as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Float32s
from beltrami_cli.flow.noise.cells import CellStatistics
from beltrami_cli.flow.noise.components import (
    CONSTANT,
    STEPS,
    correlations_of_components,
    log_deviation,
    log_quantiles,
    variances_of_channels,
)
from beltrami_cli.flow.noise.even_cells import EvenScale
from beltrami_cli.flow.noise.neighbourhoods import ThreeChannels

# Quantiles of the energies of cells in a neighbourhood, and of its blocks of cells, that are features.
_QUANTILES = (0.1, 0.25, 0.5, 0.75, 0.9)
_QUANTILES_OF_BLOCKS = (0.0, 0.25)


@dataclass(frozen=True)
class Features:
    """The input of the network for a surface with P neighbourhoods."""

    local: Float32s  # features of each neighbourhood, shape (P, F)
    quiet: Float32s  # log2 of the deviations of channels in quiet cells of each neighbourhood, shape (P, 3)
    even: Float32s  # features of the most even cells of all neighbourhoods, shape (G,)
    # log2 of the deviations of components in even cells, shape (SCALES, STATISTICS, 3)
    even_deviations: Float32s

    @classmethod
    def of(cls, channels: ThreeChannels) -> Features:
        local = [_without_scale(channels)]
        for cells in channels.cells:
            local += _of_scale(cells)
        scales = [EvenScale.of(cells) for cells in channels.cells]
        even = [
            np.log2([channels.neighbourhoods.count]),
            *(column for scale in scales for column in channels.neighbourhoods.even_features(scale)),
            *(scale.by_neighbourhood.ravel() for scale in scales),
        ]
        return cls(
            local=np.concatenate(local, axis=1).astype(np.float32),
            quiet=log_deviation(variances_of_channels(_quiet_products(channels.cells[0]))),
            even=np.concatenate(even).astype(np.float32),
            even_deviations=np.array([scale.deviations for scale in scales], np.float32),
        )


def _without_scale(channels: ThreeChannels) -> Float32s:
    """Return features of each neighbourhood that do not depend on the scale: levels, clipping, variance."""
    neighbourhoods, colours = channels.neighbourhoods, channels.colours
    levels = neighbourhoods.means(colours)
    variance = neighbourhoods.means(np.square(colours - levels[:, neighbourhoods.of_samples]))
    low, high = neighbourhoods.means(colours <= 0), neighbourhoods.means(colours >= STEPS)
    rows = [*levels / 64, *low, *high, *log_deviation(variance), *neighbourhoods.features(channels)]
    return np.stack(rows, axis=1).astype(np.float32)


def _of_scale(cells: CellStatistics) -> list[Float32s]:
    """Return features of one scale: energies by component and by channel, and correlations of components."""
    energy, valid = np.moveaxis(cells.products[:3], 0, 1), cells.is_valid[:, None]
    count = np.maximum(valid.sum(axis=2), 1)
    mean = np.maximum(energy.sum(axis=2, where=valid) / count, 1e-9)
    features = [
        *log_quantiles(np.where(valid, energy, np.inf), _QUANTILES),
        *log_quantiles(np.moveaxis(cells.blocks, 0, 1), _QUANTILES_OF_BLOCKS),
        log_deviation(mean),
        np.log2((cells.of_kind.mean_squares + 1e-3) / (mean**2 + 1e-3)) / 4,
        np.sum(energy < CONSTANT, axis=2, where=valid) / count,
        cells.of_kind.others,
    ]
    if cells.of_kind.residuals is not None:
        energy = np.moveaxis(cells.of_kind.residuals[:3], 0, 1)
        features += log_quantiles(np.where(valid, energy, np.inf), _QUANTILES[:-1])
        features.append(log_deviation(energy.sum(axis=2, where=valid) / count))
    quiet = _quiet_products(cells)
    return [*features, log_deviation(variances_of_channels(quiet)), correlations_of_components(quiet)]


def _quiet_products(cells: CellStatistics) -> Float32s:
    """Return the mean products of the quieter half of the cells of each neighbourhood, shape (P, 6)."""
    total = np.where(cells.is_valid, cells.products[:3].sum(axis=0), np.inf)
    middle = np.maximum(cells.is_valid.sum(axis=1) - 1, 0) // 2
    median = np.take_along_axis(np.sort(total, axis=1), middle[:, None], axis=1)
    quiet = (total <= median) & cells.is_valid
    sums = np.einsum("kpn,pn->pk", cells.products, quiet)
    return np.asarray(sums / np.maximum(quiet.sum(axis=1), 1)[:, None])
