"""Judge the network on pictures that it has not seen, by kind of noise.

``python noise_model/table.py FOLDER...`` prints, for each kind, the mean absolute log2 of the ratio of reading and
truth, and the share of readings within 30 %; of clean pictures, how many are read as more than 4 of 255, and the
largest reading. The truth is the root mean square of the noise before it was cut off at black and white.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

import pictures
from network import OFFSET, Weights
from noises import Recipe, Sample, degrade
from reading import Grid, estimate_noise

SIDE, CASES, SEED = 192, 44, 7
LEAST_NOISE = 4 / 255  # of which clean pictures must not be read


def _log(rng, low, high):
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _camera(rng, method="bilinear", **others):
    shot, read = _log(rng, 0.002, 0.03), rng.uniform(0.005, 0.02)
    sigma = float(np.sqrt(shot / 2 + read**2))  # at half the light
    return Recipe(sigma, power=1, floor=read / sigma, is_linear=True, mosaic=method, **others)


KINDS: dict[str, Callable[[np.random.Generator], Recipe]] = {
    "white, sigma 2 to 50": lambda rng: Recipe(_log(rng, 2, 50) / 255),
    "camera (shot and read noise, mosaic, sRGB)": _camera,
    "grain of 1.3 to 5 texels": lambda rng: Recipe(
        _log(rng, 2, 25) / 255, grain=rng.uniform(1.3, 5), kernel=int(rng.integers(3))
    ),
    "white, then JPEG 60 to 98": lambda rng: Recipe(
        _log(rng, 2, 30) / 255, codec="JPEG", quality=int(rng.integers(60, 99))
    ),
    "camera, then JPEG 75 to 98": lambda rng: _camera(rng, codec="JPEG", quality=int(rng.integers(75, 99))),
    "enlarged 1.2 to 2.5 times": lambda rng: Recipe(
        _log(rng, 3, 40) / 255, resampled=rng.uniform(1.2, 2.5), kernel=int(rng.integers(2))
    ),
    "white, equal in all channels": lambda rng: Recipe(_log(rng, 2, 40) / 255, correlation=1),
    "white, channels correlated by 0.7": lambda rng: Recipe(_log(rng, 2, 40) / 255, correlation=0.7),
    "baked light: heavy tails, grows with light, equal": lambda rng: Recipe(
        _log(rng, 0.02, 0.2), 2, 0, 1, tail="gamma", shape=_log(rng, 2, 20), is_linear=True
    ),
    "camera, Malvar mosaic, sharpened": lambda rng: _camera(rng, "malvar", sharpened=rng.uniform(0.4, 1.5)),
    "two exposures blended": lambda rng: Recipe(
        _log(rng, 4, 40) / 255, places="blend", place_gain=rng.uniform(0.1, 0.6)
    ),
    "half of the picture noisy": lambda rng: Recipe(_log(rng, 4, 40) / 255, places="halves", place_gain=0.2),
    "residue of a low-pass filter": lambda rng: Recipe(
        _log(rng, 2, 20) / 255, spectrum=rng.uniform(0.15, 0.6), correlation=0.5
    ),
    "none": lambda rng: Recipe(),
    "none, but JPEG": lambda rng: Recipe(codec="JPEG", quality=int(rng.integers(50, 99))),
}


def cases(crops: list[pictures.Crop], kind: str) -> Iterator[Sample]:
    """Yield noisy pictures of a kind."""
    rng = np.random.default_rng([SEED, list(KINDS).index(kind)])
    large = [crop for crop in crops if min(crop.pixels.shape[:2]) >= SIDE]
    for number in rng.permutation(len(large))[: CASES * (4 if kind.startswith("none") else 1)]:
        clean = large[number].pixels[:SIDE, :SIDE] / np.float32(255)
        made = degrade(rng, clean, KINDS[kind](rng))
        yield Sample(*(own[:SIDE, :SIDE] for own in (made.noisy, made.noise, made.loss)))


def truth_of(sample: Sample) -> float:
    """Return the root mean square of the noise."""
    return float(np.sqrt(max(0.0, np.mean(sample.noise**2) - np.mean(sample.loss**2))))


def shipped_reading(planes: np.ndarray) -> float:
    """Return what the rules read that this model replaces."""
    from beltrami_cli.flow.noise.by_place import find_relative_noise
    from beltrami_cli.flow.noise.grid_scales import estimate_sigma_on_grid, find_grid_noise
    from beltrami_cli.flow.noise.haar_noise import sigma_of_covariances

    planes, filled = planes.copy(), np.ones(planes.shape[1:], bool)
    differs = find_relative_noise(planes, filled)
    found = find_grid_noise(
        planes, filled, by_level=True, relative=None if differs is None else differs[0][None]
    )
    if found.stabiliser is not None:
        found.stabiliser.stabilise(planes)
    sigma = estimate_sigma_on_grid(planes, filled)
    if differs is not None:
        sigma = np.minimum(sigma, differs[2]) * differs[1]
    sigma = (
        np.minimum(sigma, found.most)
        if found.covariances is None
        else sigma_of_covariances(found.covariances)
    )
    return float(np.sqrt(np.mean(sigma**2))) * (1 if found.stabiliser is None else found.stabiliser.growth)


def judged(readings: np.ndarray, truths: np.ndarray, is_clean: bool) -> str:
    """Return a cell of the table."""
    if is_clean:
        return f"{np.mean(readings > LEAST_NOISE):.1%}; {255 * readings.max():.1f}"
    ratio = np.log2((255 * readings + OFFSET) / (255 * truths + OFFSET))
    return (
        f"{np.abs(ratio).mean():.2f} / {np.mean(np.abs(readings / np.maximum(truths, 1e-9) - 1) < 0.3):.0%}"
    )


def main(roots: list[Path], part: str, weights: Weights | None = None, *, with_shipped: bool = False) -> None:
    """Print the table."""
    crops, everything = pictures.clean_crops(roots, part, SEED), []
    print("| kind of noise | cases | shipped | model | 90 % interval holds |\n|---|---|---|---|---|")
    for kind in KINDS:
        rows = []
        for sample in cases(crops, kind):
            planes = np.ascontiguousarray(np.moveaxis(sample.noisy, 2, 0), np.float32)
            model = estimate_noise(planes, Grid(np.ones(planes.shape[1:], bool)), weights=weights)
            truth, shipped = truth_of(sample), shipped_reading(planes) if with_shipped else np.nan
            holds = model.interval[0] - OFFSET / 255 <= truth <= model.interval[1] + OFFSET / 255
            rows.append((truth, model.overall, shipped, holds))
        truths, readings, shipped, holds = np.array(rows).T
        is_clean = kind.startswith("none")
        own = [judged(each, truths, is_clean) for each in (shipped, readings)]
        print(f"| {kind} | {len(rows)} | {own[0]} | {own[1]} | {holds.mean():.0%} |", flush=True)
        if not is_clean:
            everything += rows
    truths, readings, shipped, holds = np.array(everything).T
    own = [judged(each, truths, False) for each in (shipped, readings)]
    print(f"| all noisy kinds | {len(everything)} | {own[0]} | {own[1]} | {holds.mean():.0%} |")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Judge the network that reads noise.")
    parser.add_argument("folders", nargs="+", type=Path, help="with pictures")
    parser.add_argument("--part", default="test", choices=["validation", "test"])
    parser.add_argument("--shipped", action="store_true", help="judge the rules that it replaces, too")
    options = parser.parse_args()
    main([*options.folders, *pictures.folders_of_packages()], options.part, with_shipped=options.shipped)
