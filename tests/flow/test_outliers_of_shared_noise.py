"""Single samples that noise of cameras makes far too dark: replaced where it is plain, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import maximum_filter, minimum_filter

import beltrami_cli
from beltrami_cli.flow.coarse_levels import replace_outliers
from beltrami_cli.flow.mesh_manifold import mesh_manifold
from beltrami_cli.flow.parameters import parameters_with
from beltrami_cli.jobs.job import NoiseSettings
from beltrami_cli.jobs.noise import NoiseTargets, add_grain, seen_by_camera
from beltrami_cli.surface.baking import Cells
from beltrami_cli.surface.records import SampledSurface
from oracles import surfaces
from oracles.paintings import psnr

SIDE = 128
SIGMA = 12 / 255
DEEP_BLUE = 0.06, 0.27, 0.52
RING = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], bool)[:, :, None]


def sky():
    """Return a deep blue sky that brightens by a tenth from top to bottom."""
    brightness = np.linspace(1, 1.1, SIDE, dtype=np.float32)
    return np.tile(np.float32(DEEP_BLUE) * brightness[:, None, None], (1, SIDE, 1))


def photographed(image, shot=0.01, read=0.01):
    """Return what a camera makes of an image, in 8 bit."""
    row, column = np.indices(image.shape[:2]).reshape(2, -1)
    none = np.zeros_like(row)
    cells = Cells([image.shape[:2]], none, row, column, none)
    settings = NoiseSettings(kind="camera", shot=shot, read=read, seed=3)
    noisy = seen_by_camera(NoiseTargets(image.reshape(-1, 3), np.arange(row.size)), cells, settings)
    return (np.rint(255 * noisy.reshape(image.shape).clip(0, 1)) / 255).astype(np.float32)


def dots(image, depth):
    """Count samples that lie apart from all eight around by more than a depth."""
    low, high = minimum_filter(image, footprint=RING), maximum_filter(image, footprint=RING)
    return np.count_nonzero((image < low - depth) | (image > high + depth))


def test_a_plain_sky_keeps_few_dots():
    """Green that was cut off in linear light lies 6 standard deviations below the sky: patches took it for detail."""
    clean = sky()
    noisy = photographed(clean)
    result = beltrami_cli.smooth_image(noisy)
    assert dots(noisy, 0.05) > 40
    assert dots(result.colours, 0.05) < dots(noisy, 0.05) / 3
    # Noise of 14 of 255 is averaged over thousands of samples; what is left is its mean, which encoding shifts.
    assert psnr(result.colours, clean) > psnr(noisy, clean) + 12


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
    spacing = np.full(len(positions), np.sqrt(4 * np.pi / len(positions)))
    grey = NoiseTargets(np.full((len(positions), 3), 0.5, np.float32), np.arange(len(positions)))
    noise = NoiseSettings(kind="grain", sigma=SIGMA, size=2.0)
    colours = add_grain(grey, positions, spacing, noise).astype(np.float32)

    surface = SampledSurface(positions, faces.astype(np.int32), np.zeros((0, 3), np.int32), colours)
    manifold = mesh_manifold(surface, parameters_with({"threads": 1}))
    struck = np.argmax(positions @ np.concatenate([np.eye(3), -np.eye(3)]).T, axis=0)
    outliers = manifold.colours.copy()
    outliers[struck] -= np.float32(0.3)
    manifold.colours[:] = outliers
    replace_outliers(manifold, manifold.levels(1)[0], np.full(3, SIGMA))
    assert np.abs(manifold.colours[struck] - 0.5).max() < SIGMA
    # Beyond 4 standard deviations to one side lie 3 of 100,000 samples of normal noise.
    assert np.count_nonzero(manifold.colours != outliers) < 3 * len(struck) + 10
