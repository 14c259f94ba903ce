"""Textures that touch each other nowhere are smoothed as if in files of their own."""

import dataclasses

import numpy as np
import pytest

from beltrami_cli.flow.parameters import KernelParameters, parameters_from
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.jobs.inspect import inspect_file
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.layers import texture_groups
from beltrami_cli.layers.settings import SmoothSettings
from formats.image_files import encode
from small_models import textured_squares

SIDE = 96  # texels of an image
SIGMA = 20 / 255
SETTINGS = SmoothSettings(parameters_from({"threads": 1, "patches": "off"}))
GIVEN = SmoothSettings(KernelParameters(iterations=2, beta=20))


def clean_images():
    """Return a plain image with soft shades, and one with fine stripes."""
    y, x = np.mgrid[:SIDE, :SIDE] / SIDE
    soft = np.stack([0.5 + 0.1 * x, 0.55 + 0.05 * y, 0.5 - 0.05 * x], axis=2)
    stripes = np.repeat(0.5 + 0.2 * np.sign(np.sin(90 * x + 20 * y))[..., None], 3, axis=2)
    return soft, stripes


def write_model(folder, images, gap):
    """Write quads side by side, each with an image, as far from each other as `gap`; return the path."""
    folder.mkdir()
    for number, image in enumerate(images):
        pixels = np.rint(image.clip(0, 1) * 255).astype(np.uint8)
        (folder / f"image{number}.png").write_bytes(encode(pixels, "png"))
    squares = ((f"image{number}.png", number * (1 + gap), (0, 1)) for number in range(len(images)))
    return textured_squares(folder / "model.obj", *squares)


@pytest.fixture
def noisy(monkeypatch):
    """Images with noise; these are enough to choose parameters from."""
    monkeypatch.setattr(texture_groups, "_SUFFICIENT_TEXELS", SIDE * SIDE // 2)
    random = np.random.default_rng(5)
    return [image + random.normal(0, SIGMA, image.shape) for image in clean_images()]


def smoothed(model, settings=SETTINGS):
    """Smooth a model into its own folder; return the images, as shares of full scale, and the report."""
    target = model.with_name("smooth.obj")
    report = smooth_file(model, target, settings, job=Job(overwrite=True))
    files = sorted(set(report.written) - {str(target)})
    images = [read_image((model.parent / name).read_bytes(), name) for name in files if name.endswith(".png")]
    return [image.pixels[..., :3] / 255 for image in images], report


def test_noise_of_one_is_none_of_another(tmp_path, noisy):
    """A clean image stays the file that it is, however noisy one is that it does not touch."""
    soft, _ = clean_images()
    images, report = smoothed(write_model(tmp_path / "apart", [soft, noisy[1]], gap=0.5))
    clean, loud = report.textures
    assert max(clean.noise.values()) < 1 / 255 < SIGMA / 2 < min(loud.noise.values())
    assert len(images) == 1
    assert clean.iterations == 0 < loud.iterations


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gap", "settings", "enough"),
    [(0, SETTINGS, SIDE * SIDE // 2), (0.5, GIVEN, SIDE * SIDE // 2), (0.5, SETTINGS, 2 * SIDE * SIDE)],
    ids=["that touch", "with given parameters", "that are small"],
)
def test_textures_are_smoothed_together(gap, settings, enough, tmp_path, noisy, monkeypatch):
    monkeypatch.setattr(texture_groups, "_SUFFICIENT_TEXELS", enough)
    (both,) = smoothed(write_model(tmp_path / "both", noisy, gap), settings)[1].textures
    assert len(both.textures) == 2


@pytest.mark.parametrize(
    ("covered", "expected"),
    [
        ([100, 100, 100], [[0], [1], [2]]),
        ([100, 30, 80], [[0, 1], [2]]),  # too few by itself: joins the largest
        ([100, 30, 40], [[0], [1, 2]]),  # enough together
        ([10, 20, 30], [[0, 1, 2]]),
    ],
)
def test_parts_have_enough_texels(monkeypatch, covered, expected):
    monkeypatch.setattr(texture_groups, "_SUFFICIENT_TEXELS", 50)
    assert texture_groups._large_parts(np.arange(len(covered)), np.array(covered)) == expected


@pytest.mark.slow
def test_info_says_the_same(tmp_path, noisy):
    model = write_model(tmp_path / "apart", noisy, gap=0.5)
    found = inspect_file(model, SETTINGS)["textures"]
    done = smoothed(model)[1].textures
    assert [each["smooth"]["iterations"] for each in found] == [each.iterations for each in done]
    assert [each["smooth"]["beta"] for each in found] == [each.beta for each in done]
    # One of another part says as little of exposures as none.
    whole = inspect_file(model, dataclasses.replace(SETTINGS, kernel=GIVEN.kernel))["textures"]
    assert [each["exposure"] for each in found] == 2 * [whole[0]["exposure"]]
