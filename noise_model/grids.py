"""Noisy colours of grids for training: images of several sizes, some of them within the outline of a chart."""

from __future__ import annotations

import numpy as np

from beltrami_cli.flow.noise.grid_squares import GridSquares
from clean_images import MakeImage, random_image
from noises import ONE_CHANNEL, NoisyColours, degrade, of_one_channel
from observations import NoisyChannels, cut_into
from recipes import DrawRecipe, Recipe, draw_recipe, draw_recipe_of_textures

SIDES = (32, 48, 64, 96, 128, 192, 256)  # texels per side of an image
SHARES = (0.06, 0.06, 0.14, 0.22, 0.24, 0.2, 0.08)  # of images, by side
MAX_SQUARES = 64  # per image
HARD = 0.2  # share of the images with noise of `draw_recipe_of_textures`


def draw_recipe_of_grids(rng: np.random.Generator) -> Recipe:
    return draw_recipe_of_textures(rng) if rng.random() < HARD else draw_recipe(rng)


def random_channels(
    rng: np.random.Generator, crops: list[np.ndarray], draw: DrawRecipe, make_image: MakeImage = random_image
) -> NoisyChannels | None:
    """Draw noisy colours on a grid."""
    crop = crops[rng.integers(len(crops))]
    recipe, side = draw(rng), int(rng.choice(SIDES, p=SHARES))
    wanted = int(np.ceil(side / min(1, recipe.resampled * recipe.after_codec))) + 8
    clean = make_image(rng, _part_of(rng, crop, wanted))
    if rng.random() < ONE_CHANNEL:
        clean, recipe = of_one_channel(clean, recipe)
    colours = degrade(rng, clean, recipe)
    top, left = (int(rng.integers(9)) if rng.random() < 0.3 else 0 for _ in range(2))
    filled = np.ones((side, side), bool)
    if rng.random() < 0.15:  # a chart of an atlas
        y, x = np.mgrid[:side, :side] / side - rng.uniform(0.3, 0.7, 2)[:, None, None]
        filled = (
            np.abs(x * rng.uniform(1, 2.5)) ** rng.uniform(0.7, 3) + np.abs(y * rng.uniform(1, 2.5)) ** 2
            < 0.25
        )
    return in_squares(colours.mapped(lambda planes: planes[top : top + side, left : left + side]), filled)


def _part_of(rng: np.random.Generator, pixels: np.ndarray, side: int) -> np.ndarray:
    top, left = (int(rng.integers(max(1, size - side + 1))) for size in pixels.shape[:2])
    return pixels[top : top + side, left : left + side]


def in_squares(colours: NoisyColours, filled: np.ndarray) -> NoisyChannels | None:
    """Cut noisy colours into squares; None if no square is filled."""
    rows, columns = colours.noisy.shape[:2]
    filled = filled[:rows, :columns]
    return cut_into(GridSquares.of(filled, MAX_SQUARES), colours) if filled.any() else None
