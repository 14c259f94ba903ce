"""Images that JPEG coded are decoded with the noise before known, which brings them closer to the truth."""

import json

import numpy as np
import OpenImageIO
import pytest
from scipy.ndimage import gaussian_filter
from scipy.stats import truncnorm

from beltrami_cli.flow.corrections.jpeg_image import (
    JpegImage,
    _truncated_normal_mean,
    coefficients_of,
    decode_in_place,
)
from beltrami_cli.flow.corrections.jpeg_noise import PILOT_ERROR, is_changed, noise_after, sigma_before
from beltrami_cli.formats.image.jpeg_tables import read_jpeg_tables
from cli.commands import beltrami
from flow.noisy_surfaces import noise_of_image
from flow.test_correlated_noise import phantom, stored
from formats.image_files import encode
from oracles.pictures import psnr

CLEAN = phantom(256)
SMALL = phantom(160)  # for whole commands


def jpeg_file(pixels, quality, subsampling="4:2:0"):
    """Return a JPEG file."""
    return encode(pixels, "jpeg", compression=f"jpeg:{quality}", jpeg__subsampling=subsampling)


def decoded(data, path):
    """Return the pixels of a file, uint8."""
    path.write_bytes(data)
    return np.rint(255 * OpenImageIO.ImageBuf(str(path)).get_pixels("float")).astype(np.uint8)


def coded(pixels, quality, subsampling, tmp_path):
    """Return pixels as JPEG stores them."""
    data = jpeg_file(pixels, quality, subsampling)
    pixels, tables = decoded(data, tmp_path / "coded.jpg"), read_jpeg_tables(data)
    return JpegImage(pixels, np.ones(pixels.shape[:2], bool), tables.steps, tables.span)


def test_noise_that_jpeg_left_as_it_was_is_recognised(tmp_path):
    images = [coded(stored(CLEAN, 20), 98, "4:4:4", tmp_path)]
    assert not is_changed(images, 20 / 255)
    assert is_changed(images, 1 / 255)


@pytest.mark.parametrize(
    ("sigma", "quality", "colour"), [(5, 95, "4:2:0"), (10, 90, "4:2:0"), (20, 75, "4:4:4")]
)
def test_white_noise_is_read_as_it_was_before(sigma, quality, colour, tmp_path):
    image = coded(stored(CLEAN, sigma), quality, colour, tmp_path)
    found = sigma_before([image], noise_of_image(image.pixels / 255))
    assert found is not None
    assert 255 * found == pytest.approx(sigma, rel=0.3)


def test_noise_that_neighbours_shared_is_not_white_before(tmp_path):
    grain = gaussian_filter(np.random.default_rng(2).standard_normal(CLEAN.shape), (2, 2, 0))
    image = coded(stored(CLEAN + 10 / 255 * grain / grain.std(), 0), 92, "4:2:0", tmp_path)
    assert sigma_before([image], noise_of_image(image.pixels / 255)) is None


def test_the_mean_between_limits_is_that_of_a_truncated_normal_distribution():
    random = np.random.default_rng(1)
    mean, middle = random.normal(0, 30, 300), 10 * np.rint(random.normal(0, 3, 300))
    reach, sigma = np.full(300, 5.0), 7.0
    low, high = (middle - reach - mean) / sigma, (middle + reach - mean) / sigma
    near = np.maximum(abs(low), abs(high)) < 6  # beyond, SciPy's own mean loses digits
    found = _truncated_normal_mean(mean, sigma, middle, reach)
    assert near.sum() > 150
    np.testing.assert_allclose(found[near], truncnorm.mean(low, high, mean, sigma)[near], atol=1e-4)
    far = _truncated_normal_mean(np.array([0.0, 0.0]), 0.1, np.array([1000.0, -1000.0]), np.array([5.0, 5.0]))
    np.testing.assert_allclose(far, [995, -995], atol=0.01)


def test_decoding_with_the_noise_known_comes_closer_to_the_truth(tmp_path):
    image = coded(stored(CLEAN, 10), 80, "4:2:0", tmp_path)
    result = gaussian_filter(image.pixels / 255, (1, 1, 0)).astype(np.float32)
    decode_in_place(image, result, 10 / 255)
    # With coefficients of noise that are 0 or a whole step, the nearer end of the interval is half as far off.
    assert psnr(result, CLEAN) > psnr(image.pixels / 255, CLEAN) + 1.5


@pytest.mark.parametrize("limit", [0.0, 1.0])
def test_decoding_keeps_colours_near_limits_where_the_pilot_has_them(limit, tmp_path):
    # Noise can only make white darker: its stored mean is 0.4 standard deviations below.
    flat = np.full((64, 64, 3), abs(limit - 0.004), np.float32)
    image = coded(stored(flat, 20), 92, "4:4:4", tmp_path)
    result = flat.copy()
    decode_in_place(image, result, 20 / 255)
    # Noise that was cut off is weaker than its sigma, so that coefficients count too much: by a third at most.
    lost = abs(image.pixels.mean() / 255 - flat.mean())
    assert 255 * lost > 5
    assert abs(result.mean(axis=(0, 1)) - flat[0, 0]).max() < lost / 3


def test_decoding_keeps_every_coefficient_in_its_interval(tmp_path):
    image = coded(stored(CLEAN, 10), 80, "4:4:4", tmp_path)
    result = np.full(image.pixels.shape, 0.5, np.float32)
    decode_in_place(image, result, 10 / 255)
    planes = image.planes_of(image.pixels), image.planes_of(255 * result), image.tables
    for before, after, steps in zip(*planes, strict=True):
        middle = np.rint(coefficients_of(before) / steps) * steps
        # The other planes move a pixel's rounding only, and single precision has seven digits.
        assert np.all(abs(coefficients_of(after) - middle) <= steps / 2 + 0.01)


@pytest.mark.parametrize("subsampling", ["4:2:0", "4:2:2"])
def test_chroma_is_known_although_decoders_interpolate_it(subsampling, tmp_path):
    image = coded(stored(CLEAN, 10), 98, subsampling, tmp_path)
    bands = [image.stored_planes(rows) for rows in image.bands]
    whole = image.uninterpolated_planes_of(image.pixels)
    for number, (plane, steps) in enumerate(zip(whole, image.tables, strict=True)):
        # Four samples beyond a band of rows are seen, by 0.17 less each, of at most 128.
        np.testing.assert_allclose(np.concatenate([band[number] for band in bands]), plane, atol=0.1)
        found = coefficients_of(plane) / steps
        # Rounding of pixels to 8 bit, in steps of 1 and 2; of numbers that are no multiples of steps it would be 0.29.
        assert np.sqrt(np.mean((found - np.rint(found)) ** 2)) < 0.22


def test_the_noise_that_decoding_leaves_is_estimated(tmp_path):
    image = coded(stored(CLEAN, 10), 80, "4:2:0", tmp_path)
    result = CLEAN.astype(np.float32)
    decode_in_place(image, result, 10 / 255)
    left, before = noise_after([image], [CLEAN.astype(np.float32)], 10 / 255)
    for estimated, colours in ((left.sigma / PILOT_ERROR, result), (before, image.pixels / 255)):
        true = np.sqrt(np.mean((colours - CLEAN) ** 2, axis=(0, 1)))
        np.testing.assert_allclose(estimated, true, rtol=0.05)  # of 65,536 pixels, and ringing of paint


@pytest.mark.slow
def test_a_jpeg_file_is_smoothed_better_than_its_pixels_alone(tmp_path):
    data = jpeg_file(stored(SMALL, 10), 80)
    pixels = decoded(data, tmp_path / "in.jpg")
    (tmp_path / "in.png").write_bytes(encode(pixels, "png"))
    results = {}
    for suffix in (".jpg", ".png"):
        report = tmp_path / f"{suffix}.json"
        out = tmp_path / f"out{suffix[1:]}.png"
        beltrami("smooth", tmp_path / f"in{suffix}", out, "--report", report)
        results[suffix] = psnr(decoded(out.read_bytes(), out) / 255, SMALL)
        if suffix == ".jpg":
            read = list(json.loads(report.read_text())["image"]["noise"].values())
    assert results[".jpg"] > results[".png"] + 1
    true = np.sqrt(np.mean((pixels / 255 - SMALL) ** 2))
    assert np.sqrt(np.mean(np.square(read))) == pytest.approx(true, rel=0.3)


@pytest.mark.slow
def test_the_paper_kernel_and_a_fixed_rule_leave_images_as_they_are_decoded(tmp_path):
    data = jpeg_file(stored(SMALL, 10), 80, "4:4:4")
    (tmp_path / "in.png").write_bytes(encode(decoded(data, tmp_path / "in.jpg"), "png"))
    for options in (["--preset", "paper"], ["--fast"]):
        outs = [tmp_path / f"{suffix}.png" for suffix in ("jpg", "png")]
        for out in outs:
            given = tmp_path / f"in.{out.stem}"
            beltrami("smooth", given, out, "--overwrite", *options)
        np.testing.assert_array_equal(*(decoded(out.read_bytes(), out) for out in outs))


@pytest.mark.slow
def test_the_number_of_threads_changes_nothing(tmp_path):
    decoded(jpeg_file(stored(SMALL[:64, :64], 10), 80), tmp_path / "in.jpg")
    outs = [tmp_path / f"{count}.png" for count in (1, 2)]
    for out in outs:
        beltrami("smooth", tmp_path / "in.jpg", out, "--threads", out.stem)
    assert outs[0].read_bytes() == outs[1].read_bytes()


@pytest.mark.slow
def test_noise_that_is_given_is_that_before(tmp_path):
    decoded(jpeg_file(stored(SMALL, 10), 80, "4:4:4"), tmp_path / "in.jpg")
    results = {}
    for noise in ("1", "10"):
        out = tmp_path / f"{noise}.png"
        beltrami("smooth", tmp_path / "in.jpg", out, "--noise", noise)
        results[noise] = psnr(decoded(out.read_bytes(), out) / 255, SMALL)
    assert results["10"] > results["1"] + 3
