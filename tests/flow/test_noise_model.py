"""What is said of the noise, in numbers."""

from __future__ import annotations

import json

import numpy as np
import OpenImageIO
import pytest

from beltrami_cli.jobs.inspect import inspect_file
from beltrami_cli.surface.records import linear_to_srgb, srgb_to_linear
from oracles.paintings import photograph

SIDE = 256


def model_of(image, tmp_path):
    path = tmp_path / "image.png"
    buffer = OpenImageIO.ImageBuf(np.ascontiguousarray(np.clip(image, 0, 1), np.float32))
    assert buffer.write(str(path), "uint16")
    facts = inspect_file(path)
    return json.loads(json.dumps(facts["noise_model"]))


def noise(seed=3):
    return np.random.default_rng(seed).standard_normal((SIDE, SIDE, 3))


def test_white_noise_has_the_grain_of_one_sample(tmp_path):
    assert model_of(photograph(SIDE) + 10 / 255 * noise(), tmp_path) == {"grain": 1.0}


@pytest.mark.slow
def test_noise_of_a_camera_is_said_by_level(tmp_path):
    """Shot noise in linear light is, in sRGB, strongest in the dark; within a third of what was made."""
    levels = np.broadcast_to(np.linspace(0.05, 0.95, SIDE)[None, :, None], (SIDE, SIDE, 3))
    light = srgb_to_linear(levels).astype(float)
    made = np.sqrt(0.004 * light + 0.005**2) * noise()
    found = model_of(linear_to_srgb(np.clip(light + made, 0, 1)), tmp_path)
    for name, level in (("dark", 0.1), ("middle", 0.5), ("bright", 0.9)):
        own = srgb_to_linear(np.float64(level))
        slope = (srgb_to_linear(np.float64(level + 0.01)) - srgb_to_linear(np.float64(level - 0.01))) / 0.02
        assert found[name] == pytest.approx(np.sqrt(0.004 * own + 0.005**2) / slope, rel=1 / 3)
