"""Noise that is given for each sample, by an array, an image, a table or an attribute."""

import numpy as np
import OpenImageIO
import pytest

import beltrami_cli
from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.fields import override
from beltrami_cli.flow.given_noise import GivenNoise, file_of_noise
from beltrami_cli.flow.noise.reading import NoiseOfSamples
from beltrami_cli.jobs.settings import BakeSettings
from beltrami_cli.layers.sample_files import deviation_in_frame
from hostile.textured_models import ONCE, PICTURE, write_model
from oracles.pictures import photograph, psnr
from oracles.surfaces import icosphere
from small_models import COLOURED, ply

SIZE = 128
QUIET, LOUD = 4 / 255, 24 / 255


def halves(shape):
    """Return standard deviations that differ between the first and the second half of rows."""
    return np.where(np.arange(shape[0]) < shape[0] // 2, QUIET, LOUD)


def write(path, image, stored="uint8"):
    buffer = OpenImageIO.ImageBuf(np.ascontiguousarray(image, np.float32))
    assert buffer.write(str(path), stored)
    return path


def grey(seed=0):
    """Return a grey picture without noise, and one with more in its lower half."""
    clean = photograph(SIZE, contrast=0.05)[..., 0]
    noise = halves(clean.shape)[:, None] * np.random.default_rng(seed).standard_normal(clean.shape)
    return clean.astype(np.float32), np.clip(clean + noise, 0, 1).astype(np.float32)


@pytest.mark.parametrize(
    ("text", "found", "file"),
    [
        ("sigma.png", GivenNoise(source="sigma.png"), "sigma.png"),
        ("a 1/b.exr", GivenNoise(source="a 1/b.exr"), "a 1/b.exr"),
        ("frame:dark.tif", GivenNoise(source="dark.tif", kind="frame"), "dark.tif"),
        ("attribute:error", GivenNoise(source="error", kind="attribute"), ""),
        ("5%", GivenNoise(0.05), ""),
    ],
)
def test_a_file_is_known_by_its_extension(text, found, file):
    assert GivenNoise.parse(text) == found
    assert file_of_noise(text) == file


def test_variances_are_relative_to_their_mean_and_never_nothing():
    noise = NoiseOfSamples.of(np.array([[0.0, 0.0], [0.3, 0.1]], np.float32))
    assert noise.sigma == pytest.approx([0.3 / np.sqrt(2), 0.1 / np.sqrt(2)])
    assert noise.relative[1, 0] == pytest.approx(2)
    assert 0 < noise.relative[0, 0] < 0.01
    assert (NoiseOfSamples.of(np.zeros((3, 1), np.float32)).relative == 1).all()


@pytest.mark.slow
@pytest.mark.parametrize(("patches", "tolerance"), [("off", 1e-5), ("on", 1e-3)])
def test_the_same_number_everywhere_is_that_number(patches, tolerance):
    """To the rounding of float32, in which deviations are stored; that may also decide which patches are similar."""
    noise = 12 / 255 * np.random.default_rng(3).standard_normal((64, 64, 1))
    noisy = np.float32(0.4 + noise)  # which is read as independent
    one = beltrami_cli.smooth_image(noisy, noise="12", patches=patches)
    all_alike = beltrami_cli.smooth_image(noisy, noise=np.full(noisy.shape, 12 / 255), patches=patches)
    assert all_alike.colours == pytest.approx(one.colours, abs=tolerance)
    assert all_alike.noise == pytest.approx(one.noise)


def test_pixels_are_smoothed_by_their_own_noise():
    """One number for all is too much here and too little there."""
    clean, noisy = grey()
    mean = f"{100 * np.sqrt((QUIET**2 + LOUD**2) / 2)}%"
    one, own = (
        beltrami_cli.smooth_image(noisy, noise=noise).colours[..., 0]
        for noise in (mean, np.broadcast_to(halves(clean.shape)[:, None], clean.shape))
    )
    half = SIZE // 2
    assert psnr(own, clean) > psnr(one, clean) + 0.5
    assert psnr(own[:half], clean[:half]) > psnr(noisy[:half], clean[:half])


@pytest.mark.parametrize(("name", "stored"), [("a.png", "uint8"), ("a.png", "uint16"), ("a.exr", "float")])
def test_images_of_deviations_have_the_full_scale_one(name, stored, tmp_path):
    source = write(tmp_path / "in.png", grey()[1][..., None])
    sigma = write(tmp_path / name, np.full((SIZE, SIZE, 1), 12 / 255), stored)
    report = beltrami_cli.smooth_file(source, tmp_path / "out.png", noise=str(sigma))
    assert report.image.noise["grey"] == pytest.approx(12 / 255, rel=1e-3)


@pytest.mark.parametrize("unwrap", [None, BakeSettings(size=32)])
def test_an_image_of_deviations_is_that_of_a_texture_also_if_it_is_unwrapped(unwrap, tmp_path):
    source = write_model(tmp_path, "obj", "skin.png")
    (tmp_path / "skin.png").write_bytes(PICTURE)
    sigma = write(tmp_path / "sigma.png", np.full((20, 20, 1), 12 / 255))
    settings = override(ONCE, noise=str(sigma))
    report = beltrami_cli.smooth_file(source, tmp_path / "out.obj", settings, unwrap=unwrap)
    assert list(report.textures[0].noise.values()) == pytest.approx([12 / 255] * 3, rel=1e-3)


def test_a_frame_shows_the_deviation_at_each_place(tmp_path):
    """Within three times what 289 values leave, 4 per cent, and the median within one; falling light is no noise."""
    sigma = halves((SIZE, 1))[:, None]
    noise = sigma * np.random.default_rng(0).standard_normal((SIZE, SIZE))
    frame = (0.5 + 0.2 * np.arange(SIZE) / SIZE + noise)[..., None].astype(np.float32)
    away = (deviation_in_frame(frame)[..., 0] / sigma)[np.abs(np.arange(SIZE) - SIZE / 2) > 9]
    assert np.median(away) == pytest.approx(1, rel=0.04)
    assert np.quantile(np.abs(away - 1), 0.99) < 0.13
    source, given = write(tmp_path / "in.png", grey()[1][..., None]), write(tmp_path / "flat.png", frame)
    report = beltrami_cli.smooth_file(source, tmp_path / "out.png", noise=f"frame:{given}")
    assert report.image.noise_model["quiet"] == pytest.approx(QUIET, rel=0.15)
    assert report.image.noise_model["loud"] == pytest.approx(LOUD, rel=0.15)


@pytest.mark.slow
def test_an_attribute_of_vertices_is_their_noise(tmp_path):
    positions, faces = icosphere(3)
    colours = np.random.default_rng(0).integers(90, 160, (len(positions), 3))
    sigma = np.where(positions[:, 2] < 0, QUIET, LOUD).astype(np.float32)
    table = [[*p, *c, s] for p, c, s in zip(positions, colours, sigma, strict=True)]
    source, target = tmp_path / "in.ply", tmp_path / "out.ply"
    source.write_bytes(ply(f"{COLOURED}, float error", table, faces.tolist()))
    np.save(tmp_path / "sigma.npy", sigma)
    results = []
    for noise in ("attribute:error", str(tmp_path / "sigma.npy")):
        job = beltrami_cli.Job(overwrite=True)
        report = beltrami_cli.smooth_file(source, target, noise=noise, job=job)
        assert report.vertices.noise["red"] == pytest.approx(np.sqrt(np.mean(sigma**2)), rel=1e-3)
        results.append(target.read_bytes())
    assert results[0] == results[1]


@pytest.mark.parametrize(
    ("shape", "value", "noise", "words"),
    [
        ((SIZE, SIZE, 1), 12, "{}", "up to 12"), ((SIZE, SIZE, 1), -1, "{}", "down to -1"),
        ((SIZE, SIZE, 1), np.nan, "{}", "not finite"), ((SIZE, 8, 1), 0.1, "{}", "8 x 128 pixels do not fit"),
        ((SIZE, SIZE, 3), 0.1, "{}", "3 channels"), ((1, 1, 1), 0.1, "attribute:sigma", "only vertices"), ],
)  # fmt: skip
def test_what_is_no_noise_of_the_image_is_refused_in_a_line(shape, value, noise, words, tmp_path):
    source = write(tmp_path / "in.png", grey()[1][..., None])
    given = write(tmp_path / "sigma.exr", np.full(shape, value), "float")
    with pytest.raises((InputError, UsageError), match=words):
        beltrami_cli.smooth_file(source, tmp_path / "out.png", noise=noise.format(given))
    assert not (tmp_path / "out.png").exists()


def test_files_are_not_read_for_arrays():
    with pytest.raises(UsageError, match=r"sigma\.png"):
        beltrami_cli.smooth_image(grey()[1], noise="sigma.png")
