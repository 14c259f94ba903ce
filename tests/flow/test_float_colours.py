"""Colours as floats: below 0 and above 1 they are ordinary values, and the mean light of every region stays."""

import numpy as np
import pytest

from beltrami_cli import smooth, smooth_image
from beltrami_cli.surface.colour_values import limits_of
from oracles import surfaces

SIDE, SIGMA = 64, 0.05


def phantom():
    """Return two plain halves and a slope, shape (SIDE, SIDE, 1), within 0.2 and 0.8."""
    y, x = np.mgrid[:SIDE, :SIDE] / SIDE
    return np.where(x > 0.5, 0.7, 0.3)[..., None] + 0.1 * y[..., None]


def smoothed(noisy, on, encoding):
    if on == "image":
        return smooth_image(noisy.astype(np.float32), encoding=encoding).colours
    positions, faces = surfaces.plane(SIDE, SIDE)
    colours = noisy.reshape(-1, noisy.shape[2]).astype(np.float32)
    return smooth(positions, faces, colours, encoding=encoding).colours.reshape(noisy.shape)


def noise(channels):
    return SIGMA * np.random.default_rng(4).standard_normal((SIDE, SIDE, channels))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("on", "encoding", "value"),
    [("image", "srgb", -0.01), ("image", "linear", -5.0), ("image", "srgb", 40.0), ("mesh", "linear", 40.0)],
)
def test_one_sample_changes_nothing_far_from_it(on, encoding, value):
    truth, noisy = np.repeat(phantom(), 3, axis=2), np.repeat(phantom(), 3, axis=2) + noise(3)
    single = noisy.copy()
    single[5, 6, 1] = value
    far = np.ones((SIDE, SIDE), bool)
    far[:24, :24] = False  # beyond kernels, patches and means of light around the sample
    off = (smoothed(own, on, encoding) - truth for own in (noisy, single))
    errors = [np.sqrt(np.mean(np.square(each[far]))) for each in off]
    assert errors[0] < SIGMA / 2
    assert errors[1] < 1.5 * errors[0]  # the hue of a large one may take part


@pytest.mark.slow
@pytest.mark.parametrize(("on", "shift"), [("image", -0.5), ("image", 10.0), ("mesh", 0.5)])
def test_values_beyond_0_and_1_are_smoothed_as_those_between(on, shift):
    truth = phantom()
    noisy = truth + noise(1)
    within = smoothed(noisy, on, "srgb") - truth
    beyond = smoothed(noisy + shift, on, "srgb") - shift - truth
    assert np.std(within) < SIGMA / 3
    assert np.std(beyond) < 1.2 * np.std(within)


@pytest.mark.parametrize(
    ("colours", "expected"),
    [
        (np.linspace(0, 1, 5000), (0, 1)),
        (np.append(np.linspace(0, 1, 5000), [-3, 7]), (0, 1)),
        (np.linspace(-1, 0.5, 5000), (-np.inf, 1)),
        (np.linspace(0.5, 9, 5000), (0, np.inf)),
        (np.concatenate([np.zeros(100), np.ones(100), [-1] * 50, [2] * 50]), (-np.inf, np.inf)),
        (np.zeros(0), (0, 1)),
    ],
)
def test_few_samples_lie_beyond_a_limit(colours, expected):
    assert limits_of(colours.astype(np.float32)) == expected


LIGHT_SIDE, REGION = 128, 32
# Relative noise of mean 1: its draws, and its standard deviation.
NOISE = {
    "normal": (lambda rng, shape: 1 + 0.25 * rng.standard_normal(shape), 0.25),
    "four paths": (lambda rng, shape: rng.gamma(4, 1 / 4, shape), 0.5),
    "one path": (lambda rng, shape: rng.exponential(1, shape), 1.0),
}
ALLOWED = 0.01


def lightmap():
    """Return light of 0.05 to 2 with soft and hard shadows, shape (LIGHT_SIDE, LIGHT_SIDE, 3)."""
    y, x = np.mgrid[:LIGHT_SIDE, :LIGHT_SIDE] / LIGHT_SIDE
    light = 0.3 + 0.25 * np.sin(5 * x + 2) * np.cos(4 * y)
    light = np.where((x - 0.3) ** 2 + (y - 0.4) ** 2 < 0.04, 4 * light, light)
    return light[..., None] * np.array([1, 0.9, 0.7])


def means(light):
    """Return the means of regions."""
    count = LIGHT_SIDE // REGION
    return light.reshape(count, REGION, count, REGION, -1).mean(axis=(1, 3))


def require_light(after, truth, sigma):
    """Check the mean of each region, and of all; of 4 sampling errors, each is exceeded by chance once in 16,000."""
    error = np.abs(means(after) / means(truth) - 1)
    assert error.max() < ALLOWED + 4 * sigma / REGION
    assert abs(after.mean() / truth.mean() - 1) < ALLOWED + 4 * sigma / LIGHT_SIDE


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "space", "shared"),
    [
        ("normal", "srgb", True), ("normal", "oklab", False), ("four paths", "linear", True),
        ("four paths", "oklab", True), ("one path", "srgb", False), ("one path", "linear", False), ],
)  # fmt: skip
def test_images_keep_the_mean_light_of_every_region(kind, space, shared):
    truth, (draw, sigma) = lightmap(), NOISE[kind]
    noisy = truth * draw(np.random.default_rng(7), (LIGHT_SIDE, LIGHT_SIDE, 1 if shared else 3))
    after = smooth_image(noisy.astype(np.float32), encoding="linear", space=space).colours
    require_light(after, truth, sigma)


@pytest.mark.slow
def test_light_does_not_leak_across_an_edge():
    # What the dark side lost has to come back to it, though the bright one has fifty times its light.
    truth = np.ones((LIGHT_SIDE, LIGHT_SIDE, 3))
    truth[:, LIGHT_SIDE // 2 :] = 0.02
    rng, factors = np.random.default_rng(9), np.ones_like(truth)
    factors[:, : LIGHT_SIDE // 2] += 0.1 * rng.standard_normal((LIGHT_SIDE, LIGHT_SIDE // 2, 3))
    factors[:, LIGHT_SIDE // 2 :] = rng.gamma(4, 1 / 4, (LIGHT_SIDE, LIGHT_SIDE // 2, 3))
    after = smooth_image((truth * factors).astype(np.float32), encoding="linear").colours
    columns = (after / truth).reshape(LIGHT_SIDE, LIGHT_SIDE // REGION, REGION, 3).mean(axis=(0, 2, 3))
    sampling = np.repeat([0.1, 0.5], 2) / np.sqrt(3 * LIGHT_SIDE * REGION)
    assert (np.abs(columns - 1) < ALLOWED + 4 * sampling).all()
