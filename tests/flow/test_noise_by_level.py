"""Noise that depends on the level of colours, noise that is given, and noise that is removed from coarse to fine."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import beltrami_cli
from beltrami_cli._native import add_enlarged, means_of_squares, sort_squares
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.noise import by_level
from beltrami_cli.flow.noise.by_level import OPPONENTS, Neighbourhoods, fit_by_level, stabiliser_of
from beltrami_cli.flow.noise.given import given_noise
from beltrami_cli.flow.noise.grid_scales import find_grid_noise
from beltrami_cli.flow.noise.haar_noise import sigma_of_covariances
from beltrami_cli.flow.noise.stabilising import VarianceStabiliser
from beltrami_cli.surface.atlas import EMPTY, HALO, OWNED
from beltrami_cli.surface.records import linear_to_srgb, srgb_to_linear
from oracles.surfaces import icosphere

SHOT, READ = 0.004, 0.005


def scene(size=192):
    """Return an image of slopes from dark to bright and of a few soft shapes, shape (R, C, 3)."""
    y, x = np.mgrid[:size, :size] / size
    shapes = gaussian_filter(np.where((x - 0.5) ** 2 + (y - 0.4) ** 2 < 0.05, 0.15, 0.0), 1)
    return (0.15 + 0.6 * x[..., None] + shapes[..., None] * [1.0, 0.6, -0.3]).astype(np.float32)


def shot(clean, seed=0):
    """Return colours with the noise of a camera in linear light, each sample by itself."""
    light = srgb_to_linear(np.asarray(clean)).astype(float)
    noise = np.random.default_rng(seed).standard_normal(clean.shape) * np.sqrt(SHOT * light + READ**2)
    return linear_to_srgb(np.clip(light + noise, 0, 1)).astype(np.float32)


def psnr(result, clean):
    return -10 * np.log10(np.mean((np.asarray(result, float) - clean) ** 2))


def found(image, *, by_level=True):
    planes = np.ascontiguousarray(np.moveaxis(image, 2, 0), np.float32)
    return find_grid_noise(planes, np.ones(planes.shape[1:], bool), by_level=by_level)


def test_stabilised_colours_come_back_and_limits_stay():
    """To the rounding of float32, within the limits and beyond."""
    colours = np.linspace(-0.5, 1.5, 3000, dtype=np.float32).reshape(3, -1)
    stabiliser = VarianceStabiliser(np.array([0.1, 0.5, 0.9]), np.array([2.0, 1.0, 0.5]), np.ones(3))
    there = colours.copy()
    stabiliser.stabilise(there)
    assert (np.diff(there.reshape(-1)) > 0).all()
    limits = np.array([[0, 1]] * 3, np.float32)
    stabiliser.stabilise(limits)
    assert (limits == [0, 1]).all()
    stabiliser.restore(there)
    assert there == pytest.approx(colours, abs=1e-6)


@pytest.mark.parametrize("level", [0.1, 0.9])
def test_the_noise_of_a_camera_is_even_once_it_is_stabilised(level):
    """Of 100,000 samples a standard deviation is known to 0.3 per cent; the curve counts small noise only."""
    stabiliser = given_noise(f"shot:{SHOT},read:{READ}").stabiliser()
    values = shot(np.full((3, 100_000), level))
    own = values.std()
    stabiliser.stabilise(values)
    assert values.std() == pytest.approx(stabiliser.scale, rel=0.1)
    assert stabiliser.sigma_at(level, stabiliser.scale) == pytest.approx(own, rel=0.1)


def test_noise_by_level_is_found_where_there_is_such_and_only_there():
    """Between levels of 0.2 and 0.7 the ratio is that of the camera within a fifth."""
    clean = scene(256)
    truth = given_noise(f"shot:{SHOT},read:{READ}").stabiliser()
    seen = found(shot(clean)).stabiliser
    ratio = seen.sigma_at(0.2, 1) / seen.sigma_at(0.7, 1)
    assert ratio == pytest.approx(truth.sigma_at(0.2, 1) / truth.sigma_at(0.7, 1), rel=0.2)
    assert ratio > 1.3  # or there was nothing to find
    white = clean + 0.04 * np.random.default_rng(1).standard_normal(clean.shape)
    assert found(white).stabiliser is None
    assert found(shot(clean), by_level=False).stabiliser is None
    assert found(shot(clean) - 0.5).stabiliser is None  # numbers below 0 are no levels


def test_the_level_of_noise_is_that_of_its_channel():
    """Red of a blue sky is darker than its blue; the mean of channels differs less than channels do."""
    sky = np.linspace(0, 1, 256)[:, None, None] * [0.15, 0.15, 0.2] + [0.15, 0.25, 0.5]
    clean = np.broadcast_to(sky, (256, 256, 3)).astype(np.float32)
    truth = given_noise(f"shot:{SHOT},read:{READ}").stabiliser()
    seen = found(shot(clean)).stabiliser
    ratio, true = (each.sigma_at(0.2, 1) / each.sigma_at(0.65, 1) for each in (seen, truth))
    assert ratio == pytest.approx(true, rel=0.1)


def test_texture_of_dark_places_is_no_noise_by_level():
    """Dark tiles hold texture, most of all in the mean of channels and at coarse scales; noise is 1 everywhere."""
    level = np.repeat(np.linspace(0.3, 0.9, 8), 200)
    dark = np.clip((0.9 - level) / 0.3, 0, 1)
    scales = []
    for texture in ([0.6, 0.05, 0], [3, 0.3, 0.2], [20, 3, 0.4]):
        energy = 1 + np.outer(texture, dark)
        noise = 1 + 0.05 * np.random.default_rng(3).standard_normal(energy.shape)
        scales.append(Neighbourhoods(energy * noise, dark, np.stack([level] * 3), 48))
    found_at = fit_by_level(scales, OPPONENTS)
    assert stabiliser_of(found_at) is None
    assert found_at.sigma[0, 1:] == pytest.approx(1, abs=0.05)


def mostly_white(seed, size=224):
    """Return planes: a third has blurred noise of 4 of 255 on a texture that is stronger here and weaker there."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[:size, :size] / size
    texture = gaussian_filter(random.standard_normal((3, size, size)), (0, 3, 3))
    contrast = 0.06 * np.clip(24 * np.abs(y % 0.25 - 0.125) - 1, 0, 2)
    clean = np.where(x < 0.3, 0.3 + 0.5 * y + contrast * texture / texture.std(), 1)
    noise = gaussian_filter(random.standard_normal(clean.shape), (0, 0.7, 0.7))
    return np.float32(np.rint(255 * np.clip(clean + 4 / 255 * noise / noise.std(), 0, 1)) / 255)


def test_texture_of_few_tiles_is_no_shared_noise():
    """Where six tiles are most of a level, some hold texture, which would show a fifth to three quarters too much."""
    planes = mostly_white(0)
    noise = find_grid_noise(planes, np.ones(planes.shape[1:], bool), by_level=False)
    assert 255 * sigma_of_covariances(noise.covariances) == pytest.approx(np.full(3, 4), rel=0.15)


def test_hardly_any_neighbourhoods_without_texture_are_left_out():
    """Of those of twelve values each: in some of a thousand draws at most."""
    random = np.random.default_rng(0)
    counts = [by_level._free_of_texture(random.chisquare(12, (3, 6))) for _ in range(1000)]
    assert np.mean(np.array(counts) == 6) > 0.995


# Deviations of 255 in tiles as of a photographed statue of stone, kept as JPEG after noise of 20 was added: by scale,
# for the mean of channels and their differences, at six levels from dark to bright.
STONE = [
    [[20.9, 30.8, 30.8, 32, 31.5, 28.7], [3.9, 3.9, 4.3, 4.1, 3.8, 3.3], [3.7, 3.9, 4, 4.2, 3.8, 3.3]],
    [[22.1, 41.9, 44.7, 47.4, 51.5, 41.6], [9.2, 7.3, 7.7, 7.2, 7.6, 7.1], [9, 7.3, 7.4, 7.8, 6.7, 7.3]],
    [
        [20.7, 55.1, 91.3, 75.3, 74.9, 69],
        [13.9, 13.8, 16.7, 13.5, 13.6, 13.2],
        [13.5, 12.1, 13.8, 14, 12.5, 13.9],
    ],
    [[21.5, 98.2, 123, 170, 153, 116], [17.6, 17.8, 19, 19, 16.8, 15.1], [16.6, 17.4, 15.9, 18, 14.5, 14.5]],
]


def test_a_texture_that_all_levels_but_the_darkest_have_is_no_noise_by_level():
    counts = [499, 250, 250, 249, 250, 501]
    ranges = [(0.08, 0.1), (0.25, 0.29), (0.34, 0.38), (0.4, 0.43), (0.44, 0.47), (0.49, 0.53)]
    level = np.concatenate([np.linspace(*ends, n) for ends, n in zip(ranges, counts, strict=True)])
    energies = np.square(np.repeat(STONE, counts, axis=2))
    values = 48, 48, 12, 12
    scales = [
        Neighbourhoods(e, e[0], np.stack([level] * 3), n) for e, n in zip(energies, values, strict=True)
    ]
    found_at = fit_by_level(scales, OPPONENTS)
    assert len(found_at.levels) == 6
    assert stabiliser_of(found_at) is None
    assert found_at.sigma[:, 0] == pytest.approx(20, rel=0.2)


@pytest.mark.slow
def test_noise_by_level_is_smoothed_better_than_noise_of_one_size():
    """On an image and on a surface; and the noise that is told lies between that of dark and bright colours."""
    clean = scene()
    noisy = shot(clean)
    even = beltrami_cli.smooth_image(noisy, noise=f"{(noisy - clean).std()}")
    result = beltrami_cli.smooth_image(noisy)
    assert psnr(result.colours, clean) > psnr(even.colours, clean)
    positions, faces = icosphere(5)
    colours = np.repeat(0.5 + 0.4 * positions[:, :1], 3, axis=1).astype(np.float32)
    rough = shot(colours)
    smoothed = beltrami_cli.smooth(positions, faces, rough)
    assert psnr(smoothed.colours, colours) > psnr(rough, colours) + 8


def test_given_noise_is_used():
    clean = scene(96)
    noisy = (clean + 0.02 * np.random.default_rng(0).standard_normal(clean.shape)).astype(np.float32)
    changes = []
    for noise in ("1", "5", "20"):
        result = beltrami_cli.smooth_image(noisy, noise=noise, fast=True)
        assert result.noise == pytest.approx(np.full(3, float(noise) / 255))
        changes.append(np.abs(result.colours - noisy).mean())
    assert changes == sorted(changes)


@pytest.mark.parametrize(
    ("text", "sigma"),
    [("12", 12 / 255), ("12/255", 12 / 255), ("0.047", 0.047), ("4.7%", 0.047), ("1", 1 / 255)],
)
def test_given_noise_is_of_255_or_of_full_scale(text, sigma):
    assert given_noise(text).sigma == pytest.approx(sigma)


@pytest.mark.parametrize(
    "text", ["", "much", "-3", "300", "nan", "1/0", "shot:1", "shot:x,read:1", "shot:2,read:0"]
)
def test_other_words_are_no_noise(text):
    with pytest.raises(UsageError, match="noise is"):
        beltrami_cli.smooth_image(scene(16), noise=text)


def test_camera_noise_is_of_srgb_colours():
    with pytest.raises(UsageError, match="--space"):
        beltrami_cli.smooth_image(scene(16), noise="shot:0.01,read:0.01", space="linear")


def test_means_are_of_owned_cells_and_changes_go_to_them():
    """Squares that hold owned cells mean these alone; a change of all squares is that of all owned cells."""
    random = np.random.default_rng(0)
    kind = random.choice(np.array([EMPTY, OWNED, HALO], np.uint8), (13, 22))
    planes = random.random((2, 13, 22)).astype(np.float32)
    kinds, counts = sort_squares(kind, 4)
    means = means_of_squares(kind, kinds, planes, 4, 2)
    assert means.shape == (2, 4, 6)
    for row, column in np.ndindex(4, 6):
        cells = np.s_[4 * row : 4 * row + 4, 4 * column : 4 * column + 4]
        for wanted in (OWNED, HALO):
            if (kind[cells] == wanted).any():
                assert kinds[row, column] == wanted
                mean = planes[:, *cells][:, kind[cells] == wanted].mean(axis=1)
                assert means[:, row, column] == pytest.approx(mean, rel=1e-5)
                assert counts[row, column] == np.count_nonzero(kind[cells] == wanted)
                break
    after = planes.copy()
    add_enlarged(kind, kinds, np.full_like(means, 0.25), after, 4, 2)
    assert (after - planes)[:, kind == OWNED] == pytest.approx(0.25, abs=1e-6)
    assert (after == planes)[:, kind != OWNED].all()


@pytest.mark.parametrize("size", [2, 4])
def test_coarse_grain_is_removed(size):
    """Of 12 of 255, as large as some texels, to a third and less; finest details alone would show a fifth of it."""
    clean, random = scene(), np.random.default_rng(2)
    coarse = random.standard_normal((3, 192 // size, 192 // size))
    grain = 12 / 255 * np.moveaxis(np.repeat(np.repeat(coarse, size, 1), size, 2), 0, 2)
    grain = gaussian_filter(grain, (size / 3, size / 3, 0))
    noisy = (clean + grain).astype(np.float32)
    result = beltrami_cli.smooth_image(noisy)
    assert psnr(result.colours, clean) > psnr(noisy, clean) + 9.5
    assert result.noise == pytest.approx(np.full(3, grain.std()), rel=1 / 3)
