"""Noisy pictures as the network sees them, with what it should read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import features
from features import SCALES, SIDE
from network import OFFSET
from noises import Sample, degrade, draw_recipe
from pictures import Crop, drawn, varied

SIDES = (32, 48, 64, 96, 128, 192, 256)
SHARES = (0.06, 0.06, 0.14, 0.22, 0.24, 0.2, 0.08)
MAX_SQUARES = 64  # of a picture
# Of the variance of independent noise, at each scale, the last with the mean that is left.
OF_SCALES = np.array([0.75, 0.1875, 0.046875, 0.015625])
MIN_BLOCKS = 4  # of a level, for its noise to be known
CORRELATED = 1.0  # noise from which its correlation is to be read, in steps of 8 bits


@dataclass(frozen=True)
class Observation:
    """The features of a picture, and the truth; what is not known is NaN."""

    squares: np.ndarray  # (P, F)
    even: np.ndarray  # (F,)
    levels: np.ndarray  # (3, F)
    total: float
    deviations: np.ndarray  # (SCALES * 3,)
    correlations: np.ndarray  # (SCALES * 3,)
    by_level: np.ndarray  # (3, LEVEL_BINS)
    by_square: np.ndarray  # (P,)


def random_observation(rng: np.random.Generator, crops: list[Crop]) -> Observation | None:
    """Make one for training."""
    crop = crops[rng.integers(len(crops))]
    recipe, side = draw_recipe(rng), int(rng.choice(SIDES, p=SHARES))
    wanted = int(np.ceil(side / min(1, recipe.resampled * recipe.after_codec))) + 8
    clean = varied(rng, drawn(rng, _part_of(rng, crop.pixels, wanted)))
    sample = degrade(rng, clean, recipe)
    top, left = (int(rng.integers(9)) if rng.random() < 0.3 else 0 for _ in range(2))
    filled = np.ones((side, side), bool)
    if rng.random() < 0.15:  # a chart of an atlas
        y, x = np.mgrid[:side, :side] / side - rng.uniform(0.3, 0.7, 2)[:, None, None]
        filled = (
            np.abs(x * rng.uniform(1, 2.5)) ** rng.uniform(0.7, 3) + np.abs(y * rng.uniform(1, 2.5)) ** 2
            < 0.25
        )
    return observe(_window(sample, top, left, side), filled)


def _part_of(rng, pixels, side):
    top, left = (int(rng.integers(max(1, size - side + 1))) for size in pixels.shape[:2])
    return pixels[top : top + side, left : left + side]


def _window(sample: Sample, top: int, left: int, side: int) -> Sample:
    return Sample(
        *(own[top : top + side, left : left + side] for own in (sample.noisy, sample.noise, sample.loss))
    )


def observe(sample: Sample, filled: np.ndarray | None = None) -> Observation | None:
    """Observe a picture, or return None where too little of it is filled."""
    planes = np.moveaxis(sample.noisy, 2, 0)
    filled = (
        np.ones(planes.shape[1:], bool) if filled is None else filled[: planes.shape[1], : planes.shape[2]]
    )
    corners = features.choose_corners(filled, MAX_SQUARES)
    if not len(corners):
        return None
    squares = features.cut_squares(planes, filled, corners)
    details = squares.details()
    described = features.describe(squares, details)
    blocks = features.blocks_of(squares, details)
    noise, loss = (
        features.cut_squares(np.moveaxis(own, 2, 0), filled, corners, squares.order)
        for own in (sample.noise, sample.loss)
    )
    of_noise, of_loss = (own.details() for own in (noise, loss))
    pairs = list(zip(of_noise, of_loss, strict=True))[:SCALES]
    covariances = np.stack([_covariance(noisy) - _covariance(lost) for noisy, lost in pairs])
    if np.isnan(covariances[0]).any() or noise.is_filled.sum() < SIDE**2 / 4:
        return None
    known = np.where(np.isnan(covariances), covariances[0], covariances)
    total = max(0.0, float(np.einsum("l,lkk->", OF_SCALES, known)) / 3)
    variances = np.einsum("lkk->lk", covariances).clip(0, None)
    deviations = np.sqrt(variances)
    pairs = [
        covariances[:, a, b] / np.maximum(deviations[:, a] * deviations[:, b], 1e-6)
        for a, b in ((0, 1), (0, 2), (1, 2))
    ]
    least = np.minimum(np.minimum(deviations[:, 0], deviations[:, 1]), deviations[:, 2])
    largest = deviations.max(axis=1)
    correlations = np.where(
        (largest > CORRELATED)[:, None] & (least > 0.05)[:, None], np.stack(pairs, axis=1).clip(-1, 1), np.nan
    )
    by_level = _by_level(
        blocks.levels, *(features.blocks_of(*own).energies for own in ((noise, of_noise), (loss, of_loss)))
    )
    return Observation(
        described, features.describe_even_cells(details), features.describe_levels(blocks), logged(total),
        logged(variances).ravel(), correlations.ravel(), by_level, _by_square(of_noise, of_loss),
    )  # fmt: skip


def logged(variance):
    """Return what the network reads of a variance."""
    return np.log2(np.sqrt(np.maximum(variance, 0)) + OFFSET)


def _covariance(details: features.Details) -> np.ndarray:
    """Return the covariance of components; NaN where there are no cells."""
    values, count = details.by_component(), details.is_valid.sum()
    if not count:
        return np.full((3, 3), np.nan)
    return np.einsum("pkdij,pldij->kl", values, values, dtype=np.float64) / (3 * count)


def _by_level(level, energy, lost) -> np.ndarray:
    """Return the noise of the channels in each bin of their level."""
    found = np.full((3, features.LEVEL_BINS), np.nan)
    for channel in range(3):
        bins = features.level_bins(level[channel])
        counts = np.bincount(bins, minlength=features.LEVEL_BINS)
        sums = np.bincount(bins, energy[channel] - lost[channel], features.LEVEL_BINS)
        enough = counts >= MIN_BLOCKS
        found[channel, enough] = logged(sums[enough] / counts[enough])
    return found


def _by_square(noise, loss) -> np.ndarray:
    """Return the noise of each square, in the finer two scales."""
    count, total = 0, 0
    for own, lost in zip(noise[:2], loss[:2], strict=True):
        total = (
            total
            + np.square(own.values).sum(axis=(1, 2, 3, 4))
            - np.square(lost.values).sum(axis=(1, 2, 3, 4))
        )
        count = count + 9 * own.is_valid.sum(axis=(1, 2))
    return np.where(count > 0, logged(total / np.maximum(count, 1)), np.nan)
