"""Single samples that noise of cameras makes far too dark: replaced where it is plain, and nowhere else."""

import numpy as np
import pytest
from scipy.ndimage import maximum_filter, minimum_filter

import beltrami_cli
from beltrami_cli.flow.corrections.dark_outliers import fill_dark_outliers_in_place
from flow.noisy_surfaces import by_camera, in_8_bits, manifold_of, with_grain
from oracles import surfaces
from oracles.pictures import psnr

SIDE = 128
SIGMA = 12 / 255
DEEP_BLUE = 0.06, 0.27, 0.52
RING = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], bool)[:, :, None]


def sky():
    """Return a deep blue sky that brightens by a tenth from top to bottom."""
    brightness = np.linspace(1, 1.1, SIDE, dtype=np.float32)
    return np.tile(np.float32(DEEP_BLUE) * brightness[:, None, None], (1, SIDE, 1))


def photographed(image):
    """Return what a camera makes of an image, in 8 bit."""
    return in_8_bits(by_camera(image))


def dots(image, depth):
    """Count samples that lie apart from all eight around by more than a depth."""
    low, high = minimum_filter(image, footprint=RING), maximum_filter(image, footprint=RING)
    return np.count_nonzero((image < low - depth) | (image > high + depth))


@pytest.mark.slow
def test_a_plain_sky_keeps_few_dots():
    """Green that was cut off in linear light lies 6 standard deviations below the sky: patches took it for detail."""
    clean = sky()
    noisy = photographed(clean)
    result = beltrami_cli.smooth_image(noisy)
    assert dots(noisy, 0.05) > 40
    assert dots(result.colours, 0.05) < dots(noisy, 0.05) / 3
    # Noise of 14 of 255 is averaged over thousands of samples; its mean is left, which encoding shifts.
    assert psnr(result.colours, clean) > psnr(noisy, clean) + 12


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["dark spots of several samples", "stars of single samples"])
def test_details_that_are_no_outliers_stay(kind):
    """Neighbours that lie as far out say that there is something; and no noise of cameras is so bright in the dark."""
    clean, at = sky() + np.float32(0.2), np.random.default_rng(8).integers(8, SIDE - 8, (40, 2))
    around = clean[0, 0].mean()
    if "spots" in kind:
        for row, column in at:
            clean[row - 1 : row + 2, column - 1 : column + 2] = 0.05
        noisy = photographed(clean)
    else:
        noisy = photographed(sky())
        noisy[at[:, 0], at[:, 1]] = 1
    found = beltrami_cli.smooth_image(noisy).colours[at[:, 0], at[:, 1]].mean(axis=1)
    assert (found < 0.6 * around if "spots" in kind else found > 0.6).all()


def test_vertices_far_out_are_replaced_on_surfaces():
    """And noise of grain itself, which is normal, has hardly any vertex that is."""
    positions, faces = surfaces.icosphere(5)
    grey = np.full((len(positions), 3), 0.5)
    manifold = manifold_of(positions, faces, with_grain(positions, grey, SIGMA))
    struck = np.argmax(positions @ np.concatenate([np.eye(3), -np.eye(3)]).T, axis=0)
    outliers = manifold.colours.copy()
    outliers[struck] -= np.float32(0.3)
    manifold.colours[:] = outliers
    fill_dark_outliers_in_place(manifold, manifold.levels(1)[0], np.full(3, SIGMA))
    assert np.abs(manifold.colours[struck] - 0.5).max() < SIGMA
    # Beyond 4 standard deviations to one side lie 3 of 100,000 samples of normal noise.
    assert np.count_nonzero(manifold.colours != outliers) < 3 * len(struck) + 10
