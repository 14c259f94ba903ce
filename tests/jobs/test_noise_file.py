"""Noise is what it is said to be, lies on the surface, and changes nothing but colours."""

import numpy as np
import pytest
from scipy.stats import kstest

from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.jobs.check import check_files
from beltrami_cli.jobs.noise.file import noise_file
from beltrami_cli.jobs.noise.kinds import NumberedSamples, add_noise
from beltrami_cli.jobs.settings import NoiseSettings
from beltrami_cli.layers.settings import SmoothSettings, TextureSettings
from beltrami_cli.quantities import amount_in, unambiguous_amount_in
from cli.commands import SAMPLES, beltrami
from formats.image_files import encode, stored
from jobs.cut_boards import cut, write_board

SIGMA = 20 / 255
# Standard errors that a figure of one seeded draw may be off by: 6e-5 of all draws are further off.
ERRORS = 4


def noisy(level, kind, sigma=SIGMA, count=40_000):
    targets = NumberedSamples(np.full((count, 3), level, np.float32), np.arange(count))
    return add_noise(targets, NoiseSettings(sigma, kind, seed=5)).astype(float)


@pytest.mark.parametrize(
    ("kind", "deviation"),
    [
        ("gaussian", lambda level: SIGMA),
        ("speckle", lambda level: SIGMA * level),
        ("poisson", lambda level: SIGMA * level**0.5),
    ],
)
@pytest.mark.parametrize("level", [0.4, 0.6])  # 5 deviations and more from where it would be cut off
def test_the_deviation_is_what_was_asked_for_and_the_mean_stays(kind, deviation, level):
    values = noisy(level, kind)
    expected = deviation(level)
    for channel in values.T:
        assert channel.mean() == pytest.approx(level, abs=ERRORS * expected / len(channel) ** 0.5)
        assert channel.std() == pytest.approx(expected, rel=ERRORS / (2 * len(channel)) ** 0.5)
    correlation = np.corrcoef(values.T)[np.triu_indices(3, 1)]
    assert np.abs(correlation).max() < ERRORS / len(values) ** 0.5


def test_gaussian_noise_is_gaussian_and_poisson_noise_is_counts():
    assert kstest((noisy(0.5, "gaussian")[:, 0] - 0.5) / SIGMA, "norm").pvalue > 1e-3
    counts = noisy(0.5, "poisson")[:, 0] / SIGMA**2
    assert np.abs(counts - np.rint(counts)).max() < 1e-4  # float32 of counts up to some 100


def test_salt_and_pepper_make_the_share_of_samples_white_or_black_and_leave_the_others():
    share, count = 0.1, 40_000
    values = noisy(0.3, "salt-pepper", share, count)
    assert (values == values[:, :1]).all()
    error = ERRORS * (share / 2 / count) ** 0.5
    assert np.mean(values[:, 0] == 0) == pytest.approx(share / 2, abs=error)
    assert np.mean(values[:, 0] == 1) == pytest.approx(share / 2, abs=error)
    assert np.mean(values[:, 0] == np.float32(0.3)) == pytest.approx(1 - share, abs=2 * error)


@pytest.mark.parametrize("kind", ["gaussian", "speckle", "poisson", "salt-pepper"])
def test_colours_in_range_stay_there_and_those_beyond_are_not_cut_off(kind):
    inside = np.linspace(0, 1, 3000, dtype=np.float32).reshape(-1, 3)
    made = add_noise(NumberedSamples(inside, np.arange(1000)), NoiseSettings(0.3, kind))
    assert made.min() >= 0
    assert made.max() <= 1
    bright = 4 * inside
    made = add_noise(NumberedSamples(bright, np.arange(1000)), NoiseSettings(0.3, kind))
    assert made.min() >= 0
    assert made.max() > 3.5
    assert made.dtype == np.float32


def test_vertices_at_one_place_get_one_noise_whatever_their_colours(tmp_path):
    rng = np.random.default_rng(3)
    places = np.repeat(rng.random((40, 3)).astype(np.float32), 3, axis=0)
    colours = rng.uniform(0.4, 0.6, (120, 3)).astype(np.float32)
    colours[::3] = colours[1::3]  # of the three at a place, two have one colour
    np.savez(tmp_path / "cloud.npz", positions=places, colours=colours)
    noise_file(tmp_path / "cloud.npz", tmp_path / "out.npz", NoiseSettings(0.05, seed=2))
    change = np.load(tmp_path / "out.npz")["colours"].astype(float) - colours
    change = change.reshape(40, 3, 3)
    # float32 differences of numbers below 1, converted once there and back
    assert np.abs(change - change[:, :1]).max() < 1e-6
    assert change[:, 0].std() == pytest.approx(0.05, rel=ERRORS / 240**0.5)


def test_the_gutter_can_be_kept(tmp_path):
    image = cut(np.full((32, 32, 3), 128, np.uint8))
    kept = SmoothSettings(textures=TextureSettings(gutter=None))
    noise_file(write_board(tmp_path / "b.obj", image), tmp_path / "n.obj", NoiseSettings(0.1), kept)
    made = stored(tmp_path / "n.png")
    assert (made[image == 0] == 0).all()
    assert (made[image != 0] != 128).mean() > 0.9


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("nonmanifold-clean.glb", "gaussian"),
        pytest.param("torus-two-clean.gltf", "poisson", marks=pytest.mark.slow),
        ("sphere-exr-clean.obj", "gaussian"),
        ("nonmanifold-clean.ply", "camera"),
        ("nonmanifold-clean.ply", "grain"),
        pytest.param("tiled-clean.glb", "grain", marks=pytest.mark.slow),
    ],
)
def test_nothing_but_colours_differs_and_the_seed_decides(name, kind, tmp_path):
    def made(folder, seed, threads):
        (tmp_path / folder).mkdir()
        settings = SmoothSettings(kernel=KernelParameters(threads=threads))
        noise_file(SAMPLES / name, tmp_path / folder / name, NoiseSettings(SIGMA, kind, seed), settings)
        return {path.name: path.read_bytes() for path in (tmp_path / folder).iterdir()}

    first = made("a", 1, 1)
    assert made("b", 1, 3) == first
    assert made("c", 2, 1) != first
    report = check_files(SAMPLES / name, tmp_path / "a" / name)
    assert report.faithful
    assert report.differences


def test_alpha_type_and_what_cannot_be_seen_stay(tmp_path):
    pixels = np.full((30, 20, 4), 30000, np.uint16)
    pixels[..., 3] = np.arange(20) * 3000
    (tmp_path / "a.png").write_bytes(encode(pixels, "png"))
    noise_file(tmp_path / "a.png", tmp_path / "b.png", NoiseSettings(0.1))
    made = stored(tmp_path / "b.png")
    assert made.dtype == np.uint16
    np.testing.assert_array_equal(made[..., 3], pixels[..., 3])
    np.testing.assert_array_equal(made[:, 0], pixels[:, 0])
    assert (made[:, 1:, :3] != 30000).mean() > 0.99


def test_grey_stays_one_channel_with_the_whole_deviation(tmp_path):
    (tmp_path / "a.png").write_bytes(encode(np.full((200, 200, 1), 30000, np.uint16), "png"))
    noise_file(tmp_path / "a.png", tmp_path / "b.png", NoiseSettings(0.1))
    made = stored(tmp_path / "b.png")
    assert made.shape == (200, 200, 1)
    assert made.std() / 65535 == pytest.approx(0.1, rel=ERRORS / (2 * 40_000) ** 0.5)


def test_no_noise_is_the_file_itself(tmp_path):
    for name in ("head-clean.ply", "head-tex-clean.glb", "head-tex-clean.png"):
        noise_file(SAMPLES / name, tmp_path / name, NoiseSettings(0.0))
        assert (tmp_path / name).read_bytes() == (SAMPLES / name).read_bytes()


def test_an_amount_is_of_255_or_a_fraction():
    for text in ("20", "20/255", " 5140/65535", f"{2000 / 255}%"):
        assert unambiguous_amount_in(text) == pytest.approx(20 / 255, rel=1e-12)
    assert amount_in("0.5") == 0.5 / 255
    assert (unambiguous_amount_in("0"), unambiguous_amount_in("1")) == (0, 1 / 255)


def test_the_command_adds_what_it_is_asked_for(tmp_path):
    noise_file(SAMPLES / "knot-clean.ply", tmp_path / "a.ply", NoiseSettings(SIGMA, "poisson", 7))
    arguments = ["noise", SAMPLES / "knot-clean.ply", tmp_path / "b.ply", "--sigma", 20, "--kind", "poisson"]
    run = beltrami(*arguments, "--seed", 7, "--threads", 3)
    assert b"poisson noise, root mean square change " in run.stderr
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()
    beltrami(*arguments, code=4)  # it exists


def test_that_jpeg_takes_noise_away_is_said(tmp_path):
    jpeg = SAMPLES / "scan-clean.jpg"
    for target, reported in (("a.jpg", 1), ("a.png", 0)):
        warnings = noise_file(jpeg, tmp_path / target, NoiseSettings(SIGMA)).warnings
        assert sum("takes some of the noise away" in warning for warning in warnings) == reported
    of_texture = noise_file(SAMPLES / "scan-clean.glb", tmp_path / "a.glb", NoiseSettings(SIGMA))
    assert any("--texture-format" in warning for warning in of_texture.warnings)


def test_warnings_name_the_file(tmp_path):
    source = SAMPLES / "knot-clean.ply"
    run = beltrami("noise", source, tmp_path / "n.glb", "--sigma", 5)
    assert run.stderr.startswith(f"warning: {source}: ".encode())
    run = beltrami("noise", "-", tmp_path / "m.glb", "--sigma", 5, stdin=source.read_bytes())
    assert run.stderr.startswith(b"warning: <stdin>: ")
