"""Recipes of noise that the network is trained on: a pipeline of steps with random parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

MEDIAN = -1.0  # in place of a Gaussian: the median of 3 x 3 samples


@dataclass(frozen=True)
class Recipe:
    """The steps from a clean image to a noisy one, in order; amplitudes are of full scale 1."""

    sigma: float = 0.0
    power: float = 0.0  # the variance is proportional to this power of the level
    floor: float = 1.0  # share of the deviation that does not depend on the level
    correlation: float = 0.0  # of the channels; at -0.5 their mean has no noise
    gains: tuple[float, float, float] = (1.0, 1.0, 1.0)
    tail: str = "normal"  # or "student", "gamma", "laplace", "binomial", "poisson"
    # Degrees of freedom, four times the shape of the gamma distribution, or log2 of the number of rays or photons.
    shape: float = 4.0
    is_linear: bool = False  # whether noise is added to linear light
    grain: float = 1.0  # factor by which the noise is enlarged
    cut_off: float = 0.0  # frequency relative to the grid's at which the noise is filtered; 0: not filtered
    is_high_pass: bool = False
    places: str = ""  # "halves", "chess", "blob", "blend", "part", "tiles"
    place_gain: float = 1.0
    impulses: float = 0.0  # share of samples that are black or white
    are_impulses_bright: bool = (
        False  # between half and full scale instead, and nowhere darker than the image
    )
    saturation: float = 0.0  # increase of the differences between channels after demosaicing
    contrast: float = 0.0  # of the tone curve, from 0 to 1
    luma: float = 0.0  # noise variance that a Wiener filter of luma assumes, relative to the true one
    chroma: float = 0.0  # standard deviation of a Gaussian for chroma
    mosaic: str = ""  # "bilinear", "malvar"
    resampled: float = 1.0  # factor of the size
    kernel: int = 0  # of resampling, in `noises.KERNELS`; it also enlarges grain
    sharpened: float = 0.0
    denoised: float = 0.0  # standard deviation of a Gaussian, or `MEDIAN`
    transfer: str = ""  # "to linear", "to srgb": what the file stores
    codec: str = ""  # "JPEG", "WEBP", "BC1"
    quality: int = 90
    second_quality: int = 0  # of a second compression; 0: none
    shifted: int = 0  # rows and columns that are cropped before the second compression
    subsampling: int = 2  # 0: none, 2: half the resolution for chroma
    after_codec: float = 1.0  # factor of resampling after compression
    bits: int = 8  # 0: floating point


DrawRecipe = Callable[[np.random.Generator], Recipe]


def draw_recipe(rng: np.random.Generator) -> Recipe:
    """Draw the steps of one image. A quarter have no noise, and half of the others at most one further step."""
    chance = rng.random
    recipe = Recipe(bits=8 if chance() < 0.9 else 0)
    if chance() < 0.76:
        recipe = _noise_of(rng, recipe)
        if chance() < 0.5:
            return _with_one_step(rng, recipe)
        recipe = _filtered(rng, recipe) if chance() < 0.42 else recipe
        recipe = _in_places(rng, recipe) if chance() < 0.12 else recipe
        if chance() < 0.07:
            recipe = replace(recipe, denoised=float(rng.choice([MEDIAN, rng.uniform(0.4, 1.2)])))
    if chance() < 0.05:
        are_bright = bool(rng.choice([False, True]))
        recipe = replace(recipe, impulses=float(10 ** rng.uniform(-3, -1.3)), are_impulses_bright=are_bright)
    recipe = _resampled(rng, recipe) if chance() < 0.14 else recipe
    recipe = _sharpened(rng, recipe) if chance() < 0.14 else recipe
    if chance() < 0.1:
        recipe = replace(recipe, transfer=str(rng.choice(["to linear", "to srgb"])))
    if chance() < 0.3:
        recipe = _compressed(rng, recipe)
        recipe = replace(recipe, after_codec=float(rng.choice([1, 1, 1, 2 ** rng.uniform(-1, 1)])))
    return recipe


def draw_recipe_of_textures(rng: np.random.Generator) -> Recipe:
    """Draw the noise that is hardest to read on a grid: noise that is only compressed, and coarse grain."""
    if rng.random() < 0.35:
        recipe = replace(_noise_of(rng, Recipe()), sigma=float(2 ** rng.uniform(0, 5)) / 255, is_linear=False)
        return replace(recipe, grain=float(rng.uniform(1.3, 5)), kernel=int(rng.integers(4)))
    sigma = 0.0 if rng.random() < 0.3 else float(2 ** rng.uniform(0, 5)) / 255
    recipe = Recipe(
        sigma, correlation=float(rng.choice([0, 0, 0, rng.uniform(0, 1), 1])), codec="JPEG",
        quality=int(rng.integers(60, 98)), subsampling=int(rng.choice([0, 2])),
    )  # fmt: skip
    return recipe if rng.random() < 0.75 else replace(recipe, second_quality=int(rng.integers(60, 98)))


def _with_one_step(rng: np.random.Generator, recipe: Recipe) -> Recipe:
    """Add at most one step to noise, which with a probability of one half is independent and even."""
    if rng.random() < 0.5:
        is_one_of_rays = recipe.tail in ("gamma", "binomial")
        recipe = replace(
            recipe, sigma=_sigma(rng), power=0.0, correlation=0.0, is_linear=False,
            tail="normal" if is_one_of_rays else recipe.tail,
        )  # fmt: skip
    steps = (lambda rng, recipe: recipe), _in_places, _compressed, _filtered, _resampled, _sharpened
    step = rng.choice(len(steps), p=[0.35, 0.2, 0.15, 0.15, 0.1, 0.05])
    return steps[step](rng, recipe)


def _sigma(rng: np.random.Generator) -> float:
    return float(2 ** rng.uniform(-0.7, 6)) / 255


def _noise_of(rng: np.random.Generator, recipe: Recipe) -> Recipe:
    """Draw the distribution of the added noise, its channels, and its dependence on the level."""
    chance = rng.random
    if chance() < 0.05:  # ambient occlusion is the share of rays that meet nothing
        return replace(recipe, sigma=1.0, tail="binomial", shape=float(rng.uniform(2, 9)), correlation=1.0)
    tail = str(rng.choice(["normal", "normal", "normal", "student", "laplace", "gamma"]))
    correlation = float(rng.choice([0, 0, 0, 0, rng.uniform(0, 1), rng.uniform(0, 1), 1, 1]))
    gains = np.ones(3) if chance() < 0.5 else rng.uniform(0.3, 1.6, 3)
    recipe = replace(
        recipe, sigma=_sigma(rng), correlation=correlation, tail=tail, gains=tuple(gains / gains.max()),
        shape=float(rng.uniform(2.5, 8)), is_linear=chance() < 0.3,
        power=float(rng.choice([0, 1, 2, rng.uniform(0, 2)])), floor=float(rng.choice([0, rng.uniform(0, 1)])),
    )  # fmt: skip
    if chance() < 0.35:
        recipe = replace(recipe, power=0.0)
    if recipe.is_linear:
        recipe = replace(recipe, sigma=float(2 ** rng.uniform(-9, -2.5)))
    if tail == "gamma":
        recipe = replace(recipe, power=2.0, floor=0.0, correlation=float(rng.choice([1, 1, correlation])))
    return recipe


def _filtered(rng: np.random.Generator, recipe: Recipe) -> Recipe:
    """Enlarge the noise, filter its spectrum, or sample colours with a Bayer mosaic."""
    kind = rng.choice(["grain", "spectrum", "mosaic"], p=[0.33, 0.24, 0.43])
    if kind == "grain":
        return replace(recipe, grain=float(rng.uniform(1.2, 5)), kernel=int(rng.integers(4)))
    if kind == "spectrum":
        is_high_pass = bool(rng.choice([True, False, False]))
        return replace(recipe, cut_off=float(rng.uniform(0.08, 0.8)), is_high_pass=is_high_pass)
    return replace(recipe, mosaic=str(rng.choice(["bilinear", "malvar"])), is_linear=rng.random() < 0.8)


def _in_places(rng: np.random.Generator, recipe: Recipe) -> Recipe:
    gain = float(rng.choice([0, rng.uniform(0, 0.6)]))
    return replace(recipe, places=str(rng.choice(["halves", "chess", "blob", "blend"])), place_gain=gain)


def _resampled(rng: np.random.Generator, recipe: Recipe) -> Recipe:
    return replace(recipe, resampled=float(2 ** rng.uniform(-1, 1.3)), kernel=int(rng.integers(4)))


def _sharpened(rng: np.random.Generator, recipe: Recipe) -> Recipe:
    return replace(recipe, sharpened=float(rng.uniform(0.2, 2)))


def _compressed(rng: np.random.Generator, recipe: Recipe) -> Recipe:
    codec = str(rng.choice(["JPEG", "JPEG", "JPEG", "WEBP"]))
    return replace(
        recipe, codec=codec, quality=int(rng.integers(50, 99)), subsampling=int(rng.choice([0, 2]))
    )
