"""Greater values of --strength smooth more, whatever the noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import beltrami_cli
from beltrami_cli.flow.parameters import STRENGTHS, KernelParameters
from cli.commands import SAMPLES, beltrami, refused
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
@pytest.mark.parametrize(
    ("width", "sigma", "channels", "fast"), [(0, 4, 1, False), (0, 20, 3, True), (1.0, 12, 3, False)]
)
def test_stronger_changes_images_more(width, sigma, channels, fast):
    clean = photograph(SIZE, contrast=0.08)[..., :channels]
    noisy = np.clip(clean + sigma / 255 * noise(width, clean.shape), 0, 1).astype(np.float32)
    strengths = sorted({**STRENGTHS, "less": 0.85, "more": 1.25}.values())
    changes = [
        rms(beltrami_cli.smooth_image(noisy, strength=each, fast=fast).colours - noisy) for each in strengths
    ]
    assert changes == sorted(changes)
    normal = changes[strengths.index(1)]
    assert changes[0] < normal
    assert fast or normal < changes[-1]


def test_words_are_names_of_numbers():
    for name, strength in STRENGTHS.items():
        assert KernelParameters(strength=name) == KernelParameters(strength=strength)


def test_the_assumed_noise_grows_steadily_to_one_step_of_8_bits():
    noises = [KernelParameters(strength=each).least_noise for each in np.linspace(0.7, 1.5, 9)]
    assert noises == sorted(noises)
    assert noises[:4] == [0, 0, 0, 0]
    assert noises[-1] == pytest.approx(1 / 255)


@pytest.mark.slow
def test_stronger_changes_vertices_more():
    positions, faces = icosphere(4)
    clean = 0.5 + 0.2 * np.sin(6 * positions)
    noisy = (clean + 12 / 255 * noise(0, clean.shape)).astype(np.float32)
    changes = [
        rms(beltrami_cli.smooth(positions, faces, noisy, strength=each).colours - noisy) for each in STRENGTHS
    ]
    assert changes[0] < changes[1] < changes[2]


def test_the_command_takes_words_and_numbers(tmp_path):
    source, made = SAMPLES / "nonmanifold-noisy.ply", {}
    for strength in ("gentle", 0.7, 0.85):
        made[strength] = tmp_path / f"{strength}.ply"
        beltrami("smooth", source, made[strength], "--strength", strength, "--fast")
    assert made["gentle"].read_bytes() == made[0.7].read_bytes() != made[0.85].read_bytes()
    for strength in ("weak", 0.69, 1.51, "nan"):
        said = f"--strength is {strength}".replace("weak", "'weak'")
        refused(tmp_path, "smooth", source, "o.ply", "--strength", strength, code=2, said=said)
