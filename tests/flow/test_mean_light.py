"""Smoothing keeps the mean light of every region of colours that are stored as light, whatever their noise."""

import numpy as np
import pytest

from beltrami_cli import smooth_image

SIDE, REGION = 128, 32
# Relative noise of mean 1: its draws, and its standard deviation.
NOISE = {
    "normal": (lambda rng, shape: 1 + 0.25 * rng.standard_normal(shape), 0.25),
    "four paths": (lambda rng, shape: rng.gamma(4, 1 / 4, shape), 0.5),
    "one path": (lambda rng, shape: rng.exponential(1, shape), 1.0),
}
ALLOWED = 0.01


def lightmap():
    """Return light of 0.05 to 2 with soft and hard shadows, shape (SIDE, SIDE, 3)."""
    y, x = np.mgrid[:SIDE, :SIDE] / SIDE
    light = 0.3 + 0.25 * np.sin(5 * x + 2) * np.cos(4 * y)
    light = np.where((x - 0.3) ** 2 + (y - 0.4) ** 2 < 0.04, 4 * light, light)
    return light[..., None] * np.array([1, 0.9, 0.7])


def means(light):
    """Return the means of regions."""
    count = SIDE // REGION
    return light.reshape(count, REGION, count, REGION, -1).mean(axis=(1, 3))


def require_light(after, truth, sigma):
    """Check the mean of each region, and of all; of 4 sampling errors, each is exceeded by chance once in 16,000."""
    error = np.abs(means(after) / means(truth) - 1)
    assert error.max() < ALLOWED + 4 * sigma / REGION
    assert abs(after.mean() / truth.mean() - 1) < ALLOWED + 4 * sigma / SIDE


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "space", "shared"),
    [
        ("normal", "srgb", True),
        ("normal", "oklab", False),
        ("four paths", "linear", True),
        ("four paths", "oklab", True),
        ("one path", "srgb", False),
        ("one path", "linear", False),
    ],
)
def test_images_keep_the_mean_light_of_every_region(kind, space, shared):
    truth, (draw, sigma) = lightmap(), NOISE[kind]
    noisy = truth * draw(np.random.default_rng(7), (SIDE, SIDE, 1 if shared else 3))
    after = smooth_image(noisy.astype(np.float32), encoding="linear", space=space).colours
    require_light(after, truth, sigma)


@pytest.mark.slow
def test_light_does_not_leak_across_an_edge():
    # What the dark side lost has to come back to it, though the bright one has fifty times its light.
    truth = np.ones((SIDE, SIDE, 3))
    truth[:, SIDE // 2 :] = 0.02
    rng, factors = np.random.default_rng(9), np.ones_like(truth)
    factors[:, : SIDE // 2] += 0.1 * rng.standard_normal((SIDE, SIDE // 2, 3))
    factors[:, SIDE // 2 :] = rng.gamma(4, 1 / 4, (SIDE, SIDE // 2, 3))
    after = smooth_image((truth * factors).astype(np.float32), encoding="linear").colours
    columns = (after / truth).reshape(SIDE, SIDE // REGION, REGION, 3).mean(axis=(0, 2, 3))
    sampling = np.repeat([0.1, 0.5], 2) / np.sqrt(3 * SIDE * REGION)
    assert (np.abs(columns - 1) < ALLOWED + 4 * sampling).all()


@pytest.mark.slow
def test_noise_around_black_keeps_its_mean():
    truth, rng = 0.1 * lightmap(), np.random.default_rng(10)
    noisy = truth + 0.02 * rng.standard_normal(truth.shape)
    after = smooth_image(noisy.astype(np.float32), encoding="linear").colours
    assert noisy.min() < -0.02
    assert np.abs(means(after) - means(truth)).max() < ALLOWED * 0.1 + 4 * 0.02 / REGION
    assert np.std(after - truth) < np.std(noisy - truth) / 2


@pytest.mark.slow
def test_black_texels_of_few_paths_are_no_sign_of_cut_off_noise():
    truth, rng = lightmap(), np.random.default_rng(11)
    noisy = truth * 3 * (rng.random(truth.shape) < 1 / 3)
    after = smooth_image(noisy.astype(np.float32), encoding="linear").colours
    # By half more than sampling errors: weights of patches go by texels that are black by chance.
    require_light(after, truth, 1.5 * np.sqrt(2))
