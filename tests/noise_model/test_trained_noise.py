"""What the trained noise model must read, whatever its weights are, and what every training must have taught it."""

import io
from dataclasses import astuple
from functools import partial

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter

from beltrami_cli.flow.noise.drawing import draw_on_grid
from beltrami_cli.flow.noise.grid_squares import MAX_SQUARES, SIDE, GridSquares, choose_corners
from beltrami_cli.flow.noise.reading import read_noise
from flow.noisy_surfaces import by_camera
from oracles.pictures import photograph

SHAPE = (128, 192)  # of whole squares, so that turning the image keeps them


def estimate(planes, filled=None, **given):
    filled = np.ones(planes.shape[1:], bool) if filled is None else filled
    return read_noise(np.ascontiguousarray(planes, np.float32), GridSquares.of(filled), **given)


def ramp():
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] / max(SHAPE)
    return np.stack([0.3 + 0.4 * x, 0.7 - 0.4 * y, 0.3 + 0.2 * (x + y)]).astype(np.float32)


def rounded(planes):
    return np.rint(planes.clip(0, 1) * 255).astype(np.float32) / 255


def painting(sigma, seed=0, covariance=None):
    """Return a ramp with edges and noise of the channels with a covariance, one unit being sigma."""
    planes = ramp()
    planes[:, 40:70, 20:90] = np.array([0.8, 0.2, 0.5])[:, None, None]
    root = np.linalg.cholesky(np.eye(3) if covariance is None else np.array(covariance))
    noise = np.einsum("ij,jrc->irc", root, np.random.default_rng(seed).standard_normal(planes.shape))
    return rounded(planes + sigma / 255 * noise)


def test_white_noise_lies_in_its_interval():
    models = {
        sigma: estimate(rounded(ramp() + np.random.default_rng(sigma).normal(0, sigma / 255, (3, *SHAPE))))
        for sigma in (3, 5, 8, 12, 18, 25, 35)
    }
    held = [model.reading.low < sigma / 255 < model.reading.high for sigma, model in models.items()]
    # Nine in ten do; of seven, fewer than five do by chance in 0.3 % of all cases.
    assert sum(held) >= 5, models
    for sigma, model in models.items():
        assert model.overall == pytest.approx(sigma / 255, rel=0.3)
        assert model.relative is None
        assert model.grain < 1.2


def dots():
    """Return a map of single texels in one of a few colours."""
    random = np.random.default_rng(4)
    colours = random.choice([0, 0.5, 1], (8, 3)) * [1, 0.9, 0.8]
    return colours[np.where(random.random(SHAPE) < 0.02, random.integers(0, 8, SHAPE), 0)].transpose(2, 0, 1)


@pytest.mark.parametrize(
    "clean",
    [np.full((3, *SHAPE), 0.4), ramp(), rounded(ramp()), dots()],
    ids=["constant", "real", "8 bits", "dots"],
)
def test_plain_images_have_no_noise(clean):
    assert not estimate(clean).covariances.any()


def test_the_order_of_channels_hardly_matters():
    planes = painting(12, covariance=[[1, 0.3, 0], [0.3, 0.5, 0.2], [0, 0.2, 2]])
    model, order = estimate(planes), [2, 0, 1]
    other = estimate(planes[order])
    # Luma, in which traces of JPEG are sought, has its own share of each channel.
    expected = model.covariances[:, order][:, :, order]
    np.testing.assert_allclose(other.covariances, expected, rtol=0.05, atol=0.05 * expected.max())


@pytest.mark.parametrize(
    "turn",
    [partial(np.flip, axis=1), partial(np.flip, axis=2), partial(np.rot90, axes=(1, 2))],
    ids=["upside down", "mirrored", "by a quarter"],
)
def test_the_direction_does_not_matter(turn):
    model, other = estimate(painting(12)), estimate(turn(painting(12)))
    np.testing.assert_allclose(other.covariances, model.covariances, rtol=1e-3, atol=1e-3 * model.overall**2)


def test_one_channel_is_read_as_the_same_grey_in_three():
    grey = painting(12)[:1]
    alone, three = estimate(grey), estimate(np.repeat(grey, 3, axis=0))
    np.testing.assert_allclose(alone.covariance[0, 0], three.covariance[0, 0], rtol=1e-6)
    np.testing.assert_allclose(astuple(alone.reading), astuple(three.reading), rtol=1e-6)


def test_grey_noise_in_three_channels_is_shared_by_them():
    noise = 15 / 255 * np.random.default_rng(3).standard_normal((1, *SHAPE))
    covariance = estimate(rounded(ramp() + noise)).covariance
    deviations = np.sqrt(np.diag(covariance))
    assert (covariance / np.outer(deviations, deviations)).min() > 0.9
    independent = estimate(painting(15)).covariance
    assert np.abs(independent - np.diag(np.diag(independent))).max() < 0.25 * independent.max()


def test_the_loudest_channel_is_found():
    deviations = estimate(painting(8, covariance=np.diag([1, 4, 16]))).sigma * 255
    np.testing.assert_allclose(deviations, [8, 16, 32], rtol=0.3)


def test_coarse_grain_is_found_at_coarse_scales():
    covariances = np.stack([share * 0.002 * np.eye(3) for share in (0.1, 0.5, 1, 1)])
    noise = draw_on_grid(covariances, SHAPE, np.random.default_rng(5))
    found = np.trace(estimate(rounded(ramp() + noise)).covariances, axis1=1, axis2=2) / 3
    assert found[0] < found[1] < found[2]


@pytest.mark.parametrize("count", [1, 2, 3, 4, 6])
def test_any_number_of_channels_has_a_covariance(count):
    planes = np.concatenate([painting(10, seed) for seed in (0, 1)])[:count]
    model = estimate(planes)
    assert model.covariances.shape[1:] == (count, count)
    assert np.linalg.eigvalsh(model.covariances).min() > -1e-9
    assert model.reading.low <= 10 / 255 <= model.reading.high


def test_cells_that_are_not_filled_do_not_count():
    planes, filled = painting(10), np.zeros(SHAPE, bool)
    filled[5:90, 8:100], filled[100:120, 10:180] = True, True
    noisier = np.where(filled, planes, np.random.default_rng(1).random(planes.shape))
    one, other = estimate(planes, filled), estimate(noisier, filled)
    np.testing.assert_array_equal(one.covariances, other.covariances)
    assert one.overall == pytest.approx(10 / 255, rel=0.3)
    assert not estimate(planes, np.zeros(SHAPE, bool)).covariances.any()


def test_light_beyond_full_scale_is_read_on_its_own_scale():
    bright, brighter = (estimate(scale * painting(10)).overall for scale in (4, 400))
    assert brighter == pytest.approx(100 * bright, rel=0.05)
    assert bright == pytest.approx(4 * 10 / 255, rel=0.3)


@pytest.mark.parametrize("offset", [-0.5, 5])
def test_numbers_that_are_no_levels_are_read_as_if_they_were(offset):
    planes = painting(10)
    shifted, same = estimate(planes + offset), estimate(planes).overall
    assert shifted.overall == pytest.approx(same, rel=0.2)  # without the hints of clipping
    assert shifted.stabiliser is None


def test_a_given_strength_keeps_the_structure():
    planes = painting(12, covariance=[[1, 0.9, 0.9], [0.9, 1, 0.9], [0.9, 0.9, 1]])
    model = estimate(planes)
    scaled = model.scaled_to(20 / 255)
    assert scaled.overall == pytest.approx(20 / 255)
    expected = model.covariances * (scaled.overall / model.overall) ** 2
    np.testing.assert_allclose(scaled.covariances, expected, rtol=1e-9)
    none = estimate(ramp()).scaled_to(0.1)
    np.testing.assert_allclose(none.sigma, 0.1)
    assert none.is_independent


@pytest.mark.parametrize(
    "covariance",
    [
        pytest.param([[1, 0.9, 0.9], [0.9, 1, 0.9], [0.9, 0.9, 1]], id="mostly grey"),
        pytest.param([[1.01, -1, 0], [-1, 1.01, 0], [0, 0, 0.01]], id="opposite"),
        pytest.param([[1, -0.49, -0.49], [-0.49, 1, -0.49], [-0.49, -0.49, 1]], id="chroma"),
        pytest.param([[1, 0, 0], [0, 0.01, 0], [0, 0, 0.01]], id="one channel"),
    ],
)
def test_the_covariance_of_channels_is_found_whatever_it_is(covariance):
    """To a tenth of the noise, where its size is known: a pilot takes nine tenths of it."""
    expected = np.array(covariance)
    sigma = 12 / 255 * np.sqrt(np.trace(expected) / 3)
    found = estimate(painting(12, covariance=covariance), sigma=sigma).covariance / (12 / 255) ** 2
    np.testing.assert_allclose(found, expected, atol=0.12)


@pytest.mark.parametrize("power", [0.5, 1.0])
def test_noise_that_grows_with_the_level_of_paint_is_read_at_its_levels(power):
    """Where neighbouring levels differ much, as the noise of bright ones must not be read at dark ones."""
    levels = np.random.default_rng(2).uniform(0.1, 0.8, (8, 12))
    clean = np.kron(levels, np.ones((16, 16)))
    noise = np.random.default_rng(3).standard_normal((3, *SHAPE)) * 0.1 * clean**power
    stabiliser = estimate(rounded(clean + noise)).stabiliser
    ratio = stabiliser.sigma_at(0.7, 1) / stabiliser.sigma_at(0.2, 1)
    assert ratio == pytest.approx(3.5**power, rel=0.25)


@pytest.mark.parametrize("columns", [32, 64, 128])
def test_noise_in_a_part_is_read_there_and_nowhere_else(columns):
    noise = np.random.default_rng(4).normal(0, 12 / 255, (3, *SHAPE))
    noise[:, :, columns:] = 0
    model = estimate(rounded(painting(0) + noise))
    deviations = model.overall * np.sqrt(model.relative[0])
    assert deviations[:, : columns - 16].mean() == pytest.approx(12 / 255, rel=0.3)
    assert deviations[:, columns + 32 :].mean() < 2 / 255


def as_kept(image, quality):
    """Return what a camera keeps of an image: luma blurred a little, chroma more, and both compressed."""
    luma = image @ np.array([0.299, 0.587, 0.114], np.float32)
    chroma = gaussian_filter(image - luma[..., None], (1.5, 1.5, 0))
    file = io.BytesIO()
    kept = rounded(gaussian_filter(luma, 0.6)[..., None] + chroma)
    Image.fromarray(np.rint(255 * kept).astype(np.uint8)).save(file, "JPEG", quality=quality)
    return np.asarray(Image.open(file), np.float32) / 255


@pytest.mark.parametrize("quality", [85, 92])
@pytest.mark.parametrize("shot", [0.002, 0.006])
def test_weak_noise_that_a_camera_denoised_and_compressed_is_found(quality, shot):
    """Within a factor of 2, on an image whose finest detail spans some texels."""
    clean = gaussian_filter(photograph(256, contrast=0.1), (1, 1, 0)).astype(np.float32)
    noisy, without = (as_kept(by_camera(clean, *noise), quality) for noise in ((shot, 0.004), (1e-9, 1e-6)))
    truth = np.sqrt(np.mean(np.square(noisy - without)))
    assert truth / 2 < estimate(noisy.transpose(2, 0, 1)).overall < 2 * truth


@pytest.mark.parametrize("seed", range(3))
def test_the_size_of_opposite_noise_is_read_on_slopes_of_light(seed):
    model = estimate(painting(12, seed, covariance=[[1.01, -1, 0], [-1, 1.01, 0], [0, 0, 0.01]]))
    assert model.overall == pytest.approx(12 / 255 * np.sqrt(2.03 / 3), rel=0.1)


def test_large_images_are_read_in_some_squares():
    filled = np.ones((2048, 3000), bool)
    corners = choose_corners(filled, MAX_SQUARES)
    assert len(corners) == MAX_SQUARES
    assert not (corners % SIDE).any()
    counts = np.histogram2d(*corners.T, bins=4, range=((0, 2048), (0, 3000)))[0]
    assert counts.min() >= MAX_SQUARES / 16 / 2
