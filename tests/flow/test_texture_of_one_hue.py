"""Textures without any even place, as of grass or scratched metal, are no noise: their hue shows it."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import beltrami_cli
from flow.noisy_surfaces import manifold_of
from flow.test_correlated_noise import stored
from oracles import surfaces
from oracles.pictures import psnr, with_noise

SIDE = 320
GRASS = np.array([0.6, 0.78, 0.12])


def texture(hue, deviation=0.17, growth=1.5):
    """Return details of every size, each scale stronger than the one before, in multiples of a hue."""
    random, total = np.random.default_rng(4), np.zeros((SIDE, SIDE))
    for scale in range(5):
        layer = gaussian_filter(random.standard_normal((SIDE, SIDE)), 0.4 * 2**scale)
        total += growth**scale * layer / layer.std()
    total *= deviation / total.std()
    return np.clip(0.45 + total[..., None] * hue / np.linalg.norm(hue) * np.sqrt(3), 0.02, 0.98)


def read(image):
    """Return the noise that is read, of 255."""
    return 255 * float(np.sqrt(np.mean(beltrami_cli.smooth_image(image, iterations=0).noise ** 2)))


@pytest.mark.parametrize("hue", [GRASS, np.ones(3)], ids=["grass", "grey"])
def test_white_noise_on_a_texture_is_read_right(hue):
    """Within a third: its differences of channels hold noise and nothing else."""
    assert read(stored(texture(hue), 10)) == pytest.approx(10, rel=1 / 3)


def test_a_clean_texture_of_one_hue_is_hardly_changed():
    clean = texture(GRASS)
    result = beltrami_cli.smooth_image(stored(clean, 0))
    assert psnr(result.colours / 255, clean) > 38


def test_vertices_with_a_texture_of_one_hue_show_their_noise():
    """Within 40 %: a tenth more than the median is removed, and texture adds to it."""
    positions, faces = surfaces.icosphere(6)
    at = ((positions[:, :2] + 1) / 2 * (SIDE - 1)).astype(int)
    clean = texture(GRASS)[at[:, 0], at[:, 1]]
    manifold = manifold_of(positions, faces, with_noise(clean, 12 / 255, seed=3, cut_off=False))
    assert not manifold.noise.is_shared
    assert 255 * manifold.noise.overall == pytest.approx(12, rel=0.4)
