"""The error of the network by kind of noise, as a table, on images that it was not trained on.

Cells have the mean absolute log2 of the ratio of reading and truth, and the share of readings within 30 %; of clean
images, how many are read as more than 4 of 255, and the largest reading. Kinds are judged on grids, and some on
surfaces. The truth is the RMS noise before clipping.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from beltrami_cli.flow.noise.components import OFFSET
from beltrami_cli.flow.noise.grid_squares import Grid
from beltrami_cli.flow.noise.neighbourhoods import Neighbourhoods
from beltrami_cli.flow.noise.reading import read_noise
from crops import clean_crops
from noises import NoisyColours, degrade
from recipes import Recipe
from surfaces import degrade_at_vertices, surface

SIDE, CASES, SEED = 192, 44, 7  # texels per side, and noisy images of each kind
FALSE_POSITIVE = 4 / 255  # reading from which a clean image counts as misread


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _camera(rng: np.random.Generator, method: str = "bilinear", **others: Any) -> Recipe:
    shot, read = _log_uniform(rng, 0.002, 0.03), rng.uniform(0.005, 0.02)
    sigma = float(np.sqrt(shot / 2 + read**2))  # at half the light
    return Recipe(sigma, power=1, floor=read / sigma, is_linear=True, mosaic=method, **others)


KINDS: dict[str, Callable[[np.random.Generator], Recipe]] = {
    "white, sigma 2 to 50": lambda rng: Recipe(_log_uniform(rng, 2, 50) / 255),
    "camera (shot and read noise, mosaic, sRGB)": _camera,
    "grain of 1.3 to 5 texels": lambda rng: Recipe(
        _log_uniform(rng, 2, 25) / 255, grain=rng.uniform(1.3, 5), kernel=int(rng.integers(3))
    ),
    "white, then JPEG 60 to 98": lambda rng: Recipe(
        _log_uniform(rng, 2, 30) / 255, codec="JPEG", quality=int(rng.integers(60, 99))
    ),
    "camera, then JPEG 75 to 98": lambda rng: _camera(rng, codec="JPEG", quality=int(rng.integers(75, 99))),
    "enlarged 1.2 to 2.5 times": lambda rng: Recipe(
        _log_uniform(rng, 3, 40) / 255, resampled=rng.uniform(1.2, 2.5), kernel=int(rng.integers(2))
    ),
    "white, equal in all channels": lambda rng: Recipe(_log_uniform(rng, 2, 40) / 255, correlation=1),
    "white, channels correlated by 0.7": lambda rng: Recipe(_log_uniform(rng, 2, 40) / 255, correlation=0.7),
    "baked light: heavy tails, grows with light, equal": lambda rng: Recipe(
        _log_uniform(rng, 0.02, 0.2), 2, 0, 1, tail="gamma", shape=_log_uniform(rng, 2, 20), is_linear=True
    ),
    "camera, Malvar mosaic, sharpened": lambda rng: _camera(rng, "malvar", sharpened=rng.uniform(0.4, 1.5)),
    "two exposures blended": lambda rng: Recipe(
        _log_uniform(rng, 4, 40) / 255, places="blend", place_gain=rng.uniform(0.1, 0.6)
    ),
    "half of the image noisy": lambda rng: Recipe(
        _log_uniform(rng, 4, 40) / 255, places="halves", place_gain=0.2
    ),
    "residue of a low-pass filter": lambda rng: Recipe(
        _log_uniform(rng, 2, 20) / 255, spectrum=rng.uniform(0.15, 0.6), correlation=0.5
    ),
    "none": lambda rng: Recipe(),
    "none, but JPEG": lambda rng: Recipe(codec="JPEG", quality=int(rng.integers(50, 99))),
}


# Kinds of noise on surfaces, and whether noise is added to vertices instead of the image that they sample.
KINDS_ON_SURFACES = {
    "white, sigma 2 to 50": True,
    "white, equal in all channels": True,
    "white, channels correlated by 0.7": True,
    "baked light: heavy tails, grows with light, equal": True,
    "half of the image noisy": True,
    "camera (shot and read noise, mosaic, sRGB)": False,
    "grain of 1.3 to 5 texels": False,
    "white, then JPEG 60 to 98": False,
    "camera, then JPEG 75 to 98": False,
    "none": True,
    "none, but JPEG": False,
}
# Numbers of these surfaces; training uses others.
SURFACES = range(1000, 1024)


def images_of(crops: list[np.ndarray], kind: str) -> Iterator[tuple[np.random.Generator, np.ndarray, Recipe]]:
    """Yield clean images and the recipes of noise of a kind."""
    rng = np.random.default_rng([SEED, list(KINDS).index(kind)])
    large = [crop for crop in crops if min(crop.shape[:2]) >= SIDE]
    for number in rng.permutation(len(large))[: CASES * (4 if kind.startswith("none") else 1)]:
        yield rng, large[number][:SIDE, :SIDE] / np.float32(255), KINDS[kind](rng)


def cases(crops: list[np.ndarray], kind: str) -> Iterator[tuple[Neighbourhoods, np.ndarray, NoisyColours]]:
    """Yield noisy grids of a kind: where they are read, their channels, and their noise."""
    for rng, clean, recipe in images_of(crops, kind):
        colours = degrade(rng, clean, recipe).mapped(lambda planes: planes[:SIDE, :SIDE])
        yield Grid.of(np.ones(colours.noisy.shape[:2], bool)), np.moveaxis(colours.noisy, 2, 0), colours


def cases_on_surfaces(
    crops: list[np.ndarray], kind: str
) -> Iterator[tuple[Neighbourhoods, np.ndarray, NoisyColours]]:
    """Yield noisy surfaces of a kind, with one sample per texel."""
    for number, (rng, clean, recipe) in enumerate(images_of(crops, kind)):
        clusters, places = surface(SURFACES[number % len(SURFACES)])
        side = int(np.clip(np.sqrt(len(places)), 16, SIDE))
        on_vertices = KINDS_ON_SURFACES[kind]
        colours = degrade_at_vertices(rng, clean[:side, :side], places, recipe, is_on_vertices=on_vertices)
        yield clusters, colours.noisy.reshape(-1, 3).T, colours


def truth_of(colours: NoisyColours) -> float:
    """Return the RMS noise, without the error of compression alone."""
    return float(np.sqrt(max(0.0, np.mean(colours.noise**2) - np.mean(colours.loss**2))))


def judged(readings: np.ndarray, truths: np.ndarray, is_clean: bool) -> str:
    """Return a cell of the table: errors of readings, or false readings of clean images."""
    if is_clean:
        return f"{np.mean(readings > FALSE_POSITIVE):.1%}; {255 * readings.max():.1f}"
    ratio = np.log2((255 * readings + OFFSET) / (255 * truths + OFFSET))
    return (
        f"{np.abs(ratio).mean():.2f} / {np.mean(np.abs(readings / np.maximum(truths, 1e-9) - 1) < 0.3):.0%}"
    )


def judge(roots: list[Path], part: str, kind: str) -> None:
    """Print the table of a kind of neighbourhoods."""
    crops, everything = clean_crops(roots, part, SEED), []
    if not any(min(crop.shape[:2]) >= SIDE for crop in crops):
        raise SystemExit(
            f"no image of the part {part} has {SIDE} texels per side: name folders with more images"
        )
    make, kinds = (cases, KINDS) if kind == "grid" else (cases_on_surfaces, KINDS_ON_SURFACES)
    print(f"| kind of noise on a {kind} | cases | model | 90 % interval holds |\n|---|---|---|---|")
    for name in kinds:
        rows = []
        for neighbourhoods, planes, colours in make(crops, name):
            model = read_noise(np.ascontiguousarray(planes, np.float32), neighbourhoods)
            truth = truth_of(colours)
            assert model.reading is not None
            holds = model.reading.low - OFFSET / 255 <= truth <= model.reading.high + OFFSET / 255
            rows.append((truth, model.overall, holds))
        truths, readings, holds = np.array(rows).T
        is_clean = name.startswith("none")
        print(
            f"| {name} | {len(rows)} | {judged(readings, truths, is_clean)} | {holds.mean():.0%} |",
            flush=True,
        )
        if not is_clean:
            everything += rows
    truths, readings, holds = np.array(everything).T
    print(f"| all noisy kinds | {len(everything)} | {judged(readings, truths, False)} | {holds.mean():.0%} |")
