"""Numbers below 0 and above 1 are ordinary values of floats: single ones change nothing, and all may be such."""

import numpy as np
import pytest

from beltrami_cli import smooth, smooth_image
from beltrami_cli.surface.records import limits_of
from oracles import surfaces

SIDE, SIGMA = 64, 0.05


def painting():
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
    [
        ("image", "srgb", -0.01),
        ("image", "linear", -5.0),
        ("image", "srgb", 40.0),
        ("mesh", "linear", 40.0),
    ],
)
def test_one_sample_changes_nothing_far_from_it(on, encoding, value):
    truth, noisy = np.repeat(painting(), 3, axis=2), np.repeat(painting(), 3, axis=2) + noise(3)
    single = noisy.copy()
    single[5, 6, 1] = value
    far = np.ones((SIDE, SIDE), bool)
    far[:24, :24] = False  # beyond kernels, patches and means of light around the sample
    errors = [
        np.sqrt(np.mean(np.square((smoothed(own, on, encoding) - truth)[far]))) for own in (noisy, single)
    ]
    assert errors[0] < SIGMA / 2
    assert errors[1] < 1.5 * errors[0]  # of which the hue of a large one may take part


@pytest.mark.slow
@pytest.mark.parametrize(("on", "shift"), [("image", -0.5), ("image", 10.0), ("mesh", 0.5)])
def test_values_beyond_0_and_1_are_smoothed_as_those_between(on, shift):
    truth = painting()
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
