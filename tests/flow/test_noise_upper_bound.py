"""The bound of noise that needs no place without texture."""

import numpy as np
import pytest
from scipy.stats import chi2

import beltrami_cli
from beltrami_cli.flow.noise import upper_bound
from beltrami_cli.flow.noise.grid_scales import corners_of
from beltrami_cli.flow.noise.upper_bound import most_noise
from oracles.paintings import line_art, photograph, psnr, with_noise

SIDE = 192


def stripes(width):
    down, across = np.mgrid[:SIDE, :SIDE]
    return np.where(((across + 2 * down) // width % 3 == 0)[..., None], [0.8, 0.2, 0.3], [0.3, 0.6, 0.4])


def bound(image):
    corners = corners_of(np.moveaxis(image, 2, 0).astype(np.float32))
    details = np.square(corners - corners.mean(axis=0)).sum(axis=0) / 3
    return most_noise(details, np.ones(details.shape[1:], bool))


def test_quantiles_are_those_of_the_chi_square_distribution():
    quiet, lower = chi2.ppf([upper_bound._QUANTILE, upper_bound._LOWER], 3)
    assert pytest.approx(quiet / 3, rel=1e-5) == upper_bound._OF_NOISE
    # Ten of a thousand squares are below the lower one: the cube of the root of its energy is known within a third.
    assert lower / quiet * (2 / 3) ** (2 / 3) > upper_bound._LEAST_BELOW


@pytest.mark.parametrize(
    "painting", [stripes(4), stripes(9), line_art(SIDE), photograph(SIDE), np.full((SIDE, SIDE, 3), 0.5)],
    ids=["narrow stripes", "stripes", "line art", "photograph", "plain"],
)  # fmt: skip
def test_noise_is_below_the_bound_whatever_is_painted(painting):
    sigma = 0.03
    most = bound(with_noise(painting, sigma, cut_off=False)) / upper_bound._SLACK
    # 460 of 9,216 squares are below the quantile, so that a cube root is off by less than 5 % at three deviations.
    assert np.all(most > 0.95 * sigma)


def test_the_bound_is_near_where_squares_are_within_one_colour():
    most = bound(with_noise(stripes(9), 0.04, cut_off=False)) / upper_bound._SLACK
    # Two of five squares lie within one stripe: a cube root of 2.5 is the most that is added.
    assert np.all(most < 2.5 ** (1 / 3) * 1.05 * 0.04)


def test_noise_that_is_not_normal_has_no_bound():
    # As after JPEG, which takes most of the noise from many blocks.
    left = np.random.default_rng(3).random((SIDE // 8, SIDE // 8, 3)).repeat(8, axis=0).repeat(8, axis=1) ** 3
    assert np.all(bound(0.5 + left * with_noise(np.zeros_like(left), 0.2, cut_off=False)) == np.inf)
    assert np.all(bound(np.full((16, 16, 3), 0.5)) == np.inf)


@pytest.mark.slow
def test_stripes_everywhere_are_not_read_as_noise():
    clean = stripes(9)
    noisy = np.rint(255 * with_noise(clean, 10 / 255)).astype(np.uint8)
    result = beltrami_cli.smooth_image(noisy)
    assert np.all(255 * result.noise < 1.2 * upper_bound._SLACK * 10)
    # It was taken for grain of 52, which left 34 to 36 dB.
    assert psnr(result.colours / 255, clean) > 40
