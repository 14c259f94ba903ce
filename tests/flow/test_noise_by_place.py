"""Noise that differs from place to place, as of two photographs in one image."""

from __future__ import annotations

import numpy as np
import pytest

from beltrami_cli.flow.noise.grid_squares import Grid
from beltrami_cli.flow.noise.reading import read_noise
from oracles.paintings import flat_paint, line_art, photograph

SIZE, QUIET, LOUD = 256, 5 / 255, 20 / 255


def sigma_at_rows():
    """Return the standard deviation of rows: the lower half is louder."""
    return np.where(np.arange(SIZE) < SIZE // 2, QUIET, LOUD)[:, None, None]


def relative(image):
    planes = np.ascontiguousarray(np.moveaxis(image, 2, 0), np.float32)
    found = read_noise(planes, Grid(np.ones(planes.shape[1:], bool)))
    return None if found.relative is None else found.relative[0]


def test_the_noise_of_both_halves_is_found_in_one_channel():
    """Within 20 % in the loud half; textures of one channel make the quiet one louder."""
    noise = sigma_at_rows() * np.random.default_rng(0).standard_normal((SIZE, SIZE, 1))
    found = relative(np.clip(photograph(SIZE, contrast=0.05)[..., :1] + noise, 0, 1))
    below = np.sqrt(np.median(found[: SIZE // 2 - 8])), np.sqrt(np.median(found[SIZE // 2 + 8 :]))
    assert below[1] == pytest.approx(LOUD / np.sqrt((QUIET**2 + LOUD**2) / 2), rel=0.2)
    assert below[0] < 0.6 * below[1]


@pytest.mark.parametrize(
    ("scene", "sigma", "channels"),
    [(photograph, 5, 1), (flat_paint, 20, 1), (line_art, 0, 1), (photograph, 0, 3), (photograph, 20, 3)],
)
def test_textures_and_even_noise_are_the_same_everywhere(scene, sigma, channels):
    clean = scene(SIZE)[..., :channels]
    noisy = clean + sigma / 255 * np.random.default_rng(1).standard_normal(clean.shape)
    assert relative(np.clip(noisy, 0, 1).astype(np.float32)) is None
