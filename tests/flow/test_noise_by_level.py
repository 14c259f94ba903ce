"""Noise that depends on the level of colours, noise that is given, and the numbers that `info` reports of it."""

import json

import numpy as np
import OpenImageIO
import pytest
from scipy.ndimage import gaussian_filter

import beltrami_cli
from beltrami_cli._native import add_enlarged, means_of_squares
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.given_noise import GivenNoise
from beltrami_cli.flow.manifolds.grid.levels import sort_squares
from beltrami_cli.flow.noise.model import VarianceStabiliser
from beltrami_cli.jobs.inspect import inspect_file
from beltrami_cli.surface.atlas import EMPTY, HALO, OWNED
from beltrami_cli.surface.colour_values import linear_to_srgb, srgb_to_linear
from flow.noisy_surfaces import noise_of_image
from oracles.pictures import photograph

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


def test_stabilised_colours_come_back_and_limits_stay():
    """To the rounding of float32, within the limits and beyond."""
    colours = np.linspace(-0.5, 1.5, 3000, dtype=np.float32).reshape(3, -1)
    stabiliser = VarianceStabiliser(np.array([0.1, 0.5, 0.9]), np.array([2.0, 1.0, 0.5]), np.ones(3))
    there = colours.copy()
    stabiliser.stabilise_in_place(there)
    assert (np.diff(there.reshape(-1)) > 0).all()
    limits = np.array([[0, 1]] * 3, np.float32)
    stabiliser.stabilise_in_place(limits)
    assert (limits == [0, 1]).all()
    stabiliser.restore_in_place(there)
    assert there == pytest.approx(colours, abs=1e-6)


@pytest.mark.parametrize("level", [0.1, 0.9])
def test_the_noise_of_a_camera_is_even_once_it_is_stabilised(level):
    """Of 100,000 samples a standard deviation is known to 0.3 per cent; the curve counts small noise only."""
    stabiliser = VarianceStabiliser.of_camera(SHOT, READ)
    values = shot(np.full((3, 100_000), level))
    own = values.std()
    stabiliser.stabilise_in_place(values)
    assert values.std() == pytest.approx(stabiliser.scale, rel=0.1)
    assert stabiliser.sigma_at(level, stabiliser.scale) == pytest.approx(own, rel=0.1)


def test_noise_by_level_is_found_where_there_is_such_and_only_there():
    """The ratio between levels of 0.2 and 0.7 is no larger than that of the camera, but for a tenth."""
    clean = 0.05 + 1.2 * (scene(256) - 0.15)
    truth = VarianceStabiliser.of_camera(SHOT, READ)
    seen = noise_of_image(shot(clean)).stabiliser
    ratio = seen.sigma_at(0.2, 1) / seen.sigma_at(0.7, 1)
    assert 1.05 < ratio < 1.1 * truth.sigma_at(0.2, 1) / truth.sigma_at(0.7, 1)
    white = np.random.default_rng(1).standard_normal(clean.shape)
    assert noise_of_image(clean + 0.04 * white).stabiliser is None
    growing = noise_of_image(clean * (1 + 0.1 * white)).stabiliser  # 3.5 times as much at 0.7 in truth
    assert 1.3 < growing.sigma_at(0.7, 1) / growing.sigma_at(0.2, 1) < 4.5
    assert noise_of_image(shot(clean), varies=False).stabiliser is None
    assert noise_of_image(shot(clean) - 0.5).stabiliser is None  # numbers below 0 are no levels


AMOUNTS = {"12": 12 / 255, "12/255": 12 / 255, "0.047/1": 0.047, "4.7%": 0.047, "1": 1 / 255}


@pytest.mark.parametrize(("text", "sigma"), AMOUNTS.items())
def test_given_noise_is_of_255_or_of_full_scale(text, sigma):
    assert GivenNoise.parse(text).sigma == pytest.approx(sigma)


NO_AMOUNTS = ["", "much", "-3", "300", "nan", "1/0", "shot:1", "shot:x,read:1", "shot:2,read:0", "0.9"]


@pytest.mark.parametrize("text", NO_AMOUNTS)
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
@pytest.mark.uninstrumented
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
