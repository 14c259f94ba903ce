"""The error of the noise model by kind of noise, as a table, on images that it was not trained on.

Cells have the mean absolute log2 of the ratio of reading and truth, and the share of readings within 30 %; of clean
images, how many are read as more than 4 of 255, and the largest reading. All rows are judged on grids, and some on
surfaces. The truth is the RMS noise before clipping.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from beltrami_cli.flow.noise.components import OFFSET
from beltrami_cli.flow.noise.grid_squares import GridSquares
from beltrami_cli.flow.noise.neighbourhoods import Neighbourhoods
from beltrami_cli.flow.noise.reading import read_noise
from crops import clean_crops
from noises import NoisyColours, degrade
from recipes import DrawRecipe, Recipe
from surfaces import degrade_at_vertices, surface

SIDE, CASES, SEED = 192, 44, 7  # texels per side, and noisy images of each row
CLEAN_CASES = 4 * CASES
FALSE_POSITIVE = 4 / 255  # reading from which a clean image counts as misread
SURFACES = range(1000, 1024)  # numbers of the surfaces; training uses others


@dataclass(frozen=True)
class Row:
    """A row of the table: a kind of noise, and the surfaces that it is judged on."""

    name: str
    draw: DrawRecipe
    # What the noise is added to: the vertices, or the image that they sample; None: it is judged on grids alone.
    on_surfaces: Literal["vertices", "image"] | None = None
    is_clean: bool = False


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _sigma(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a deviation between two numbers of 8-bit steps."""
    return _log_uniform(rng, low, high) / 255


def _camera(rng: np.random.Generator, mosaic: str = "bilinear", **others: Any) -> Recipe:
    shot, read = _log_uniform(rng, 0.002, 0.03), rng.uniform(0.005, 0.02)
    sigma = float(np.sqrt(shot / 2 + read**2))  # at half the light
    return Recipe(sigma, power=1, floor=read / sigma, is_linear=True, mosaic=mosaic, **others)


def _grain(rng: np.random.Generator) -> Recipe:
    return Recipe(_sigma(rng, 2, 25), grain=rng.uniform(1.3, 5), kernel=int(rng.integers(3)))


def _then_jpeg(rng: np.random.Generator) -> Recipe:
    return Recipe(_sigma(rng, 2, 30), codec="JPEG", quality=int(rng.integers(60, 99)))


def _camera_then_jpeg(rng: np.random.Generator) -> Recipe:
    return _camera(rng, codec="JPEG", quality=int(rng.integers(75, 99)))


def _enlarged(rng: np.random.Generator) -> Recipe:
    return Recipe(_sigma(rng, 3, 40), resampled=rng.uniform(1.2, 2.5), kernel=int(rng.integers(2)))


def _baked_light(rng: np.random.Generator) -> Recipe:
    return Recipe(
        _log_uniform(rng, 0.02, 0.2), power=2, floor=0, correlation=1, tail="gamma",
        shape=_log_uniform(rng, 2, 20), is_linear=True,
    )  # fmt: skip


def _blended(rng: np.random.Generator) -> Recipe:
    return Recipe(_sigma(rng, 4, 40), places="blend", place_gain=rng.uniform(0.1, 0.6))


def _low_pass_residue(rng: np.random.Generator) -> Recipe:
    return Recipe(_sigma(rng, 2, 20), cut_off=rng.uniform(0.15, 0.6), correlation=0.5)


# Each row has its own seed, so that a row added at the end does not change the others.
ROWS = (
    Row("white, sigma 2 to 50", lambda rng: Recipe(_sigma(rng, 2, 50)), "vertices"),
    Row("camera (shot and read noise, mosaic, sRGB)", _camera, "image"),
    Row("grain of 1.3 to 5 texels", _grain, "image"),
    Row("white, then JPEG 60 to 98", _then_jpeg, "image"),
    Row("camera, then JPEG 75 to 98", _camera_then_jpeg, "image"),
    Row("enlarged 1.2 to 2.5 times", _enlarged),
    Row("white, equal in all channels", lambda rng: Recipe(_sigma(rng, 2, 40), correlation=1), "vertices"),
    Row(
        "white, channels correlated by 0.7",
        lambda rng: Recipe(_sigma(rng, 2, 40), correlation=0.7),
        "vertices",
    ),
    Row("baked light: heavy tails, grows with light, equal", _baked_light, "vertices"),
    Row(
        "camera, Malvar mosaic, sharpened",
        lambda rng: _camera(rng, "malvar", sharpened=rng.uniform(0.4, 1.5)),
    ),
    Row("two exposures blended", _blended),
    Row(
        "half of the image noisy",
        lambda rng: Recipe(_sigma(rng, 4, 40), places="halves", place_gain=0.2),
        "vertices",
    ),
    Row("residue of a low-pass filter", _low_pass_residue),
    Row("none", lambda rng: Recipe(), "vertices", is_clean=True),
    Row(
        "none, but JPEG",
        lambda rng: Recipe(codec="JPEG", quality=int(rng.integers(50, 99))),
        "image",
        is_clean=True,
    ),
)


def images_of(crops: list[np.ndarray], row: Row) -> Iterator[tuple[np.random.Generator, np.ndarray, Recipe]]:
    """Yield clean images, and recipes of the noise of a row."""
    rng = np.random.default_rng([SEED, ROWS.index(row)])
    large = [crop for crop in crops if min(crop.shape[:2]) >= SIDE]
    for number in rng.permutation(len(large))[: CLEAN_CASES if row.is_clean else CASES]:
        yield rng, large[number][:SIDE, :SIDE] / np.float32(255), row.draw(rng)


def on_grids(crops: list[np.ndarray], row: Row) -> Iterator[tuple[Neighbourhoods, np.ndarray, NoisyColours]]:
    """Yield noisy grids: where they are read, their channels, and their noise."""
    for rng, clean, recipe in images_of(crops, row):
        colours = degrade(rng, clean, recipe).mapped(lambda planes: planes[:SIDE, :SIDE])
        yield (
            GridSquares.of(np.ones(colours.noisy.shape[:2], bool)),
            np.moveaxis(colours.noisy, 2, 0),
            colours,
        )


def on_surfaces(
    crops: list[np.ndarray], row: Row
) -> Iterator[tuple[Neighbourhoods, np.ndarray, NoisyColours]]:
    """Yield noisy surfaces, with one sample per texel."""
    for number, (rng, clean, recipe) in enumerate(images_of(crops, row)):
        clusters, positions = surface(SURFACES[number % len(SURFACES)])
        side = int(np.clip(np.sqrt(len(positions)), 16, SIDE))
        colours = degrade_at_vertices(
            rng, clean[:side, :side], positions, recipe, is_on_vertices=row.on_surfaces == "vertices"
        )
        yield clusters, colours.noisy.reshape(-1, 3).T, colours


def truth_of(colours: NoisyColours) -> float:
    """Return the RMS noise, without the error of compression alone."""
    return float(np.sqrt(max(0.0, np.mean(colours.noise**2) - np.mean(colours.loss**2))))


def read_cases(crops: list[np.ndarray], row: Row, kind: str) -> np.ndarray:
    """Return truth, reading, and whether the 90 % interval holds, shape (cases, 3)."""
    cases = []
    for neighbourhoods, planes, colours in (on_grids if kind == "grid" else on_surfaces)(crops, row):
        model = read_noise(np.ascontiguousarray(planes, np.float32), neighbourhoods)
        truth = truth_of(colours)
        assert model.reading is not None
        holds = model.reading.low - OFFSET / 255 <= truth <= model.reading.high + OFFSET / 255
        cases.append((truth, model.overall, holds))
    return np.array(cases)


def errors_of(truths: np.ndarray, readings: np.ndarray) -> str:
    ratio = np.log2((255 * readings + OFFSET) / (255 * truths + OFFSET))
    is_near = np.abs(readings / np.maximum(truths, 1e-9) - 1) < 0.3
    return f"{np.abs(ratio).mean():.2f} / {np.mean(is_near):.0%}"


def false_positives_of(readings: np.ndarray) -> str:
    return f"{np.mean(readings > FALSE_POSITIVE):.1%}; {255 * readings.max():.1f}"


def judge(roots: list[Path], part: str, kind: str) -> None:
    """Print the table of a kind of neighbourhoods."""
    crops, noisy = clean_crops(roots, part, SEED), []
    if not any(min(crop.shape[:2]) >= SIDE for crop in crops):
        raise SystemExit(
            f"no image of the part {part} has {SIDE} texels per side: name folders with more images"
        )
    print(f"| kind of noise on a {kind} | cases | model | 90 % interval holds |\n|---|---|---|---|")
    for row in ROWS if kind == "grid" else [row for row in ROWS if row.on_surfaces is not None]:
        cases = read_cases(crops, row, kind)
        truths, readings, holds = cases.T
        if row.is_clean:  # intervals are of the size given that there is noise
            print(f"| {row.name} | {len(cases)} | {false_positives_of(readings)} | |", flush=True)
            continue
        errors = errors_of(truths, readings)
        print(f"| {row.name} | {len(cases)} | {errors} | {holds.mean():.0%} |", flush=True)
        noisy.append(cases)
    truths, readings, holds = np.concatenate(noisy).T
    print(f"| all noisy kinds | {len(truths)} | {errors_of(truths, readings)} | {holds.mean():.0%} |")
