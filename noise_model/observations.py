"""Training observations: features of noisy pictures, with the true noise."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from beltrami_cli.flow.noise.cells import CellStatistics
from beltrami_cli.flow.noise.components import symmetric
from beltrami_cli.flow.noise.features import Features
from beltrami_cli.flow.noise.grid_squares import SIDE, Grid
from beltrami_cli.flow.noise.neighbourhoods import Neighbourhoods, ThreeChannels
from beltrami_cli.flow.noise.network import log_of
from crops import Crop
from noises import Sample, degrade, of_one_channel
from pictures import Picture, random_picture
from recipes import Recipe, draw_recipe, draw_recipe_of_textures

Draw = Callable[[np.random.Generator], Recipe]

SIDES = (32, 48, 64, 96, 128, 192, 256)  # texels per side of a picture
SHARES = (0.06, 0.06, 0.14, 0.22, 0.24, 0.2, 0.08)  # of pictures, by side
MAX_SQUARES = 64  # per picture
ONE_CHANNEL = 0.12  # share of the pictures that have one channel, or are grey
HARD = 0.2  # share of the pictures with noise of `draw_recipe_of_textures`
# Shares of the scales in the variance of independent noise. The last value is the share of the remaining means.
OF_SCALES = np.array([0.75, 0.1875, 0.046875, 0.015625])
FEWEST_DETAILS = 3 * SIDE**2 / 16  # minimum number of details of the finest cells in a picture
# Minimum noise of the loudest and of the quietest component whose correlation is trained, in 8-bit steps.
CORRELATED, MIN_DEVIATION = 1.0, 0.05


class NoisyChannels(NamedTuple):
    """Noisy colours in neighbourhoods, their noise, and the error of compression alone; None: there is none."""

    noisy: ThreeChannels
    noise: ThreeChannels | None
    loss: ThreeChannels | None


@dataclass(frozen=True)
class Observation:
    """The features of a picture, and the true noise; unknown values are NaN."""

    features: Features
    total: float
    deviations: np.ndarray  # (SCALES * 3,)
    correlations: np.ndarray  # (SCALES * 3,)
    by_square: np.ndarray  # (P,)


def draw_recipe_of_grids(rng: np.random.Generator) -> Recipe:
    return draw_recipe_of_textures(rng) if rng.random() < HARD else draw_recipe(rng)


def random_samples(
    rng: np.random.Generator, crops: list[Crop], draw: Draw, picture: Picture = random_picture
) -> NoisyChannels | None:
    """Draw noisy colours on a grid."""
    crop = crops[rng.integers(len(crops))]
    recipe, side = draw(rng), int(rng.choice(SIDES, p=SHARES))
    wanted = int(np.ceil(side / min(1, recipe.resampled * recipe.after_codec))) + 8
    clean = picture(rng, _part_of(rng, crop.pixels, wanted))
    if rng.random() < ONE_CHANNEL:
        clean, recipe = of_one_channel(clean, recipe)
    sample = degrade(rng, clean, recipe)
    top, left = (int(rng.integers(9)) if rng.random() < 0.3 else 0 for _ in range(2))
    filled = np.ones((side, side), bool)
    if rng.random() < 0.15:  # a chart of an atlas
        y, x = np.mgrid[:side, :side] / side - rng.uniform(0.3, 0.7, 2)[:, None, None]
        filled = (
            np.abs(x * rng.uniform(1, 2.5)) ** rng.uniform(0.7, 3) + np.abs(y * rng.uniform(1, 2.5)) ** 2
            < 0.25
        )
    return in_squares(sample.mapped(lambda planes: planes[top : top + side, left : left + side]), filled)


def _part_of(rng: np.random.Generator, pixels: np.ndarray, side: int) -> np.ndarray:
    top, left = (int(rng.integers(max(1, size - side + 1))) for size in pixels.shape[:2])
    return pixels[top : top + side, left : left + side]


def in_squares(sample: Sample, filled: np.ndarray) -> NoisyChannels | None:
    """Cut noisy colours into squares; None if no square is filled."""
    rows, columns = sample.noisy.shape[:2]
    filled = filled[:rows, :columns]
    return cut_into(Grid.of(filled, MAX_SQUARES), sample) if filled.any() else None


def cut_into(neighbourhoods: Neighbourhoods, sample: Sample) -> NoisyChannels | None:
    """Cut noisy colours into neighbourhoods; None if there are none."""
    if not neighbourhoods.count:
        return None
    planes = sample.mapped(lambda colours: np.moveaxis(colours, -1, 0).astype(np.float32))
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
            triples = zip(products, part.where.scales, part.products, strict=False)
            products = [total + sign * scale.padded(own) for total, scale, own in triples]
    truths = [dataclasses.replace(own, products=part) for own, part in zip(cells, products, strict=True)]
    covariances = np.stack([covariance_of(own) for own in truths])
    if np.isnan(covariances[0]).any() or cells[0].freedom.sum() < FEWEST_DETAILS:
        return None
    known = np.where(np.isnan(covariances), covariances[0], covariances)
    total = max(0.0, float(np.einsum("l,lkk->", OF_SCALES, known)) / 3)
    variances = np.einsum("lkk->lk", covariances).clip(0, None)
    return Observation(
        Features.of(seen), log_of(total), log_of(variances).ravel(), _correlations(covariances).ravel(),
        _by_square(truths),
    )  # fmt: skip


def _correlations(covariances: np.ndarray) -> np.ndarray:
    """Return the correlations of components by scale, shape (SCALES, 3); NaN where there is too little noise."""
    deviations = np.sqrt(np.einsum("lkk->lk", covariances).clip(0, None))
    pairs = [
        covariances[:, a, b] / np.maximum(deviations[:, a] * deviations[:, b], 1e-6)
        for a, b in ((0, 1), (0, 2), (1, 2))
    ]
    is_known = (deviations.max(axis=1) > CORRELATED) & (deviations.min(axis=1) > MIN_DEVIATION)
    return np.where(is_known[:, None], np.stack(pairs, axis=1).clip(-1, 1), np.nan)


def covariance_of(cells: CellStatistics) -> np.ndarray:
    """Return the covariance of the components, shape (3, 3); NaN where there are no cells."""
    total = cells.freedom.sum(dtype=np.float64)
    if not total:
        return np.full((3, 3), np.nan)
    return symmetric(np.einsum("kpn,pn->k", cells.products, cells.freedom, dtype=np.float64) / total)


def _by_square(noise: list[CellStatistics]) -> np.ndarray:
    """Return the noise of each neighbourhood in the finest two scales, as log2(deviation + OFFSET)."""
    total = sum(np.einsum("kpn,pn->p", own.products[:3], own.freedom) for own in noise[:2])
    count = 3 * sum(own.freedom.sum(axis=1) for own in noise[:2])
    return np.where(count > 0, log_of(total / np.maximum(count, 1)), np.nan)
