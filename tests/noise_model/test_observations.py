"""What the network is trained on: noisy images, and the noise that was put in."""

import numpy as np
import pytest

from beltrami_cli.flow.noise.components import OFFSET
from families import draw_recipe_of_cameras, draw_recipe_on_slopes
from grids import in_squares
from noises import NoisyColours, degrade
from observations import observation_of
from recipes import Recipe, draw_recipe, draw_recipe_of_textures

SHAPE = (96, 128, 3)


def clean():
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] / 200
    return np.stack([0.3 + x, 0.7 - y, 0.2 + y], axis=2).astype(np.float32)


def observe(sample):
    found = in_squares(sample, np.ones(sample.noisy.shape[:2], bool))
    return None if found is None else observation_of(found)


@pytest.mark.parametrize("sigma", [0, 4, 12])
@pytest.mark.parametrize("bits", [0, 8])
def test_the_truth_is_the_noise_that_was_added(sigma, bits):
    """Within four standard errors of the deviation of all samples."""
    made = observe(degrade(np.random.default_rng(1), clean(), Recipe(sigma / 255, bits=bits)))
    assert 2**made.total - OFFSET == pytest.approx(sigma, rel=4 / np.sqrt(2 * np.prod(SHAPE)), abs=1e-3)


def test_what_compression_alone_does_is_no_noise():
    made = observe(degrade(np.random.default_rng(1), clean(), Recipe(codec="JPEG", quality=60)))
    assert 2**made.total - OFFSET == pytest.approx(0, abs=1e-3)


@pytest.mark.parametrize("shape", [(0, 8, 3), (8, 0, 3), (4, 4, 3)])
def test_images_without_enough_cells_are_left_out(shape):
    none = np.zeros(shape, np.float32)
    assert observe(NoisyColours(none, none, none)) is None


@pytest.mark.parametrize(
    "draw", [draw_recipe, draw_recipe_of_textures, draw_recipe_of_cameras, draw_recipe_on_slopes]
)
def test_all_recipes_make_finite_observations(draw):
    rng, image = np.random.default_rng(2), clean()
    for _ in range(20):
        made = observe(degrade(rng, image, draw(rng)))
        assert all(np.isfinite(own).all() for own in (made.features.local, made.features.even))
        assert np.isfinite(made.total)
