"""Families of noise and images that the second network is trained on, most of them unknown to the first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.ndimage import gaussian_filter

from clean_images import MakeImage, random_image, varied
from noises import to_size
from recipes import MEDIAN, DrawRecipe, Recipe, draw_recipe, draw_recipe_of_textures

# Draws a kind of noise, from the recipe of independent noise of a random size.
Variation = Callable[[np.random.Generator, Recipe], Recipe]


def draw_recipe_of_sizes(rng: np.random.Generator) -> Recipe:
    """Draw noise as for the first network, or with a probability of one half of kinds that even cells do not show."""
    choice, chance = rng.random(), rng.random
    if choice < 0.5:
        recipe = draw_recipe(rng)
        if recipe.sigma and chance() < 0.15:
            return replace(recipe, correlation=float(rng.uniform(-0.5, 0)))
        if recipe.sigma and chance() < 0.1:
            gains = rng.uniform(-1, 1, 3)
            return replace(
                recipe, gains=tuple(gains / np.abs(gains).max()), correlation=float(rng.choice([0, 1, 1]))
            )
        return recipe
    if choice < 0.6:
        return draw_recipe_of_textures(rng)
    kinds: dict[Variation, float] = {
        _photons: 0.1, _in_parts: 0.125, _opposite: 0.1, _of_chroma: 0.075, _by_level: 0.075, _of_camera: 0.1,
        _in_blocks: 0.075, _of_light: 0.075, _shared_by_channels: 0.175, _none: 0.1,
    }  # fmt: skip
    return _one_of(kinds, rng)


def draw_recipe_of_cameras(rng: np.random.Generator) -> Recipe:
    """Draw weak noise as in files of cameras: denoised, sharpened, compressed, often downsampled or compressed twice.

    It ranges from base sensitivity to ISO 6400; a seventh of the images have none.
    """
    shot, read = (float(np.exp(rng.uniform(*np.log(ends)))) for ends in ((2e-4, 0.02), (7e-4, 0.012)))
    sigma = float(np.sqrt(shot / 2 + read**2))  # at half the light
    gains = np.array([rng.uniform(1, 1.6), 1, rng.uniform(1, 1.6)])  # white balance
    return Recipe(
        float(rng.choice([0, sigma], p=[1 / 7, 6 / 7])), power=1.0, floor=read / sigma, is_linear=True,
        gains=tuple(gains / gains.max()), mosaic=str(rng.choice(["bilinear", "malvar", "malvar"])),
        saturation=float(rng.uniform(0, 0.7)), contrast=float(rng.uniform(0, 0.6)),
        luma=float(rng.choice([0, rng.uniform(0.2, 2)])),
        chroma=float(rng.choice([0, rng.uniform(0.5, 3), rng.uniform(0.5, 3)])),
        denoised=float(rng.choice([0, 0, 0, MEDIAN, rng.uniform(0.4, 0.9)])),
        sharpened=float(rng.choice([0, rng.uniform(0.2, 1.2)])),
        resampled=float(rng.choice([1, 1, 1, rng.uniform(0.4, 1)])), kernel=int(rng.integers(4)),
        codec="JPEG", quality=int(rng.integers(85, 99)), subsampling=int(rng.integers(3)),
        second_quality=int(rng.choice([0, int(rng.integers(70, 97))])), shifted=int(rng.integers(8)),
        after_codec=float(rng.choice([1, 1, 1, 2 ** rng.uniform(-1, 0.3)])),
    )  # fmt: skip


def draw_recipe_on_slopes(rng: np.random.Generator) -> Recipe:
    """Draw noise for images without detail, on which its size can be read exactly."""
    kinds: dict[Variation, float] = {
        _shared_by_channels: 0.2, _opposite: 0.25, _of_chroma: 0.2, _in_parts: 0.1, _by_level: 0.075, _photons: 0.075,
        _none: 0.1,
    }  # fmt: skip
    return _one_of(kinds, rng)


def _one_of(kinds: dict[Variation, float], rng: np.random.Generator) -> Recipe:
    plain = Recipe(float(2 ** rng.uniform(0.5, 5.5)) / 255)
    return list(kinds)[rng.choice(len(kinds), p=list(kinds.values()))](rng, plain)


def photographed(rng: np.random.Generator, pixels: np.ndarray) -> np.ndarray:
    """Draw an image whose finest detail spans several texels, as lenses and mosaics leave it."""
    blur = rng.uniform(0, 1.5)
    return gaussian_filter(random_image(rng, pixels), (blur, blur, 0))


def slopes(rng: np.random.Generator, pixels: np.ndarray) -> np.ndarray:
    """Draw an image without detail: light that changes slowly, or plain colours."""
    sides = rng.integers(1, 6, 2)
    coarse = rng.random((*sides, 3), np.float32)
    grey = rng.choice([0, rng.uniform(0, 1)])
    coarse = (1 - grey) * coarse + grey * coarse.mean(axis=2, keepdims=True)
    height, width = pixels.shape[:2]
    return varied(rng, to_size(coarse.astype(np.float32), width, height, kernel=1).clip(0, 1))


def _none(rng: np.random.Generator, plain: Recipe) -> Recipe:
    return Recipe()


def _photons(rng: np.random.Generator, plain: Recipe) -> Recipe:
    return replace(plain, tail="poisson", shape=float(rng.uniform(2.5, 9)))


def _in_parts(rng: np.random.Generator, plain: Recipe) -> Recipe:
    return replace(
        plain, places=str(rng.choice(["part", "part", "tiles"])), correlation=float(rng.choice([0, 0, 1])),
        place_gain=float(rng.choice([0, 0, rng.uniform(0, 0.5)])),
    )  # fmt: skip


def _opposite(rng: np.random.Generator, plain: Recipe) -> Recipe:
    gains = ((1, -1, 0), (1, 0, -1), (0, 1, -1), (1, -0.5, -0.5), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0))
    return replace(plain, gains=gains[rng.integers(len(gains))], correlation=1.0)


def _of_chroma(rng: np.random.Generator, plain: Recipe) -> Recipe:
    return replace(plain, correlation=float(rng.uniform(-0.5, -0.3)))


def _by_level(rng: np.random.Generator, plain: Recipe) -> Recipe:
    return replace(
        plain, power=float(rng.choice([1, 2])), floor=0.0, correlation=float(rng.choice([0, 0, 1]))
    )


def _of_camera(rng: np.random.Generator, plain: Recipe) -> Recipe:
    shot, read = float(np.exp(rng.uniform(*np.log((5e-4, 0.03))))), float(rng.uniform(0.002, 0.02))
    sigma = float(np.sqrt(shot / 2 + read**2))  # at half the light
    return replace(
        plain, sigma=sigma, power=1.0, floor=read / sigma, is_linear=True,
        mosaic=str(rng.choice(["bilinear", "malvar"])),
        denoised=float(rng.choice([0, 0, MEDIAN, rng.uniform(0.4, 0.9)])),
        sharpened=float(rng.choice([0, 0, rng.uniform(0.2, 1)])), codec="JPEG", quality=int(rng.integers(75, 99)),
        subsampling=int(rng.choice([0, 2])),
    )  # fmt: skip


def _in_blocks(rng: np.random.Generator, plain: Recipe) -> Recipe:
    return replace(
        plain,
        sigma=float(rng.choice([0, plain.sigma, plain.sigma])),
        codec="BC1",
        correlation=float(rng.choice([0, 0, 1])),
    )


def _of_light(rng: np.random.Generator, plain: Recipe) -> Recipe:
    return replace(
        plain, sigma=float(rng.uniform(0.05, 0.6)), power=2.0, floor=0.0, correlation=float(rng.choice([0, 1])),
        tail=str(rng.choice(["gamma", "normal"])), shape=float(rng.uniform(2, 20)), is_linear=bool(rng.random() < 0.5),
        bits=int(rng.choice([0, 8])),
    )  # fmt: skip


def _shared_by_channels(rng: np.random.Generator, plain: Recipe) -> Recipe:
    return replace(plain, correlation=float(rng.choice([0, 0, 1, rng.uniform(0, 1)])))


@dataclass(frozen=True)
class Family:
    """A kind of noise on a kind of images, and its number of training rows."""

    draw: DrawRecipe
    make_image: MakeImage
    rows: int


# Each family has its own seeds, so that a family added at the end does not change the rows of the others.
FAMILIES = {
    "grid": (
        Family(draw_recipe_of_sizes, partial(random_image, paint=0.06), 20_000),
        Family(draw_recipe_of_cameras, photographed, 10_000),
        Family(draw_recipe_on_slopes, slopes, 3_000),
    ),
    "cluster": (  # vertices are painted more often
        Family(draw_recipe_of_sizes, partial(random_image, paint=0.2), 12_000),
        Family(draw_recipe_of_cameras, photographed, 2_000),
        Family(draw_recipe_on_slopes, slopes, 2_000),
    ),
}
