"""Noise that neighbouring cells have in common: found in what JPEG left, drawn as asked, and errors right with it."""

from functools import partial

import numpy as np
import OpenImageIO
import pytest
from scipy.ndimage import gaussian_filter

import beltrami_cli
from beltrami_cli.flow.choice.risk import RiskEstimate
from beltrami_cli.flow.manifolds.iteration import Step
from beltrami_cli.flow.noise.components import sigma_of_covariances
from beltrami_cli.flow.noise.drawing import draw_on_grid
from flow.noisy_surfaces import by_camera, in_8_bits, noise_of_image
from flow.test_choice import Blur
from formats.image_files import encode
from oracles.pictures import shapes

LUMA = np.full((3, 3), 1 / 3)
SHARED = np.array([LUMA + share * (np.eye(3) - LUMA) for share in (0.1, 0.3, 0.8, 1.0)])


def phantom(size=96):
    """Return shapes that are a bit soft."""
    return gaussian_filter(shapes(size), (1, 1, 0))


def stored(clean, sigma, seed=5):
    """Return an image with noise of `sigma` of 255, in 8 bit."""
    noisy = 255 * clean + sigma * np.random.default_rng(seed).standard_normal(clean.shape)
    return np.rint(noisy.clip(0, 255)).astype(np.uint8)


def jpeg(pixels, quality, subsampling, tmp_path):
    """Return what JPEG makes of pixels, in [0, 1]."""
    path = tmp_path / "a.jpg"
    path.write_bytes(encode(pixels, "jpeg", compression=f"jpeg:{quality}", jpeg__subsampling=subsampling))
    return OpenImageIO.ImageBuf(str(path)).get_pixels("float")


found = partial(noise_of_image, varies=False)


def details(noise):
    """Return the three details of squares of 2 x 2 cells, of unit noise if that is independent; and the means."""
    a, b, c, d = (noise[:, i::2, j::2] for i in (0, 1) for j in (0, 1))
    return np.stack([a - b + c - d, a + b - c - d, a - b - c + d], axis=1) / 2, (a + b + c + d) / 4


def test_drawn_noise_has_the_covariances_that_were_given():
    """In every octave, to four standard errors: of 16,384 and more coefficients, a covariance is known to 1 %."""
    noise = draw_on_grid(SHARED, (512, 512), np.random.default_rng(0))
    assert noise.var(axis=(1, 2)) == pytest.approx(sigma_of_covariances(SHARED) ** 2, rel=0.04)
    for level, given in enumerate(SHARED[:3]):
        fine, noise = details(noise)
        drawn = np.cov(2**level * fine.reshape(3, -1))
        assert np.abs(drawn - given).max() < 0.04


def test_the_estimated_error_is_the_true_one_where_neighbours_share_noise():
    """Over many draws within four standard errors and 3 per cent of the noise; by independent signs it is far off."""
    clean, sigma = phantom(64), 0.06
    covariances = sigma**2 * SHARED
    own = sigma_of_covariances(covariances)
    step = Step(beta=1 / sigma, t=2.4, regularised=False)
    differences = {"like": [], "unlike": []}
    for seed in range(30):
        random = np.random.default_rng(seed)
        noise, like = (np.moveaxis(draw_on_grid(covariances, (64, 64), random), 0, 2) for _ in range(2))
        like = like / np.sqrt(np.mean(own**2))
        for name, signs in (("like", like), ("unlike", random.choice([-1.0, 1.0], clean.shape))):
            estimate = RiskEstimate.on(Blur(clean + noise, signs[None]), own)
            state = estimate.step(estimate.step(estimate.start, step), step)
            true = np.mean((state.plain - clean) ** 2)
            differences[name].append((estimate.risk(state).value - true) / np.mean(own**2))
    error = np.std(differences["like"], ddof=1) / np.sqrt(30)
    assert abs(np.mean(differences["like"])) < 4 * error + 0.03
    assert error < 0.02  # or the test could not fail
    assert np.mean(differences["unlike"]) < -0.07


@pytest.mark.slow
@pytest.mark.parametrize(("quality", "subsampling", "sigma"), [(80, "4:4:4", 12), (92, "4:2:0", 20)])
def test_the_noise_that_jpeg_left_is_found(quality, subsampling, sigma, tmp_path):
    """Within a third of what JPEG made of a plain picture with that noise; a fourth channel keeps its own."""
    image = jpeg(stored(phantom(512), sigma), quality, subsampling, tmp_path)
    left = jpeg(stored(np.full((512, 512, 3), 0.5), sigma), quality, subsampling, tmp_path) - 128 / 255
    alpha = 0.5 + 0.03 * np.random.default_rng(1).standard_normal((512, 512, 1))
    noise = found(np.concatenate([image, alpha], axis=2))
    assert noise.sigma[:3] == pytest.approx(left.std(axis=(0, 1)), rel=1 / 3)
    assert noise.sigma[3] == pytest.approx(0.03, rel=0.1)


def one_hue(hue, side=192):
    """Return a disc on a slope, in shades of a hue: in others JPEG leaves up to half of the finest noise of its own."""
    y, x = np.mgrid[:side, :side] / side
    disc = (x - 0.45) ** 2 + (y - 0.5) ** 2 < 0.08
    return gaussian_filter(np.where(disc, 0.9, 0.45 + 0.2 * x), 1)[:, :, None] * np.array(hue)


@pytest.mark.parametrize(
    ("clean", "quality", "subsampling", "sigma", "tolerance"),
    [
        (one_hue((1, 0.7, 0.1)), 92, "4:2:0", 6, 0.15),
        (one_hue((0.1, 0.8, 0.3)), 85, "4:4:4", 10, 0.15),
        (phantom(96), 85, "4:2:0", 20, 0.3),
        (phantom(144), 85, "4:2:0", 20, 0.3),
    ],
    ids=["orange", "green", "small", "less small"],
)
def test_the_noise_that_jpeg_left_in_rich_colours_and_small_pictures_is_found(
    clean, quality, subsampling, sigma, tolerance, tmp_path
):
    image = jpeg(stored(clean, sigma), quality, subsampling, tmp_path)
    read = np.sqrt(np.mean(np.square(found(image).sigma)))
    assert read == pytest.approx(np.sqrt(np.mean((image - clean) ** 2)), rel=tolerance)


def test_the_channel_with_more_of_the_noise_is_known():
    """To a fifth, as of a blue sky with a camera; differences alone would give red and blue the same."""
    sigma = np.array([11, 8, 5]) / 255
    sky = np.array([0.3, 0.45, 0.6]) + 0.1 * np.linspace(0, 1, 256)[:, None, None]
    soft = gaussian_filter(np.random.default_rng(3).standard_normal((256, 256, 3)), (1, 1, 0))
    assert found(sky + soft / soft.std(axis=(0, 1)) * sigma).sigma == pytest.approx(sigma, rel=0.2)


@pytest.mark.parametrize("colour", [(0.4, 0.4, 0.4), (0.6, 0.2, 0.3)])
def test_the_noise_of_a_camera_in_plain_pictures_is_known_to_a_fifth(colour):
    """In each channel: too little leaves some of it, and too much takes detail."""
    plain = np.broadcast_to(np.float32(colour), (256, 256, 3))
    noisy = by_camera(plain)
    ratio = found(noisy).sigma / (noisy - plain).std(axis=(0, 1))
    assert ratio == pytest.approx(1, abs=0.2)


def test_jpeg_without_noise_stays(tmp_path):
    image = jpeg(stored(phantom(256), 0), 80, "4:2:0", tmp_path)
    result = beltrami_cli.smooth_image(image, space="data")
    assert np.mean(np.square(result.colours - image)) < 10**-4.5


@pytest.mark.slow
@pytest.mark.parametrize("dark", [0.0, 1.0])
def test_noise_that_cells_share_makes_black_no_brighter_and_white_no_darker(dark):
    """Its mean after clipping is 0.4 standard deviations away, next to an edge as well; a third of that may be left."""
    clean = np.full((128, 128, 3), 0.5)
    clean[:, :64] = dark
    noise = gaussian_filter(np.random.default_rng(7).standard_normal(clean.shape), (0.8, 0.8, 0))
    sigma = 12 / 255
    smooth = beltrami_cli.smooth_image(in_8_bits(clean + sigma / noise.std() * noise))
    assert smooth.choice.correlated
    off = np.abs(smooth.colours[:, :62] - dark)
    assert off.mean() < 0.13 * sigma
