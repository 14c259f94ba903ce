"""Noise of cameras, grain and JPEG: as these make it, on the surface or in the flat picture."""

import io

import numpy as np
import PIL.Image
import pytest
from scipy.ndimage import convolve

from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.jobs.noise.file import noise_file
from beltrami_cli.jobs.settings import NoiseSettings
from beltrami_cli.surface.colour_values import srgb_to_linear
from cli.commands import SAMPLES
from formats.image_files import encode, stored
from jobs.cut_boards import CHART, FIRST, STRIDE, write_board

# Standard errors that a figure of one seeded draw may be off by: 6e-5 of all draws are further off.
ERRORS = 4
SHOT, READ = 0.004, 0.01


def flat_image(path, levels, side=96):
    """Stripes of some levels in sRGB, in 16 bits."""
    stripes = np.repeat(np.asarray(levels), side)[:, None, None]
    pixels = np.broadcast_to(np.rint(65535 * stripes), (len(stripes), side, 3)).astype(np.uint16)
    path.write_bytes(encode(np.ascontiguousarray(pixels), "png"))
    return path


def light_of_file(path):
    return srgb_to_linear((stored(path) / 65535).astype(np.float64))


@pytest.mark.slow
def test_the_variance_of_a_camera_grows_with_the_light(tmp_path):
    camera = NoiseSettings(kind="camera", shot=SHOT, read=READ, seed=3)
    levels = np.repeat([0.4, 0.6, 0.8], 20_000)
    colours = np.repeat(levels[:, None], 3, axis=1).astype(np.float32)
    np.savez(tmp_path / "c.npz", positions=np.random.default_rng(1).random((len(levels), 3)), colours=colours)
    noise_file(tmp_path / "c.npz", tmp_path / "n.npz", camera)
    made = srgb_to_linear(np.load(tmp_path / "n.npz")["colours"].astype(np.float64))
    noise_file(flat_image(tmp_path / "i.png", [0.4, 0.6, 0.8]), tmp_path / "n.png", camera)
    # Where red was measured, it has the noise of the sensor; elsewhere that of means of two and four.
    red = light_of_file(tmp_path / "n.png").reshape(3, 96, 96, 3)[:, ::2, ::2, 0]
    for index, level in enumerate((0.4, 0.6, 0.8)):
        light = float(srgb_to_linear(np.array(level)))
        expected = SHOT * light + READ**2
        for values in (made[levels == level].ravel(), red[index].ravel()):
            assert values.mean() == pytest.approx(light, abs=ERRORS * (expected / values.size) ** 0.5)
            assert values.var() == pytest.approx(expected, rel=ERRORS * (2 / values.size) ** 0.5)


def test_a_camera_without_noise_demosaics_bilinearly(tmp_path):
    image = np.random.default_rng(2).integers(9000, 60000, (40, 30, 3)).astype(np.uint16)
    (tmp_path / "a.png").write_bytes(encode(image, "png"))
    noise_file(tmp_path / "a.png", tmp_path / "b.png", NoiseSettings(kind="camera", shot=0, read=0))
    light = srgb_to_linear(image / 65535)
    masks = np.zeros((3, 40, 30))
    masks[0, ::2, ::2] = masks[2, 1::2, 1::2] = masks[1, ::2, 1::2] = masks[1, 1::2, ::2] = 1
    corner = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]]) / 4
    cross = np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]]) / 4
    expected = [convolve(light[..., k] * masks[k], cross if k == 1 else corner) for k in range(3)]
    inner = np.s_[1:-1, 1:-1]
    made = light_of_file(tmp_path / "b.png")[inner]
    np.testing.assert_allclose(made, np.stack(expected, axis=2)[inner], atol=2e-5)


def grain_of(path, size, tmp_path):
    """Return the change of an image by grain, in units of its deviation."""
    made = tmp_path / f"grain-{size}.png"
    noise_file(path, made, NoiseSettings(0.05, "grain", seed=4, grain_size=size))
    return (stored(made).astype(np.float64) - stored(path)) / (0.05 * 65535)


def correlation(change, lag):
    return float(np.mean(change[:, lag:] * change[:, :-lag]))


def test_grain_has_its_deviation_everywhere_and_reaches_as_far_as_its_size(tmp_path):
    path = flat_image(tmp_path / "a.png", [0.5] * 3, side=150)
    for size in (2, 3, 6):
        change = grain_of(path, size, tmp_path)
        assert change.std() == pytest.approx(1, abs=0.08)
        assert np.abs(np.square(change).reshape(450, -1, size, 3).mean(axis=(0, 1)) - 1).max() < 0.15
        assert correlation(change, max(1, size // 2)) > 0.4
        assert correlation(change, size) < 0.3
        assert abs(correlation(change, 2 * size)) < 0.12
        assert abs(np.corrcoef(change.reshape(-1, 3).T)[0, 1]) < 0.1


@pytest.mark.parametrize("kind", ["gaussian", "grain"])
def test_around_a_chart_is_the_noise_that_lies_there_across_the_seam(kind, tmp_path):
    image = np.full((48, 48, 3), 30000, np.uint16)
    settings = NoiseSettings(0.1, kind, grain_size=6 if kind == "grain" else 2)
    noise_file(write_board(tmp_path / "b.obj", image), tmp_path / "n.obj", settings)
    change = (stored(tmp_path / "n.png").astype(int) - 30000) / 6553.5
    inside = slice(FIRST, FIRST + CHART)
    left, right = change[inside, :STRIDE], change[inside, STRIDE:]
    for step in range(3):  # one rounding to 16 bits on either side
        np.testing.assert_allclose(left[:, FIRST + CHART + step], right[:, FIRST + step], atol=1e-3)
        np.testing.assert_allclose(right[:, FIRST - 1 - step], left[:, FIRST + CHART - 1 - step], atol=1e-3)
    if kind == "gaussian":
        assert left[:, inside].std() == pytest.approx(1, rel=ERRORS / (2 * CHART**2 * 3) ** 0.5)
        # Over the border of the board lies nothing: there, the nearest texel's noise is repeated.
        np.testing.assert_array_equal(left[:, FIRST - 1], left[:, FIRST])
    else:
        across = left[:, FIRST + CHART - 1] - right[:, FIRST]  # a texel apart, across the seam
        within = left[:, FIRST + CHART - 1] - left[:, FIRST + CHART - 2]
        assert np.square(across).mean() < 2 * np.square(within).mean() < 0.5


def test_grain_on_vertices_counts_in_their_spacing_and_is_one_at_one_place(tmp_path):
    side = 60
    places = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=2).reshape(-1, 2) * 0.01
    positions = np.column_stack([places, np.zeros(len(places))])
    positions = np.concatenate([positions, positions[:50]])  # some twice
    np.savez(tmp_path / "c.npz", positions=positions, colours=np.full((len(positions), 3), 0.5, np.float32))
    noise_file(tmp_path / "c.npz", tmp_path / "n.npz", NoiseSettings(0.05, "grain", grain_size=4))
    change = (np.load(tmp_path / "n.npz")["colours"].astype(np.float64) - 0.5) / 0.05
    np.testing.assert_array_equal(change[:50], change[-50:])
    grid = change[:-50].reshape(side, side, 3)
    assert grid.std() == pytest.approx(1, abs=0.1)
    assert correlation(grid, 1) > 0.8
    assert abs(correlation(grid, 8)) < 0.15


@pytest.mark.parametrize("quality", [30, 90])
def test_jpeg_is_what_the_codec_makes_of_the_picture(quality, tmp_path):
    clean = read_image((SAMPLES / "scan-clean.jpg").read_bytes(), "").pixels[:120, :90]
    (tmp_path / "a.png").write_bytes(encode(np.ascontiguousarray(clean), "png"))
    noise_file(tmp_path / "a.png", tmp_path / "b.png", NoiseSettings(kind="jpeg", quality=quality))
    file = io.BytesIO()
    PIL.Image.fromarray(clean).save(file, "JPEG", quality=quality, subsampling="4:2:0")
    expected = np.asarray(PIL.Image.open(file))
    np.testing.assert_array_equal(stored(tmp_path / "b.png"), expected)


def test_jpeg_codes_textures_as_they_lie_flat(tmp_path):
    image = np.random.default_rng(6).integers(60, 200, (48, 48, 3)).astype(np.uint8)
    noise_file(write_board(tmp_path / "b.obj", image), tmp_path / "n.obj", NoiseSettings(kind="jpeg"))
    (tmp_path / "flat.png").write_bytes(encode(image, "png"))
    noise_file(tmp_path / "flat.png", tmp_path / "coded.png", NoiseSettings(kind="jpeg"))
    inside = slice(FIRST, FIRST + CHART)
    coded, made = stored(tmp_path / "coded.png"), stored(tmp_path / "n.png")
    np.testing.assert_array_equal(made[inside, inside], coded[inside, inside])
