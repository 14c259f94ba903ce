"""Noise that differs from place to place, as of two photographs, in one image or on vertices."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from beltrami_cli.surface.colour_values import linear_to_srgb, srgb_to_linear
from flow.noisy_surfaces import manifold_of, noise_of_image
from oracles.pictures import flat_areas, line_art, photograph, with_noise
from oracles.surfaces import icosphere

SIZE, QUIET, LOUD = 256, 5 / 255, 20 / 255


@pytest.mark.parametrize("channels", [1, 3])
def test_the_noise_of_both_halves_is_found_in_one_channel_or_the_same_three(channels):
    """Within 20 % in the loud half; textures of one channel make the quiet one louder."""
    sigma = np.where(np.arange(SIZE) < SIZE // 2, QUIET, LOUD)[:, None, None]
    noisy = with_noise(photograph(SIZE, contrast=0.05)[..., :1], sigma).repeat(channels, axis=2)
    found = noise_of_image(noisy).relative[0]
    assert found.mean() == pytest.approx(1, rel=1e-5)
    below = np.sqrt(np.median(found[: SIZE // 2 - 8])), np.sqrt(np.median(found[SIZE // 2 + 8 :]))
    assert below[1] == pytest.approx(LOUD / np.sqrt((QUIET**2 + LOUD**2) / 2), rel=0.2)
    assert below[0] < 0.6 * below[1]


@pytest.mark.parametrize("border", [80, 88])
def test_noise_reaches_the_border_of_a_noisy_part(border):
    """Within 12 texels on either side, where squares of 32 texels are noisy in part."""
    noisy = np.where(np.arange(SIZE) < border, LOUD, 0)[:, None]
    found = noise_of_image(with_noise(photograph(SIZE, contrast=0.05), noisy)).relative[0].mean(axis=0)
    loud = np.median(found[: border - 32])
    assert found[border - 32 : border - 12].min() > 0.7 * loud
    assert found[border + 12 :].max() < 0.3 * loud


@pytest.mark.parametrize(
    ("scene", "sigma", "channels"),
    [(photograph, 5, 1), (flat_areas, 20, 1), (line_art, 0, 1), (photograph, 0, 3), (photograph, 20, 3)],
)
def test_textures_and_even_noise_are_the_same_everywhere(scene, sigma, channels):
    noisy = with_noise(scene(SIZE)[..., :channels], sigma / 255, seed=1)
    assert noise_of_image(noisy).relative is None


def scene(channels=3, contrast=0.12):
    """Return vertices and triangles of a sphere with a photograph around it, and their standard deviations of noise."""
    positions, faces = icosphere(6)
    picture = photograph(256, contrast=contrast)
    place = 255 * (positions[:, 1:].T / 2 + 0.5)
    clean = np.stack([map_coordinates(picture[..., k], place, order=1) for k in range(channels)], axis=1)
    return positions, faces, clean, np.where(positions[:, :1] < 0, QUIET, LOUD)


@pytest.mark.parametrize(("channels", "contrast"), [(3, 0.12), (1, 0.05)])
def test_the_noise_of_both_halves_is_found(channels, contrast):
    """Within 40 % of its standard deviation, away from where it changes; to the quiet half, textures add."""
    positions, faces, clean, sigma = scene(channels, contrast)
    found = manifold_of(positions, faces, with_noise(clean, sigma))
    local = found.geometry.in_order(np.sqrt(found.noise.relative))[:, 0]
    local *= np.sqrt(np.mean(found.noise.of_input**2))
    assert np.median(local[positions[:, 0] > 0.2]) == pytest.approx(LOUD, rel=0.4)
    quiet = np.median(local[positions[:, 0] < -0.2])
    assert QUIET * 0.8 < quiet < 0.75 * LOUD


@pytest.mark.parametrize(("channels", "sigma"), [(1, 20), (3, 0), (3, 5)])
def test_textures_and_even_noise_of_vertices_are_the_same_everywhere(channels, sigma):
    positions, faces, clean, _ = scene(channels)
    assert manifold_of(positions, faces, with_noise(clean, sigma / 255)).noise.relative is None


def test_noise_by_level_is_no_noise_by_place():
    positions, faces, _, _ = scene()
    levels = np.repeat(0.5 + 0.4 * np.sin(9 * positions[:, :1]), 3, axis=1)
    light = srgb_to_linear(levels).astype(float)
    seen = light + np.sqrt(0.004 * light + 0.005**2) * np.random.default_rng(0).standard_normal(light.shape)
    found = manifold_of(positions, faces, linear_to_srgb(np.clip(seen, 0, 1)))
    assert found.noise.relative is None
    assert found.noise.stabiliser is not None
