"""Training observations: features of noisy images, with the true noise."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from beltrami_cli.flow.noise.cells import CellStatistics
from beltrami_cli.flow.noise.components import covariance_of_cells, log_reading, symmetric
from beltrami_cli.flow.noise.features import Features
from beltrami_cli.flow.noise.grid_squares import SIDE
from beltrami_cli.flow.noise.neighbourhoods import Neighbourhoods, ThreeChannels
from noises import NoisyColours

MIN_DETAILS = 3 * SIDE**2 / 16  # minimum number of details of the finest cells in an image
# Minimum noise of the loudest and of the quietest component whose correlation is trained, in 8-bit steps.
MIN_LOUDEST, MIN_QUIETEST = 1.0, 0.05


class NoisyChannels(NamedTuple):
    """Noisy colours in neighbourhoods, their noise, and the error of compression alone; None: there is none."""

    noisy: ThreeChannels
    noise: ThreeChannels | None
    loss: ThreeChannels | None


@dataclass(frozen=True)
class Observation:
    """The features of an image, and the true noise; unknown values are NaN."""

    features: Features
    total: float
    deviations: np.ndarray  # (SCALES * 3,)
    correlations: np.ndarray  # (SCALES * 3,)
    places: np.ndarray  # of each neighbourhood, (P,)


def cut_into(neighbourhoods: Neighbourhoods, colours: NoisyColours) -> NoisyChannels | None:
    """Cut noisy colours into neighbourhoods; None if there are none."""
    if not neighbourhoods.count:
        return None
    planes = colours.mapped(lambda rows: np.moveaxis(rows, -1, 0).astype(np.float32))
    seen = neighbourhoods.cut(planes.noisy)
    noise, loss = (
        neighbourhoods.cut(part, seen.order) if part.any() else None for part in (planes.noise, planes.loss)
    )
    return NoisyChannels(seen, noise, loss)


def observation_of(channels: NoisyChannels) -> Observation | None:
    """Describe noisy colours and their noise; None if there are too few details."""
    seen, noise, loss = channels
    cells = seen.cells
    products = [0.0 * own.products for own in cells]
    for part, sign in ((noise, 1), (loss, -1)):
        if part is not None:
            triples = zip(products, part.scales, part.products, strict=False)
            products = [total + sign * scale.padded(own) for total, scale, own in triples]
    truths = [dataclasses.replace(own, products=part) for own, part in zip(cells, products, strict=True)]
    covariances = np.stack([covariance_of(own) for own in truths])
    if np.isnan(covariances[0]).any() or cells[0].freedom.sum() < MIN_DETAILS:
        return None
    known = np.where(np.isnan(covariances), covariances[0], covariances)
    total = max(0.0, float(np.trace(covariance_of_cells(known))) / 3)
    variances = np.einsum("lkk->lk", covariances).clip(0, None)
    return Observation(
        features=Features.of(seen),
        total=float(log_reading(total)),
        deviations=log_reading(variances).ravel(),
        correlations=_correlations(covariances).ravel(),
        places=_by_neighbourhood(truths),
    )


def _correlations(covariances: np.ndarray) -> np.ndarray:
    """Return the correlations of components by scale, shape (SCALES, 3); NaN where there is too little noise."""
    deviations = np.sqrt(np.einsum("lkk->lk", covariances).clip(0, None))
    pairs = [
        covariances[:, a, b] / np.maximum(deviations[:, a] * deviations[:, b], 1e-6)
        for a, b in ((0, 1), (0, 2), (1, 2))
    ]
    is_known = (deviations.max(axis=1) > MIN_LOUDEST) & (deviations.min(axis=1) > MIN_QUIETEST)
    return np.where(is_known[:, None], np.stack(pairs, axis=1).clip(-1, 1), np.nan)


def covariance_of(cells: CellStatistics) -> np.ndarray:
    """Return the covariance of the components, shape (3, 3); NaN where there are no cells."""
    total = cells.freedom.sum(dtype=np.float64)
    if not total:
        return np.full((3, 3), np.nan)
    return symmetric(np.einsum("kpn,pn->k", cells.products, cells.freedom, dtype=np.float64) / total)


def _by_neighbourhood(noise: list[CellStatistics]) -> np.ndarray:
    """Return the noise of each neighbourhood in the finest two scales, as log2(deviation + OFFSET)."""
    total = sum(np.einsum("kpn,pn->p", own.products[:3], own.freedom) for own in noise[:2])
    count = 3 * sum(own.freedom.sum(axis=1) for own in noise[:2])
    return np.where(count > 0, log_reading(total / np.maximum(count, 1)), np.nan)
