"""--strength: less and more smoothing, whatever the noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import beltrami_cli
from beltrami_cli.flow.parameters import SMOOTHNESS
from oracles.paintings import photograph
from oracles.surfaces import icosphere

SIZE = 80


def noise(width, shape, seed=0):
    """Return noise of a standard deviation of 1, which neighbours share up to a width."""
    drawn = np.random.default_rng(seed).standard_normal(shape)
    if width:
        drawn = gaussian_filter(drawn, (width, width, 0))
    return drawn / drawn.std()


def rms(change):
    return float(np.sqrt(np.mean(np.square(change))))


@pytest.mark.slow
@pytest.mark.parametrize(("width", "sigma", "channels"), [(0, 4, 1), (0, 20, 3), (1.0, 12, 3)])
def test_stronger_changes_images_more(width, sigma, channels):
    clean = photograph(SIZE, contrast=0.08)[..., :channels]
    noisy = np.clip(clean + sigma / 255 * noise(width, clean.shape), 0, 1).astype(np.float32)
    changes = [rms(beltrami_cli.smooth_image(noisy, strength=each).colours - noisy) for each in SMOOTHNESS]
    assert list(SMOOTHNESS) == ["gentle", "normal", "strong"]
    assert changes[0] < changes[1] < changes[2]


@pytest.mark.slow
def test_stronger_changes_vertices_more():
    positions, faces = icosphere(4)
    clean = 0.5 + 0.2 * np.sin(6 * positions)
    noisy = (clean + 12 / 255 * noise(0, clean.shape)).astype(np.float32)
    changes = [
        rms(beltrami_cli.smooth(positions, faces, noisy, strength=each).colours - noisy)
        for each in SMOOTHNESS
    ]
    assert changes[0] < changes[1] < changes[2]
